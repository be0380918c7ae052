"""The clocks of the machine that a process runs on, and which boot of it this is.

The wall clock is the one that all machines share, but it can be set, by NTP or by a user. The monotonic clock cannot be
set, and all processes of one boot of a machine read the same one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True)
class MachineTime:
    """The clocks of a machine [ns]."""

    wall_ns: Callable[[], int] = time.time_ns
    monotonic_ns: Callable[[], int] = time.monotonic_ns
    boot_id: str = ""
    """Which boot of which machine; empty if the system does not tell."""


@cache
def this_machine() -> MachineTime:
    """The machine that this process runs on."""
    try:
        return MachineTime(boot_id=_BOOT_ID.read_text(encoding="ascii").strip())
    except OSError:
        return MachineTime()

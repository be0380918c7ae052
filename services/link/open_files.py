"""Room for connections: how many files the link's process may have open, and how many it has.

Zenoh gives a TLS connection 10 s to say who it is, and then closes ten a second of those that did not. The others stay
open. When the system gives this process no further file, no one is let in any more, not even when the strangers have
left, and nothing can be kept for a restart.
"""

from __future__ import annotations

import resource
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

MOST_FILES: Final = 65_536
"""Open files that are asked for: one address has no more connections to a port. Zenoh takes 7 kB for each."""
LOOK_EVERY_S: Final = 5.0
"""Wall time between two looks at the number of open files."""


def allow_connections() -> int:
    """Let this process have as many open files as the system allows it, up to MOST_FILES; returns how many that are."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = MOST_FILES if hard == resource.RLIM_INFINITY else min(MOST_FILES, hard)
    if soft == resource.RLIM_INFINITY or soft >= most:
        return MOST_FILES if soft == resource.RLIM_INFINITY else soft
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        return most
    return soft


def open_files() -> int | None:
    """How many files this process has open; None if the system has no room to tell."""
    try:
        return sum(1 for _ in Path("/proc/self/fd").iterdir())
    except OSError:
        return None


class OpenFiles:
    """Warns once when half of the files that this process may have are open, and again after a time with fewer."""

    def __init__(self, most: int, warn: Callable[[str], None], count: Callable[[], int | None] = open_files) -> None:
        self._most = most
        self._warn = warn
        self._count = count
        self._looked_at_s = 0.0
        self._warned = False

    def look(self, monotonic_s: float) -> None:
        """Look at the number of open files, if it is time to."""
        if monotonic_s - self._looked_at_s < LOOK_EVERY_S:
            return
        self._looked_at_s = monotonic_s
        count = self._count()
        found = self._most if count is None else count
        if found >= self._most // 2 and not self._warned:
            self._warned = True
            self._warn(
                f"{found} of {self._most} files are open, nearly all of them connections; at {self._most} no "
                "connection is taken any more until the link starts again: let a firewall admit the mission's own "
                "machines alone"
            )
        elif found < self._most // 4:
            self._warned = False

"""The clock that survives a restart of the link: mission time continues as if the link had never been away.

Within one boot of the machine the time away is taken from the monotonic clock, because the wall clock may have been set
meanwhile. After another boot only the wall clock can tell it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from he3.errors import InvalidInput
from schemas.link import ClockState  # of a model's field: pydantic reads it
from schemas.wire import Text, Wire
from services.runtime.clock import anchored, mission_time
from services.runtime.files.input import read_own
from services.runtime.files.output import replace_output
from services.runtime.machine_time import MachineTime


class _Kept(Wire):
    clock: ClockState
    boot_id: Text
    """Boot id of the machine when the clock was saved; empty if the system has none."""
    monotonic_ns: Annotated[int, Field(ge=0)]
    """Monotonic time of the machine at the clock's anchor."""
    waits: bool = False
    """Whether mission time has not begun, because processes are waited for."""
    mission: Text = ""
    """Name of the mission; empty in files of earlier versions."""


@dataclass(frozen=True, slots=True)
class KeptClock:
    """A clock that an earlier start of the link has saved, anchored at this moment."""

    state: ClockState
    waits: bool
    """Whether mission time had not begun yet, because processes were waited for."""
    away_ns: int
    """Wall time since it was saved; negative if the wall clock shows an earlier time than then."""
    same_boot: bool
    """Whether the machine's monotonic clock has measured that time; else it is the difference of two wall times."""


def keep(path: Path, clock: ClockState, machine: MachineTime, mission: str = "", *, waits: bool = False) -> None:
    """Save the clock, anchored at this moment; the file is replaced in one step.

    waits: whether mission time has not begun, because processes are waited for.
    """
    kept = _Kept(
        clock=clock, boot_id=machine.boot_id, monotonic_ns=machine.monotonic_ns(), waits=waits, mission=mission
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_output(path, kept.model_dump_json().encode())


def kept_clock(path: Path, machine: MachineTime, mission: str, start_ns: int) -> KeptClock:
    """The clock saved in that file, anchored at this moment. start_ns: mission time at which the mission begins.

    Raises InvalidInput if the file holds none, or that of another mission, OSError if it cannot be read.
    """
    try:
        kept = _Kept.model_validate_json(read_own(path))
    except ValidationError:
        raise InvalidInput(
            f"{path}: expected the clock that an earlier start of the link saved, got other data"
        ) from None
    clock, wall_ns, monotonic_ns = kept.clock, machine.wall_ns(), machine.monotonic_ns()
    for what, expected, came in (("mission", mission, kept.mission or mission), ("start", start_ns, clock.start_ns)):
        if came != expected:
            raise InvalidInput(f"{path}: expected the clock of {what} {expected}, got that of {what} {came}")
    same_boot = bool(machine.boot_id) and kept.boot_id == machine.boot_id
    away_ns = monotonic_ns - kept.monotonic_ns if same_boot else wall_ns - clock.anchor_wall_ns
    now = mission_time(clock, clock.anchor_wall_ns + max(0, away_ns))
    state = anchored(clock, now, wall_ns, machine.boot_id, monotonic_ns)
    return KeptClock(state, kept.waits, away_ns, same_boot)

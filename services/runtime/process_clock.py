"""Mission time in one process: the mission's clock, and the latest time at which the process acted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.link import ClockMode
from schemas.topics import EARTH_CLOCK, MOON_CLOCK, Side
from services.runtime.clock import FollowedClock
from services.runtime.machine_time import this_machine

if TYPE_CHECKING:
    from schemas.link import ClockState
    from services.mission.mission_time import MissionTime

CLOCKS = {Side.MOON: MOON_CLOCK, Side.EARTH: EARTH_CLOCK}
"""Topic of the mission's clock on each side."""


class ProcessClock:
    """The mission's clock as this process received it, and the latest mission time at which the process acted."""

    def __init__(self) -> None:
        self.followed = FollowedClock(this_machine())
        self.latest: MissionTime = 0

    @property
    def known(self) -> bool:
        """Whether a clock state has been received."""
        return self.followed.state is not None

    @property
    def in_lockstep(self) -> bool:
        """Whether mission time is virtual, and this process only looks on."""
        state = self.followed.state
        return state is not None and state.mode is ClockMode.LOCKSTEP

    def follow(self, state: ClockState) -> None:
        """Follow a state of the mission's clock, received just now."""
        self.followed.follow(state)

    def advance(self, to: MissionTime) -> MissionTime:
        """Act at that time, or at the latest time so far if that is later; returns the time used."""
        self.latest = max(self.latest, to)
        return self.latest

    def now(self) -> MissionTime:
        """Mission time, never before the latest time so far; a clock state must have been received."""
        return max(self.latest, self.followed.now())

    def now_or_none(self) -> MissionTime | None:
        """Mission time; before a clock state is received the latest time so far, None if there is none."""
        return self.now() if self.known else self.latest or None

    def wait_s(self, until: MissionTime) -> float | None:
        """Wall time [s] until that mission time, 0 if it has passed; None if the clock is stopped or unknown."""
        return self.followed.seconds_until(until) if self.known else None

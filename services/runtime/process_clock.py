"""Mission time as one process knows it: the mission's clock, and what the process has done by it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.topics import EARTH_CLOCK, MOON_CLOCK, Side
from services.runtime.clock import FollowedClock

if TYPE_CHECKING:
    from schemas.link import ClockState
    from services.mission.mission_time import MissionTime

CLOCKS = {Side.MOON: MOON_CLOCK, Side.EARTH: EARTH_CLOCK}
"""Topic of the mission's clock on each side."""


class ProcessClock:
    """The clock that is followed, and the latest mission time at which this process did something."""

    def __init__(self) -> None:
        self.followed = FollowedClock()
        self.latest: MissionTime = 0

    @property
    def known(self) -> bool:
        """Whether there is a clock to follow."""
        return self.followed.state is not None

    def follow(self, state: ClockState) -> None:
        """Take in a state of the mission's clock that was sent just now."""
        self.followed.follow(state)

    def advance(self, to: MissionTime) -> MissionTime:
        """Something happens at that time, or at the latest one if that is later; returns which."""
        self.latest = max(self.latest, to)
        return self.latest

    def now(self) -> MissionTime:
        """Mission time, never before the latest; there must be a clock to follow."""
        return max(self.latest, self.followed.now())

    def now_or_none(self) -> MissionTime | None:
        """Mission time, or without a clock to follow the latest; None if there is neither."""
        return self.now() if self.known else self.latest or None

    def wait_s(self, until: MissionTime) -> float | None:
        """Wall time until then [s], 0 if it has passed; None if the clock stands or is not known."""
        return self.followed.seconds_until(until) if self.known else None

"""How virtual time may go on: paused, by single steps, until a time, no faster than a rate. It reads no clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from services.mission.mission_time import SECOND, MissionTime

if TYPE_CHECKING:
    from schemas.lockstep import TimeControl

CATCHES_UP_S = 0.5
"""Wall time [s], lost to planning for example, that is made up for by going faster than the rate."""


@dataclass(slots=True)
class Pace:
    """What the operator asked for. Wall time [s] and mission time [ns] are arguments."""

    paused: bool = False
    steps_left: int | None = None
    """Pause after so many further instants; None: do not count."""
    until: MissionTime | None = None
    """Pause at this time."""
    rate: float | None = None
    """Mission seconds per wall second at most; None: as fast as it goes."""
    _from_s: float = 0.0
    _from_ns: MissionTime = 0

    def control(self, change: TimeControl, now: MissionTime, wall_s: float) -> None:
        """Change how time advances, from that moment; what the change does not name stays."""
        if change.paused is not None:
            self.paused = change.paused
            self.steps_left = self.until = None
        if change.steps is not None:
            self.paused, self.steps_left = False, change.steps
        if change.until is not None:
            self.paused, self.until = False, change.until
        if change.unlimited:
            self.rate = None
        elif change.rate is not None:
            self.rate = change.rate
        self._from_s, self._from_ns = wall_s, now

    def pause(self) -> None:
        """Stop time from now on."""
        self.paused, self.steps_left, self.until = True, None, None

    def latest(self, instant: MissionTime, now: MissionTime, wall_s: float) -> MissionTime:
        """How far time may go from `now` towards the next instant at which something happens.

        Pauses where the operator asked for it.
        """
        if self.steps_left == 0 and instant > now:
            self.pause()
        if self.paused:
            return now
        allowed = instant if self.rate is None else min(instant, self._by_rate(self.rate, now, wall_s))
        if self.until is not None and allowed > self.until:
            allowed = self.until
            self.pause()
        return max(now, allowed)

    def stepped(self) -> None:
        """Count a further instant."""
        if self.steps_left is not None:
            self.steps_left -= 1

    def wait_s(self, instant: MissionTime, wall_s: float, at_most_s: float) -> float:
        """How long [s of wall time] there is nothing to do before that instant."""
        if self.paused or self.rate is None:
            return at_most_s
        return min(at_most_s, max(0.0, self._from_s + (instant - self._from_ns) / SECOND / self.rate - wall_s))

    def _by_rate(self, rate: float, now: MissionTime, wall_s: float) -> MissionTime:
        most = now + round(CATCHES_UP_S * rate * SECOND)
        due = self._from_ns + round((wall_s - self._from_s) * rate * SECOND)
        if due > most:
            self._from_s, self._from_ns, due = wall_s, most, most
        return due

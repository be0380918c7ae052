"""The pace of virtual time: paused, single steps, until a time, or limited to a rate. It reads no clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from services.mission.mission_time import SECOND, MissionTime, iso

if TYPE_CHECKING:
    from schemas.lockstep import TimeControl

CATCHES_UP_S = 0.5
"""At most this much wall time [s], lost to planning for example, is recovered by running faster than the rate."""


@dataclass(slots=True)
class Pace:
    """The pace that the operator has set. Methods take wall time [s] and mission time [ns] as arguments."""

    paused: bool = False
    steps_left: int | None = None
    """Pause after this many further instants; None: no such limit."""
    until: MissionTime | None = None
    """Pause at this time."""
    rate: float | None = None
    """Mission seconds per wall second at most; None: no limit."""
    _from_s: float = 0.0
    _from_ns: MissionTime = 0

    def control(self, change: TimeControl, now: MissionTime, wall_s: float) -> None:
        """Apply the operator's change from now on; fields that it does not set keep their values.

        A new end of the run (`steps`, `until`) takes the place of an earlier one.
        Raises InvalidInput, before anything is changed, if `until` has passed.
        """
        if change.until is not None and change.until < now:
            raise InvalidInput(f"until: expected a time from {iso(now)} on, the present one, got {iso(change.until)}")
        if change.paused is not None:
            self.paused = change.paused
            self.steps_left = self.until = None
        if change.steps is not None or change.until is not None:
            self.paused, self.steps_left, self.until = False, change.steps, change.until
        if change.unlimited:
            self.rate = None
        elif change.rate is not None:
            self.rate = change.rate
        self._from_s, self._from_ns = wall_s, now

    def pause(self) -> None:
        """Stop time from now on."""
        self.paused, self.steps_left, self.until = True, None, None

    def latest(self, instant: MissionTime, now: MissionTime, wall_s: float) -> MissionTime:
        """The latest time [ns] to which time may advance now, at most the next instant at which something happens.

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
        """Count one instant against `steps_left`."""
        if self.steps_left is not None:
            self.steps_left -= 1

    def wait_s(self, instant: MissionTime, wall_s: float, at_most_s: float) -> float:
        """Wall time [s] to wait before that instant is due, at most `at_most_s`."""
        if self.paused or self.rate is None:
            return at_most_s
        return min(at_most_s, max(0.0, self._from_s + (instant - self._from_ns) / SECOND / self.rate - wall_s))

    def _by_rate(self, rate: float, now: MissionTime, wall_s: float) -> MissionTime:
        most = now + round(CATCHES_UP_S * rate * SECOND)
        due = self._from_ns + round((wall_s - self._from_s) * rate * SECOND)
        if due > most:
            self._from_s, self._from_ns, due = wall_s, most, most
        return due

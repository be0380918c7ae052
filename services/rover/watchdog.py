"""The command-loss watchdog: a rover with nothing to do that does not hear from the ground enters safe mode."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from services.mission.mission_time import MissionTime, seconds
from services.rover.states import Hold
from services.runtime.node import Effect, SetTimer

if TYPE_CHECKING:
    from services.rover.operating_state import OperatingState

WATCHDOG: Final = "watchdog"
"""Timer: the ground has been silent for too long."""


class Watchdog:
    """Runs while the rover is unoccupied; `timeout_s` None switches it off."""

    def __init__(self, timeout_s: float | None, operating: OperatingState, effects: list[Effect]) -> None:
        self._timeout_s = timeout_s
        self._operating = operating
        self._effects = effects

    def restart(self, now: MissionTime) -> None:
        """Starts the timer, if the rover has nothing to do."""
        if self._timeout_s is not None and self._operating.unoccupied:
            self._effects.append(SetTimer(WATCHDOG, now + seconds(self._timeout_s)))

    def expired(self, now: MissionTime) -> None:
        """Enters safe mode, if the rover still has nothing to do."""
        if self._operating.unoccupied:
            self._operating.hold_for(Hold.SILENCE, now, f"for {self._timeout_s:g} s")

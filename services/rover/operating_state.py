"""The rover's operating state: which state of the table it is in, and what holds it.

Every change of state goes through here, with the power that the new state draws.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from schemas.telemetry import EventKind, RoverMode
from services.rover.states import HOLD_TRIGGERS, INTERRUPTIBLE, MODES, STANDING, Hold, State, Trigger, next_state
from services.runtime.node import Effect, SetTimer

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime
    from services.rover.reporter import Reporter
    from services.rover.vehicle import Vehicle
    from services.runtime.node import SavedState

CHARGED: Final = "charged"
"""Timer: the battery holds enough energy to continue."""


class OperatingState:
    """The current state and hold; both change only by `enter`, `hold_for` and `release`."""

    def __init__(self, vehicle: Vehicle, reporter: Reporter, effects: list[Effect]) -> None:
        self._vehicle = vehicle
        self._reporter = reporter
        self._effects = effects
        self._state = State.IDLE
        self._hold: Hold | None = None

    @property
    def state(self) -> State:
        return self._state

    @property
    def hold(self) -> Hold | None:
        """Why the rover stands although it may have something to do; None if nothing holds it."""
        return self._hold

    @property
    def mode(self) -> RoverMode:
        """The mode that is reported."""
        return MODES[self._state]

    @property
    def interruptible(self) -> bool:
        """Whether the rover can begin something else without finishing a step first."""
        return self._state in INTERRUPTIBLE

    @property
    def standing(self) -> bool:
        """Whether the rover stands until a new input arrives."""
        return self._state in STANDING

    @property
    def unoccupied(self) -> bool:
        """Whether the rover has nothing to do and nothing holds it."""
        return self._state in (State.IDLE, State.PARKED)

    def enter(self, trigger: Trigger, now: MissionTime, load_w: float = 0.0) -> None:
        """Makes the transition; from now on the rover draws that load [W] beside the base load."""
        self._state = next_state(self._state, trigger)
        self._vehicle.draw(load_w, now)

    def hold_for(self, hold: Hold, now: MissionTime, why: str) -> None:
        """Holds the rover for that reason, in place of an earlier one. The current activity is kept."""
        was_safe = self._hold is not None and self._hold is not Hold.PAUSE
        self._stop_waiting_for_charge()
        self._hold = hold
        self.enter(HOLD_TRIGGERS[hold], now)
        if hold is Hold.PAUSE:
            if was_safe:
                self._reporter.report_event(EventKind.SAFE_MODE_LEFT, now, why)
            self._reporter.report_event(EventKind.PAUSED, now, why)
        else:
            detail = f"{hold.value}: {why}" if why else hold.value
            self._reporter.report_event(EventKind.SAFE_MODE_ENTERED, now, detail)

    def release(self, now: MissionTime, why: str) -> None:
        """Ends the hold, if there is one. The state changes with the next step."""
        if self._hold is None:
            return
        self._stop_waiting_for_charge()
        kind = EventKind.RESUMED if self._hold is Hold.PAUSE else EventKind.SAFE_MODE_LEFT
        self._hold = None
        self._reporter.report_event(kind, now, why)

    def _stop_waiting_for_charge(self) -> None:
        if self._hold is Hold.ENERGY:
            self._effects.append(SetTimer(CHARGED, None))

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {"state": self._state, "hold": self._hold}

    def restore(self, state: SavedState) -> None:
        """Restore state and hold from a checkpoint."""
        self._state, self._hold = state["state"], state["hold"]

"""Where the rover was last heard from, and how far it has driven."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from he3.frames import Place
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState


class RoverPosition:
    """The rover's position as of the newest message about it; older messages that come late do not set it back."""

    def __init__(self, start_m: Place) -> None:
        self.place_m = start_m
        """(x, y) [m]."""
        self.driven_m = 0.0
        """Odometer [m]."""
        self._made_at: MissionTime = -1

    def heard(self, place_m: Place, driven_m: float, made_at: MissionTime) -> bool:
        """Note a reported place; returns whether the message, made at that time, is the newest so far."""
        self.drove(driven_m)
        if made_at < self._made_at:
            return False
        self._made_at = made_at
        self.place_m = place_m
        return True

    def drove(self, driven_m: float) -> None:
        """Note an odometer reading [m]."""
        self.driven_m = max(self.driven_m, driven_m)

    def sent_to(self, place_m: Place) -> None:
        """Note that the rover has arrived where the operator sent it."""
        self.place_m = place_m

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "place_m": self.place_m,
            "driven_m": self.driven_m,
            "made_at": self._made_at,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the position from this state."""
        self.place_m = state["place_m"]
        self.driven_m = state["driven_m"]
        self._made_at = state["made_at"]

"""The vehicle: where it stands or drives, how far it has driven and drilled, and its battery."""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.telemetry import RoverMode, RoverState

if TYPE_CHECKING:
    from he3.frames import Place
    from services.mission.mission_time import MissionTime
    from services.rover.drive import Drive
    from services.rover.energy import Battery
    from services.runtime.node import SavedState


class Vehicle:
    """The vehicle's state. Between two calls it stands, or drives the section that it has set off on."""

    def __init__(self, place_m: Place, battery: Battery) -> None:
        self.battery = battery
        self.drilled_m = 0.0
        self.track_m: list[Place] = [place_m]
        """Every vertex of the path driven, the landing place first."""
        self._place_m = place_m
        self._heading_deg = 0.0
        self._driven_m = 0.0
        self._drive: Drive | None = None

    @property
    def standing_m(self) -> Place:
        """Place where the vehicle stands, or stood when its drive began [m]."""
        return self._place_m

    def place_m(self, now: MissionTime) -> Place:
        """Place of the vehicle at that time [m]."""
        return self._drive.place_m(now)[0] if self._drive else self._place_m

    def driven_m(self, now: MissionTime) -> float:
        """Odometer [m] at that time."""
        return self._driven_m + (self._drive.driven_m(now) if self._drive else 0.0)

    def set_off(self, drive: Drive) -> None:
        """Drives that section from the drive's beginning on."""
        self._drive = drive

    def arrive(self, now: MissionTime) -> None:
        """Stands at the end of the section, and draws the base load only."""
        if self._drive is not None:
            section = self._drive.section
            self._place_m, self._heading_deg = section.points_m[-1], self._drive.place_m(now)[1]
            self._driven_m += section.length_m
            self.track_m += section.points_m[1:]
            self._drive = None
        self.draw(0.0, now)

    def draw(self, load_w: float, now: MissionTime) -> None:
        """Draws that load [W] beside the base load from now on."""
        self.battery = self.battery.drawing(load_w, now)

    def report_state(
        self,
        now: MissionTime,
        *,
        mode: RoverMode,
        round_: int,
        plan_revision: int,
        rounds_on_board: int,
        samples_done: int,
        queue_depth: int,
    ) -> RoverState:
        """The report of the rover's state."""
        (x, y), heading = self._drive.place_m(now) if self._drive else (self._place_m, self._heading_deg)
        return RoverState(
            mode=mode,
            x_m=x,
            y_m=y,
            heading_deg=heading,
            energy_wh=self.battery.charge_at(now),
            capacity_wh=self.battery.capacity_wh,
            driven_m=self.driven_m(now),
            drilled_m=self.drilled_m,
            round=round_,
            plan_revision=plan_revision,
            rounds_on_board=rounds_on_board,
            samples_done=samples_done,
            queue_depth=queue_depth,
        )

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "battery": self.battery,
            "drilled_m": self.drilled_m,
            "track_m": list(self.track_m),
            "place_m": self._place_m,
            "heading_deg": self._heading_deg,
            "driven_m": self._driven_m,
            "drive": self._drive,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the vehicle from this state."""
        self.battery, self.drilled_m, self.track_m = state["battery"], state["drilled_m"], state["track_m"]
        self._place_m, self._heading_deg = state["place_m"], state["heading_deg"]
        self._driven_m, self._drive = state["driven_m"], state["drive"]

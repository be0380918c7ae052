"""The vehicle: where it stands or drives, what it has driven and drilled, and what is left in its battery."""

from __future__ import annotations

from he3.frames import Place
from schemas.telemetry import RoverMode, RoverState
from services.rover.energy import Battery
from services.rover.traverse import Drive
from services.runtime.node import MissionTime


class Vehicle:
    """The rover's body. Between two calls it stands, or drives the piece that was begun."""

    def __init__(self, place_m: Place, battery: Battery) -> None:
        self.battery = battery
        self.drilled_m = 0.0
        self.track_m: list[Place] = [place_m]
        """Every vertex of the way driven, the landing place first."""
        self._place_m = place_m
        self._heading_deg = 0.0
        self._driven_m = 0.0
        self._drive: Drive | None = None

    @property
    def standing_m(self) -> Place:
        """Where it stands, or stood when the piece that it drives began."""
        return self._place_m

    def place_m(self, now: MissionTime) -> Place:
        """Where it is at that time."""
        return self._drive.place_m(now)[0] if self._drive else self._place_m

    def driven_m(self, now: MissionTime) -> float:
        """Odometer [m] at that time."""
        return self._driven_m + (self._drive.driven_m(now) if self._drive else 0.0)

    def set_off(self, drive: Drive, now: MissionTime) -> None:
        """Drives that piece from now on."""
        self._drive = drive
        self.battery = self.battery.drawing(drive.load_w, now)

    def arrive(self, now: MissionTime) -> None:
        """Stands at the end of the piece."""
        if self._drive is not None:
            piece = self._drive.piece
            self._place_m, self._heading_deg = piece.points_m[-1], self._drive.place_m(now)[1]
            self._driven_m += piece.length_m
            self.track_m += piece.points_m[1:]
            self._drive = None
        self.rest(now)

    def work(self, load_w: float, now: MissionTime) -> None:
        """Stands and draws that load [W]."""
        self.battery = self.battery.drawing(load_w, now)

    def rest(self, now: MissionTime) -> None:
        """Stands and draws nothing beside the base load."""
        self.work(0.0, now)

    def state(
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
        """The state as it is reported."""
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

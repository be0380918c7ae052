"""The energy guard: no step begins that would use up the reserve; the rover charges first, or enters safe mode."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from schemas.telemetry import EventKind
from services.rover.operating_state import CHARGED, OperatingState
from services.rover.states import Hold
from services.runtime.node import Effect, SetTimer

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime
    from services.mission.scenario import RoverConfig
    from services.rover.reporter import Reporter
    from services.rover.vehicle import Vehicle

_ROUNDING_WH: Final = 1e-6  # Wh; a charging hold ends at a whole nanosecond, so the level is met up to rounding


class EnergyGuard:
    """Compares what each step needs with the charge above the reserve."""

    def __init__(
        self,
        config: RoverConfig,
        vehicle: Vehicle,
        operating: OperatingState,
        reporter: Reporter,
        effects: list[Effect],
    ) -> None:
        self._config = config
        self._vehicle = vehicle
        self._operating = operating
        self._reporter = reporter
        self._effects = effects

    def affords(self, load_w: float, duration_s: float, now: MissionTime) -> bool:
        """Whether the step leaves the reserve untouched; if not, the rover is held to charge or in safe mode."""
        battery, config = self._vehicle.battery, self._config
        need = battery.need_wh(load_w, duration_s)
        reserve = config.reserve * config.capacity_wh
        charge = battery.charge_at(now)
        if charge - need >= reserve - _ROUNDING_WH:
            return True
        level = max(config.resume_charge * config.capacity_wh, reserve + need)
        self._vehicle.draw(0.0, now)
        ready = self._vehicle.battery.reaches(level, now)
        why = f"{charge:.1f} Wh left, the next step takes {need:.1f} Wh, {reserve:.1f} Wh are in reserve"
        self._reporter.report_event(EventKind.LOW_ENERGY, now, why)
        if level > config.capacity_wh or ready is None:
            self._operating.hold_for(Hold.SPENT, now, why)
        else:
            self._operating.hold_for(Hold.ENERGY, now, f"until {level:.1f} Wh")
            self._effects.append(SetTimer(CHARGED, ready))
        return False

    def charged(self, now: MissionTime) -> bool:
        """Ends the charging hold; returns whether there was one."""
        if self._operating.hold is not Hold.ENERGY:
            return False
        self._reporter.report_event(EventKind.CHARGED, now, f"{self._vehicle.battery.charge_at(now):.1f} Wh")
        self._operating.release(now, "charged")
        return True

"""The battery: its charge is linear in time between two changes of load.

The solar power and the base load are constant; driving, drilling and analysing draw more. The charge stays between
0 and the capacity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from services.mission.mission_time import SECOND, MissionTime

if TYPE_CHECKING:
    from services.mission.scenario import RoverConfig

_WS_PER_WH: Final = 3600.0  # W s in a Wh


@dataclass(frozen=True, slots=True)
class Battery:
    """The charge at one time, and the load [W] that is drawn beside the base load from then on."""

    capacity_wh: float
    surplus_w: float
    """Solar power beyond the base load [W]; negative in the dark."""
    charge_wh: float
    at: MissionTime
    load_w: float = 0.0

    def charge_at(self, now: MissionTime) -> float:
        """Charge [Wh] at that time, at the present load."""
        gained = (self.surplus_w - self.load_w) * ((now - self.at) / SECOND) / _WS_PER_WH
        return min(self.capacity_wh, max(0.0, self.charge_wh + gained))

    def drawing(self, load_w: float, now: MissionTime) -> Battery:
        """The battery from that time on, at another load [W] beside the base load."""
        return replace(self, charge_wh=self.charge_at(now), at=now, load_w=load_w)

    def need_wh(self, load_w: float, duration_s: float) -> float:
        """Energy [Wh] that such a step takes out of the battery; 0 if solar power suffices."""
        return max(0.0, (load_w - self.surplus_w) * duration_s / _WS_PER_WH)

    def reaches(self, charge_wh: float, now: MissionTime) -> MissionTime | None:
        """When the charge reaches that level, rounded up to a nanosecond; None if it never does at the present load."""
        missing = min(charge_wh, self.capacity_wh) - self.charge_at(now)
        power = self.surplus_w - self.load_w
        if missing <= 0:
            return now
        return now + math.ceil(missing * _WS_PER_WH / power * SECOND) if power > 0 else None


def full_battery(config: RoverConfig, now: MissionTime) -> Battery:
    """The battery at the beginning of the mission, at its initial charge."""
    return Battery(
        capacity_wh=config.capacity_wh,
        surplus_w=config.solar_w - config.base_load_w,
        charge_wh=config.capacity_wh * config.initial_charge,
        at=now,
    )

"""The battery between sun and loads: charge is linear in time between two changes of load.

Power comes from the sun always, and the base load is always drawn; driving, drilling and analysing draw more. The
charge stays within 0 and the capacity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

from services.mission.scenario import RoverConfig
from services.runtime.node import SECOND, MissionTime

_WS_PER_WH: Final = 3600.0  # W s in a Wh


@dataclass(frozen=True, slots=True)
class Battery:
    """The charge at one time, and the load [W] drawn beside the base load since then."""

    capacity_wh: float
    surplus_w: float
    """What the sun gives beyond the base load [W]; negative in the dark."""
    charge_wh: float
    at: MissionTime
    load_w: float = 0.0

    def charge_at(self, now: MissionTime) -> float:
        """Charge [Wh] at that time, if the load stays what it is."""
        gained = (self.surplus_w - self.load_w) * ((now - self.at) / SECOND) / _WS_PER_WH
        return min(self.capacity_wh, max(0.0, self.charge_wh + gained))

    def drawing(self, load_w: float, now: MissionTime) -> Battery:
        """The battery from that time on, under another load [W] beside the base load."""
        return replace(self, charge_wh=self.charge_at(now), at=now, load_w=load_w)

    def need_wh(self, load_w: float, duration_s: float) -> float:
        """What a step of that load [W] and duration takes out of the battery [Wh]; 0 when the sun bears it."""
        return max(0.0, (load_w - self.surplus_w) * duration_s / _WS_PER_WH)

    def reaches(self, charge_wh: float, now: MissionTime) -> MissionTime | None:
        """When the charge has risen to that level, rounded up; None if it never will under this load."""
        missing = min(charge_wh, self.capacity_wh) - self.charge_at(now)
        power = self.surplus_w - self.load_w
        if missing <= 0:
            return now
        return now + math.ceil(missing * _WS_PER_WH / power * SECOND) if power > 0 else None


def full_battery(config: RoverConfig, now: MissionTime) -> Battery:
    """The battery as the mission begins, at its initial charge."""
    return Battery(
        capacity_wh=config.capacity_wh,
        surplus_w=config.solar_w - config.base_load_w,
        charge_wh=config.capacity_wh * config.initial_charge,
        at=now,
    )

"""The terrain of a mission as its report needs it: what was driven over, and what is closed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from he3.driving import DrivenGround
from services.ground.closed_ground import ClosedGround, closed_ground
from services.ground.node import slope_limit_deg, terrain_of

if TYPE_CHECKING:
    from he3.reference import Region
    from services.mission.scenario import Scenario


def terrain_facts(scenario: Scenario, region: Region) -> tuple[DrivenGround, ClosedGround]:
    """The region's terrain with the scenario's rover, and how much of it is closed to that rover, and why."""
    driven = DrivenGround(region.grid, region.slope_deg, region.elevation_m, scenario.rover.driving)
    terrain = terrain_of(scenario, region)
    return driven, closed_ground(region, terrain, scenario.start_m, slope_limit_deg(scenario))

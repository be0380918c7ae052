"""A budget in hours, spent by the real rover on a battery that must be charged on the way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from he3.errors import NoRoute
from he3.frames import SiteGrid
from he3.reference import Region
from schemas.ground import MissionPhase
from services.field.node import build_node as build_field
from services.ground.node import build_node as build_ground
from services.ground.planners.interface import PlannedRound, PlanningRequest
from services.link.node import build_node as build_link
from services.mission.in_process import InProcessMission
from services.mission.mission_time import SECOND
from services.mission.scenario import checked_scenario
from services.rover.node import build_node as build_rover

WIDE = 80


def straight(request: PlanningRequest) -> PlannedRound:
    """Straight from place to place, each drawn at random, as far as the budget allows."""
    rng = np.random.default_rng(request.seed)
    places = rng.uniform(5.0, WIDE - 5.0, (request.samples, 2))
    path = np.vstack((request.start_m, places))
    if float(np.hypot(*np.diff(path, axis=0).T).sum()) > request.budget_m:
        raise NoRoute("too far")
    return PlannedRound(path, places, 1.0)


def flat() -> Region:
    grid = SiteGrid(WIDE, WIDE, 1.0)
    east = np.linspace(4.0, 9.0, WIDE)[None, :].repeat(WIDE, axis=0)
    none = np.zeros(grid.shape)
    return Region(
        name="flat", title="flat", provenance="made by a test", grid=grid, he3_ppb=east, orbital_ppb=east,
        elevation_m=none, slope_deg=none.copy(), traversable=np.ones(grid.shape, dtype=bool),
    )  # fmt: skip


def flown(budget_h: float, **rover: float) -> tuple[float, int]:
    """Hours that the mission took, and samples in the map."""
    document: dict[str, Any] = {
        "name": "hours", "region": "t1", "rounds": 40, "samples_per_round": 2, "start_m": [40.0, 40.0],
        "ground": {"budget_h": budget_h}, "rover": rover,
    }  # fmt: skip
    scenario = checked_scenario(document, "test")
    region = flat()
    mission = InProcessMission(
        scenario,
        nodes=[
            build_field(scenario, region), build_rover(scenario, region.grid), build_link(scenario),
            build_ground(scenario, region, straight),
        ],
    )  # fmt: skip
    assert mission.run(until_s=200 * 3600.0) is MissionPhase.COMPLETED, mission.why()
    snapshot: Any = mission.simulation.snapshots["ground"]
    return (mission.simulation.now - scenario.start_ns) / SECOND / 3600, len(snapshot.samples)


@pytest.mark.parametrize("solar_w", [450.0, 250.0, 180.0])
@pytest.mark.parametrize("budget_h", [5.0, 12.0])
def test_a_budget_in_hours_includes_the_time_for_charging(budget_h: float, solar_w: float) -> None:
    took, samples = flown(budget_h, solar_w=solar_w, capacity_wh=200.0, drill_w=500.0)
    assert took <= budget_h * 1.02
    assert samples > 1


def test_less_than_a_round_is_left_of_the_hours() -> None:
    took, samples = flown(12.0)
    assert 11.0 <= took <= 12.1
    assert samples > 20

"""Missions on the widest sites that a region may have: messages and rover accept what the scenario accepts."""

from __future__ import annotations

import numpy as np
import pytest

from he3.frames import SiteGrid
from he3.reference import Region
from schemas.ground import MissionPhase
from services.mission.in_process import InProcessMission, build_nodes
from services.mission.scenario import checked_scenario

KM = 1000.0


@pytest.mark.parametrize(
    "planner", [*(pytest.param(name, marks=pytest.mark.exhaustive) for name in ("tour", "rrtstar")), "informative"]
)
def test_a_mission_over_cells_of_a_kilometre_takes_all_its_samples(planner: str) -> None:
    grid = SiteGrid(60, 99, KM)
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    field = 8.0 + 2.0 * np.sin(x / 9 / KM) + 1.5 * np.cos(y / 7 / KM)
    flat = np.zeros(grid.shape)
    region = Region(
        name="wide", title="wide", provenance="made by a test", grid=grid, he3_ppb=field, orbital_ppb=field,
        elevation_m=flat, slope_deg=flat.copy(), traversable=np.ones(grid.shape, dtype=bool),
    )  # fmt: skip
    document = {
        "name": "wide", "region": "unused.npz", "rounds": 2, "samples_per_round": 3, "start_m": [5.5 * KM, 5.5 * KM],
        "ground": {"planner": planner, "status_period_s": 3600.0}, "rover": {"state_period_s": 3600.0},
    }  # fmt: skip
    scenario = checked_scenario(document, "test")
    mission = InProcessMission(scenario, nodes=build_nodes(scenario, region=region))
    assert mission.run() is MissionPhase.COMPLETED
    assert mission.status is not None
    assert mission.status.detail == "6 of 6 samples are in the map"

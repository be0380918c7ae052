"""Missions over cells that are much larger than the rover, as those of orbital maps are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from he3.frames import SiteGrid
from he3.reference import Region
from schemas.codec import decode
from schemas.telemetry import EventKind
from schemas.topics import EVENT, SAMPLE, Side, Topic
from services.mission.in_process import InProcessMission, build_nodes
from services.mission.mission_time import MissionTime
from services.mission.scenario import Scenario, checked_scenario

GRID = SiteGrid(24, 24, 60.0)
WALL = 9


def region() -> Region:
    """A wall with a passage of one cell, and closed cells here and there."""
    random = np.random.default_rng(4)
    open_cells = random.random(GRID.shape) > 0.12
    open_cells[:, WALL - 1 : WALL + 2] = True
    open_cells[:, WALL], open_cells[14, WALL], open_cells[2, 2] = False, True, True
    field = 6.0 + ndimage.gaussian_filter(random.normal(size=GRID.shape), 3) * 10.0
    level = np.zeros(GRID.shape)
    return Region(
        name="made", title="Made", provenance="made by the test", grid=GRID, he3_ppb=field, orbital_ppb=field.copy(),
        elevation_m=level, slope_deg=level.copy(), traversable=open_cells,
    )  # fmt: skip


def scenario(**ground: object) -> Scenario:
    return checked_scenario({
        "name": "wide", "region": "t1", "rounds": 6, "samples_per_round": 3, "start_m": [150.0, 150.0],
        "rover": {"solar_w": 2000.0}, "ground": ground,
    }, "test")  # fmt: skip


@pytest.mark.parametrize(
    "ground",
    [{"planner": "tour"}, {"planner": "tour", "cost": "energy"}, {"planner": "informative"}, {"planner": "rrtstar"}],
    ids=lambda ground: "-".join(ground.values()),
)
def test_the_rover_passes_a_gap_of_one_cell_and_meets_no_obstacle(ground: dict[str, Any]) -> None:
    wanted, site = scenario(**ground), region()
    mission = InProcessMission(wanted, nodes=build_nodes(wanted, site))
    events, samples = [], []

    def listen(topic: Topic, side: Side, payload: bytes, _now: MissionTime) -> None:
        if topic is EVENT and side is Side.MOON:
            events.append(decode(topic, payload, wanted.name)[1])
        elif topic is SAMPLE and side is Side.MOON:
            samples.append(decode(topic, payload, wanted.name)[1])

    mission.simulation.tap(listen)
    mission.run()
    assert not [event for event in events if event.kind in (EventKind.BLOCKED, EventKind.ROUND_ABORTED)]
    assert len({sample.sample_id for sample in samples}) == 18
    if ground["planner"] in ("tour", "informative"):
        assert max(sample.x_m for sample in samples) > (WALL + 1) * GRID.resolution_m

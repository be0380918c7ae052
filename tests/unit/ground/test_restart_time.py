"""A ground station that is restarted late in a mission is ready soon, with the same map to the byte.

The promise is about a whole mission, 150 samples on 500 x 500 cells. The gate holds it for a part of one.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from he3.frames import SiteGrid
from he3.reference import Region
from schemas.commands import NoParameters
from schemas.topics import TRACK
from services.field.node import build_node as build_field
from services.ground.node import build_node as build_ground
from services.ground.planners.interface import PlannedRound, PlanningRequest
from services.link.node import build_node as build_link
from services.mission.in_process import InProcessMission
from services.mission.scenario import checked_scenario
from services.rover.node import build_node as build_rover
from services.runtime.host import Host
from services.runtime.journal import JournalFolder, JournalWriter, identity_of
from services.runtime.node import PublishSnapshot
from services.runtime.scheduler import InlineExecutor, NodeScheduler
from tests.waiting import expect_within

RESTART_S = 2.0
"""From reading the journal until the map is there [s of this process's time]."""


def across(request: PlanningRequest) -> PlannedRound:
    """One line of a lattice after the other, 5 samples on each."""
    row = len(request.observed_m) // 5
    y = 10.0 + 16.0 * row
    xs = np.linspace(30.0, request.grid.width_m - 30.0, 5)
    places = np.column_stack((xs if row % 2 == 0 else xs[::-1], np.full(5, y)))
    return PlannedRound(np.vstack((request.start_m, places)), places, 1.0)


@pytest.mark.parametrize(("cells", "rounds"), [(160, 9), pytest.param(500, 30, marks=pytest.mark.exhaustive)])
def test_a_ground_station_is_back_within_two_seconds_late_in_a_mission(cells: int, rounds: int, tmp_path: Path) -> None:
    samples = 5 * rounds
    grid = SiteGrid(cells, cells, 1.0)
    noise = np.random.default_rng(1).normal(size=grid.shape).cumsum(axis=0).cumsum(axis=1)
    flat = np.zeros(grid.shape)
    region = Region(
        name="flat", title="flat", provenance="made by a test", grid=grid, he3_ppb=7.5 + noise / noise.std(),
        orbital_ppb=np.full(grid.shape, 7.5), elevation_m=flat, slope_deg=flat.copy(),
        traversable=np.ones(grid.shape, dtype=bool),
    )  # fmt: skip
    scenario = checked_scenario(
        {
            "name": "late",
            "region": "t1",
            "rounds": rounds,
            "ground": {"kernel": "matern52", "pipeline": 1, "status_period_s": 600.0},
            "rover": {"state_period_s": 600.0},
        },
        "test",
    )
    nodes = [
        build_field(scenario, region), build_rover(scenario, grid), build_link(scenario),
        build_ground(scenario, region, across),
    ]  # fmt: skip
    mission = InProcessMission(scenario, nodes=nodes)
    codec = Host(build_ground(scenario, region, across), scenario.name).codec
    folder = JournalFolder(tmp_path, "ground", identity_of(scenario), codec)
    writer: JournalWriter = folder.begin(folder.history())
    simulation = mission.simulation
    simulation.keep_journals(("ground",), identity_of(scenario))
    simulation._schedulers["ground"]._journal = writer  # as a process keeps it, in a file
    while mission.status is None or mission.status.samples < samples - 3:
        assert simulation.step(), mission.why()

    began = time.process_time()
    history = folder.history()
    node = build_ground(scenario, region, across)
    scheduler = NodeScheduler(Host(node, scenario.name), InlineExecutor())
    remaining = scheduler.replay(history.inputs, history.state)
    took_s = time.process_time() - began

    shown = next(action.snapshot for action in remaining if isinstance(action, PublishSnapshot))
    live = simulation.snapshots["ground"]
    assert shown.mean_ppb.tobytes() == live.mean_ppb.tobytes()  # type: ignore[attr-defined]
    assert shown.std_ppb.tobytes() == live.std_ppb.tobytes()  # type: ignore[attr-defined]
    assert len(simulation.ask(TRACK, NoParameters()).samples) >= samples - 3
    writer._stream.close()
    expect_within(RESTART_S, took_s, f"{len(history.inputs)} inputs after the checkpoint", time.process_time)

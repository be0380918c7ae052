"""However often the ground computes its map, a mission takes the same course and ends with the same map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy import ndimage

from he3.frames import SiteGrid
from he3.reference import Region
from schemas.commands import NoParameters
from schemas.maps import MapLayer, MapLayerQuery
from schemas.topics import MAP_LAYER, MAP_OVERVIEW, MAP_SCORE, TRACK
from services.mission.in_process import InProcessMission, build_nodes
from services.mission.scenario import checked_scenario

if TYPE_CHECKING:
    from services.ground.map.publisher import MapUse

GRID = SiteGrid(40, 40, 2.0)


def flown(planner: str, use: MapUse) -> tuple[InProcessMission, int]:
    """A mission of three short rounds to its end, and how often its map was sent."""
    field = 5.0 + ndimage.gaussian_filter(np.random.default_rng(1).normal(size=GRID.shape), 3) * 10.0
    flat = np.zeros(GRID.shape)
    region = Region(
        name="made", title="Made", provenance="made by the test", grid=GRID, he3_ppb=field, orbital_ppb=field.copy(),
        elevation_m=flat, slope_deg=flat, traversable=np.ones(GRID.shape, np.bool_),
    )  # fmt: skip
    scenario = checked_scenario({
        "name": "map", "region": "t1", "rounds": 3, "samples_per_round": 3, "start_m": [20.0, 20.0],
        "ground": {"planner": planner, "pipeline": 1},
    }, "test")  # fmt: skip
    mission = InProcessMission(scenario, nodes=build_nodes(scenario, region, map_use=use))
    sent: list[object] = []
    if use == "always":
        mission.simulation.tap(lambda *message: sent.append(message), (MAP_OVERVIEW,))
    mission.run()
    return mission, len(sent)


@pytest.mark.parametrize("planner", ["tour", "rrt"])
def test_the_last_map_does_not_depend_on_how_often_it_was_computed(planner: str) -> None:
    (always, sent), (rounds, _), (asked, _) = (flown(planner, use) for use in ("always", "rounds", "asked"))
    assert always.status is not None
    assert sent == always.status.map_revision > 9
    for other in (rounds, asked):
        assert other.status == always.status
        for layer in (MapLayer.MEAN, MapLayer.STD):
            query = MapLayerQuery(layer=layer)
            assert other.ask(MAP_LAYER, query) == always.ask(MAP_LAYER, query)
        assert other.ask(MAP_SCORE, NoParameters()) == always.ask(MAP_SCORE, NoParameters())
    assert rounds.ask(TRACK, NoParameters()) == always.ask(TRACK, NoParameters())
    assert len(always.ask(TRACK, NoParameters()).score_history) == 3
    assert asked.ask(TRACK, NoParameters()).score_history == ()

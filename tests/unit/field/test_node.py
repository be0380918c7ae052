"""The field's replies are a function of query, region and seed."""

from __future__ import annotations

import math
import subprocess
import sys
from itertools import count

import numpy as np
import pytest
from scipy import stats

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.measurement import sample_noise
from he3.reference import Region
from schemas.measurement import MeasurementReply, MeasurementRequest, TerrainReply, TerrainRequest
from schemas.topics import MEASURE, TERRAIN
from services.field.hazards import START_CLEARANCE_M, covered, hazard_places
from services.field.node import FieldNode, build_node
from services.mission.scenario import FieldConfig, Scenario
from services.runtime.node import QueryReceived, RefuseQuery, SendReply, Started, TimerFired

GRID = SiteGrid(30, 40, 2.0)
TOKENS = count()


def region(grid: SiteGrid = GRID) -> Region:
    """A region with a different value in every cell of every layer, and one closed cell."""
    cells = np.arange(grid.rows * grid.columns, dtype=np.float64).reshape(grid.shape)
    open_cells = np.ones(grid.shape, dtype=np.bool_)
    open_cells[3, 7] = False
    return Region(
        name="numbered",
        title="numbered",
        provenance="made for tests",
        grid=grid,
        he3_ppb=cells + 1.0,
        orbital_ppb=cells.copy(),
        elevation_m=cells / 10,
        slope_deg=cells / 100,
        traversable=open_cells,
    )


def field(seed: int = 1, **config: object) -> FieldNode:
    return FieldNode(region(), FieldConfig.model_validate(config), seed, (10.0, 10.0))


def measured(node: FieldNode, x: float, y: float, sample_id: str = "r1s1") -> MeasurementReply:
    request = MeasurementRequest(sample_id=sample_id, x_m=x, y_m=y, depth_m=0.1)
    (answer,) = node.handle(QueryReceived(MEASURE, request, next(TOKENS)), 0)
    assert isinstance(answer, SendReply)
    assert isinstance(answer.reply, MeasurementReply)
    return answer.reply


def terrain(node: FieldNode, *points: tuple[float, float]) -> TerrainReply:
    (answer,) = node.handle(QueryReceived(TERRAIN, TerrainRequest(points_m=points), next(TOKENS)), 0)
    assert isinstance(answer, SendReply)
    assert isinstance(answer.reply, TerrainReply)
    return answer.reply


def test_a_measurement_without_noise_is_the_value_of_the_cell_that_holds_the_place():
    node = field(noise_std_ppb=0.0)
    assert measured(node, 0.1, 1.9).helium3_ppb == 1.0
    assert measured(node, 2.1, 0.1).helium3_ppb == 2.0
    assert measured(node, 0.1, 2.1).helium3_ppb == 41.0
    assert measured(node, 80.0, 60.0).helium3_ppb == 30 * 40  # the region's far edge belongs to its last cell


def test_a_measurement_is_the_field_plus_the_noise_of_seed_and_sample_id():
    reply = measured(field(seed=5, noise_std_ppb=0.3), 1.0, 1.0, "r2s4")
    assert reply.helium3_ppb == 1.0 + sample_noise(5, "r2s4", 0.3)
    assert reply.noise_std_ppb == 0.3


def test_the_same_sample_has_the_same_value_in_any_order_and_after_a_restart():
    first, second = field(), field()
    numbers = {name: measured(first, 9.0, 9.0, name).helium3_ppb for name in ("a", "b", "c")}
    for name in ("c", "a", "b", "c"):
        assert measured(second, 9.0, 9.0, name).helium3_ppb == numbers[name]


def test_the_same_sample_at_another_place_has_the_same_noise():
    node = field()
    here, there = measured(node, 1.0, 1.0, "r1s1"), measured(node, 3.0, 1.0, "r1s1")
    assert there.helium3_ppb - here.helium3_ppb == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("place", [(-0.1, 5.0), (80.1, 5.0), (5.0, -3.0), (5.0, 60.5)])
def test_a_measurement_outside_the_region_is_refused_with_the_expected_range(place):
    request = MeasurementRequest(sample_id="r1s1", x_m=place[0], y_m=place[1], depth_m=0.1)
    (refusal,) = field().handle(QueryReceived(MEASURE, request, 7), 0)
    assert isinstance(refusal, RefuseQuery)
    assert refusal.token == 7
    assert "\n" not in refusal.why
    assert "0..80 m east and 0..60 m north" in refusal.why
    assert f"{place[0]:g}" in refusal.why


def test_terrain_is_returned_in_the_order_of_the_places():
    reply = terrain(field(), (15.0, 7.0), (0.5, 0.5), (79.0, 59.0))
    cells = [3 * 40 + 7, 0, 29 * 40 + 39]
    assert reply.elevation_m == tuple(cell / 10 for cell in cells)
    assert reply.slope_deg == tuple(cell / 100 for cell in cells)
    assert reply.traversable == (False, True, True)


def test_places_outside_the_region_are_not_traversable():
    assert terrain(field(), (-0.01, 5.0), (5.0, 60.01), (500.0, 500.0), (0.0, 0.0)).traversable == (
        False,
        False,
        False,
        True,
    )


def test_hidden_hazards_close_terrain_that_the_map_shows_open():
    node = field(hidden_hazards=5, hazard_radius_m=3.0)
    assert len(node.hazards_m) == 5
    for x, y in node.hazards_m:
        assert not terrain(node, (x, y)).traversable[0]
        assert math.dist((x, y), (10.0, 10.0)) > 3.0 + START_CLEARANCE_M
    assert terrain(node, (10.0, 10.0)).traversable[0]


def test_hidden_hazards_are_a_function_of_the_seed():
    one, again, other = (hazard_places(GRID, 20, 3.0, seed, (10.0, 10.0)) for seed in (1, 1, 2))
    assert one == again
    assert not set(one) & set(other)


def test_more_hazards_of_a_seed_include_the_fewer():
    assert hazard_places(GRID, 20, 3.0, 1, (10.0, 10.0))[:5] == hazard_places(GRID, 5, 3.0, 1, (10.0, 10.0))


def test_a_hazard_smaller_than_a_cell_closes_the_cell_that_it_is_in():
    hidden = covered(GRID, ((0.2, 0.2),), 0.1)
    assert hidden.sum() == 1
    assert hidden[0, 0]


def test_a_region_without_room_for_the_hazards_is_refused():
    with pytest.raises(InvalidInput, match="room for 3 hidden hazards"):
        hazard_places(SiteGrid(10, 10), 3, 3.0, 1, (5.0, 5.0))


def test_the_field_reacts_to_queries_only():
    node = field()
    assert node.handle(Started(1), 0) == []
    assert node.handle(TimerFired("anything"), 0) == []


def test_the_field_takes_seed_noise_and_start_from_its_scenario():
    scenario = Scenario(name="x", region="t1", seed=9, field=FieldConfig(noise_std_ppb=0.2))
    reply = measured(build_node(scenario, region()), 1.0, 1.0, "s")
    assert reply.helium3_ppb == 1.0 + sample_noise(9, "s", 0.2)


# --- noise --------------------------------------------------------------------------------------------------------


def test_noise_is_standard_normal_times_its_deviation():
    draws = np.array([sample_noise(1, f"r{r}s{s}", 0.1) for r in range(100) for s in range(20)]) / 0.1
    assert stats.kstest(draws, "norm").pvalue > 0.01
    assert abs(draws.mean()) < 4 / math.sqrt(len(draws))


def test_noise_of_neighbouring_ids_and_seeds_is_uncorrelated():
    a = np.array([sample_noise(1, f"s{k}", 1.0) for k in range(1000)])
    b = np.array([sample_noise(2, f"s{k}", 1.0) for k in range(1000)])
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.13
    assert abs(np.corrcoef(a[1:], a[:-1])[0, 1]) < 0.13


def test_noise_scales_with_its_deviation():
    assert sample_noise(3, "s", 0.0) == 0.0
    assert sample_noise(3, "s", 2.0) == 2.0 * sample_noise(3, "s", 1.0)


def test_noise_is_the_same_in_another_process():
    code = "from he3.measurement import sample_noise; print(repr(sample_noise(4, 'r7s3', 0.1)))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(ran.stdout) == sample_noise(4, "r7s3", 0.1)


@pytest.mark.parametrize("std", [-0.1, math.nan, math.inf])
def test_a_negative_or_non_finite_deviation_is_refused(std):
    with pytest.raises(InvalidInput, match="standard deviation"):
        sample_noise(1, "s", std)

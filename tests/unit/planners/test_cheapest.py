"""The cheapest way between two places: never costlier than the taut line, and not over steeper ground."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from scipy import ndimage

from he3.driving import DrivenGround
from he3.driving_cost import TerrainCost, terrain_cost
from he3.errors import InvalidInput
from he3.frames import SiteGrid, path_length
from he3.gp import Hyperparameters
from he3.kernels import Matern12
from he3.terrain import slope_deg
from services.ground.planners import plan
from services.ground.planners.cheapest import cheapest_way, cheapest_ways, cut
from services.ground.planners.gentle import on_gentle_ground
from services.ground.planners.interface import PlannerOptions, PlanningRequest
from services.ground.planners.tour.paths import shortest_path
from services.ground.planners.traversability import OpenGround
from services.ground.planners.trees import cheaper_path
from services.ground.state_types import STATE_TYPES
from services.mission.scenario import RoverConfig
from services.runtime.state_codec import StateCodec

GRID = SiteGrid(60, 60, 5.0)
QUICK = {"designs": 1.0, "final_steps": 0.0, "first_steps": 15.0, "steps": 6.0, "kicks": 5.0}


def hilly(seed: int, kind: str = "energy") -> tuple[OpenGround, TerrainCost]:
    """Hills with closed peaks and hollows, and what driving over them costs."""
    heights = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=GRID.shape), 3) * 45.0
    slopes = slope_deg(heights, GRID.resolution_m)
    cost = terrain_cost(kind, DrivenGround(GRID, slopes, heights, RoverConfig().driving))  # type: ignore[arg-type]
    assert cost is not None
    return OpenGround(GRID, slopes < np.quantile(slopes, 0.85)), cost


def pairs(ground: OpenGround, seed: int, count: int) -> np.ndarray:
    """Pairs of places (count, 2, 2) [m] in the largest open part."""
    labels, _ = ndimage.label(ground.open)
    cells = np.argwhere(labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:])))
    chosen = np.random.default_rng(seed).choice(len(cells), (count, 2))
    return (cells[chosen][:, :, ::-1] + 0.5) * GRID.resolution_m


@pytest.mark.parametrize("kind", ["time", "energy"])
@pytest.mark.parametrize("seed", range(2))
def test_a_way_is_free_and_never_costlier_or_steeper_than_the_taut_line(kind, seed) -> None:
    ground, cost = hilly(seed, kind)
    saved = 0.0
    for begin, end in pairs(ground, seed, 6):
        taut = shortest_path(ground, begin, end)
        way = cheapest_way(ground, cost, taut, seed, iterations=100)
        assert ground.segments_free(way[:-1], way[1:]).all()
        assert way[0] == pytest.approx(begin)
        assert way[-1] == pytest.approx(end)
        assert cost.of_path(way) <= cost.of_path(taut)
        assert cost.steepest_deg(way) <= cost.steepest_deg(taut)
        saved += cost.of_path(taut) - cost.of_path(way)
    assert saved > 0.0


def test_a_ridge_across_the_way_is_left_aside() -> None:
    heights = np.zeros(GRID.shape)
    heights[10:50, 28:32] = 8.0
    slopes = slope_deg(heights, GRID.resolution_m)
    ground = DrivenGround(
        GRID, np.minimum(slopes, 10.0), heights, replace(RoverConfig().driving, climb_j_per_m=70_000.0)
    )
    cost = terrain_cost("energy", ground)
    assert cost is not None
    straight = np.array([(62.5, 62.5), (237.5, 62.5)])
    way = cheapest_way(OpenGround(GRID, np.ones(GRID.shape, dtype=np.bool_)), cost, straight, 1)
    assert cost.of_path(straight) > 400.0
    assert cost.of_path(way) < 230.0


def test_the_tree_improves_what_it_is_given_and_follows_from_its_seed() -> None:
    ground, cost = hilly(3)
    better = 0
    for begin, end in pairs(ground, 4, 5):
        taut = shortest_path(ground, begin, end)
        found, again = (cheaper_path(ground, cost, taut, iterations=150, seed=7) for _ in range(2))
        assert found is not None
        assert again is not None
        assert np.array_equal(found, again)
        before, after = (cost.of_path(path) for path in (taut, found))
        assert after <= before * 1.01  # the known path enters the tree piece by piece
        better += after < before
    assert better


def test_stops_stay_where_they_are() -> None:
    path = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)])
    assert [piece.tolist() for piece in cut(path, np.array([5.0, 15.0]))] == [
        [[0.0, 0.0], [5.0, 0.0]],
        [[5.0, 0.0], [10.0, 0.0], [10.0, 5.0]],
        [[10.0, 5.0], [10.0, 10.0]],
    ]
    ground, cost = hilly(5)
    begin, end = pairs(ground, 5, 1)[0]
    taut = shortest_path(ground, begin, end)
    half = 0.5 * path_length(taut)
    ways = cheapest_ways(ground, cost, taut, np.array([half, 2.0 * half]), 1)
    middle = cut(taut, np.array([half]))[0][-1]
    assert np.hypot(*(ways - middle).T).min() < 1e-9
    assert cost.of_path(ways) <= cost.of_path(taut)


def request(seed: int, kind: str, budget_m: float) -> PlanningRequest:
    ground, cost = hilly(seed, kind)
    start = pairs(ground, seed, 1)[0, 0]
    return PlanningRequest(
        grid=GRID, traversable=ground.open, start_m=(float(start[0]), float(start[1])), observed_m=np.zeros((0, 2)),
        std_ppb=np.ones(GRID.shape, np.float32), hyperparameters=Hyperparameters(Matern12(1.0, 50.0), 0.1, 8.0, 1.0),
        samples=3, samples_left=9, budget_m=budget_m, seed=seed, cost=cost,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("planner", "extra"), [("tour", QUICK), ("informative", {"iterations": 300.0}), ("rrtstar", {})]
)
@pytest.mark.parametrize("kind", ["time", "energy"])
def test_a_round_keeps_to_its_budget_in_level_metres(planner, extra, kind) -> None:
    asked = replace(request(1, kind, 300.0), options=PlannerOptions(extra=extra))
    answer = plan(planner, asked)  # the answer is checked against the budget there, too
    assert asked.cost is not None
    assert asked.cost.of_path(answer.path_m) <= 300.0 * (1.0 + 1e-9)
    assert answer.length_m < asked.cost.of_path(answer.path_m)


def test_a_plan_in_work_that_has_a_cost_is_kept_in_a_checkpoint() -> None:
    asked, codec = request(1, "energy", 300.0), StateCodec(STATE_TYPES)
    again = codec.decode(codec.encode(asked))
    assert asked.cost is not None
    begins, ends = pairs(hilly(1)[0], 1, 8).transpose(1, 0, 2)
    np.testing.assert_array_equal(again.cost.of_legs(begins, ends), asked.cost.of_legs(begins, ends))


def test_the_way_from_the_edge_of_a_cell_is_paid_for_too() -> None:
    """A rover on the edge of a closed cell first drives to the centre of its own."""
    asked = request(1, "energy", 60.0)
    rows, columns = np.nonzero(asked.traversable[:, 1:] & ~asked.traversable[:, :-1])
    x, y = (float(columns[0]) + 1.0) * 5.0, (float(rows[0]) + 0.5) * 5.0
    for planner in ("rrtstar", "informative"):
        extra = {"iterations": 300.0} if planner == "informative" else {}
        edge = replace(asked, start_m=(x, y), options=PlannerOptions(extra=extra))
        answer = plan(planner, edge)  # an answer beyond its budget is refused
        assert edge.cost is not None
        assert answer.length_m < edge.cost.of_path(answer.path_m) <= 60.0 * (1.0 + 1e-9)


def test_an_answer_beyond_its_budget_in_level_metres_is_refused() -> None:
    asked = request(1, "energy", inf)
    answer = plan("rrtstar", asked)
    assert asked.cost is not None
    between = 0.5 * (answer.length_m + asked.cost.of_path(answer.path_m))

    def planner(_request: PlanningRequest) -> object:
        return answer

    from services.ground.planners.validation import checked_answer

    with pytest.raises(InvalidInput, match=r"expected .* level m at most"):
        checked_answer("theirs", planner(asked), replace(asked, budget_m=between))


def test_the_steepest_ground_is_left_out_where_nothing_else_is_cut_off() -> None:
    asked = request(2, "energy", inf)
    assert asked.cost is not None
    gentle = on_gentle_ground(asked).traversable
    slopes = asked.cost.slope_deg
    assert slopes[gentle].max() < slopes[asked.traversable].max()
    assert gentle.sum() > 0.95 * OpenGround(GRID, asked.traversable).connected_to(asked.start_m).sum()
    assert on_gentle_ground(replace(asked, cost=None)).traversable is asked.traversable

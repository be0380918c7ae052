"""With a goal, `tour` plans the shortest tour that reaches it, sees when it cannot, and stops when it is there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest

from he3.certificate import MOST_UNSEEN_PLACE, Targets, blocks_of, places_of, unseen_share
from he3.cover import CoverProblem
from he3.frames import SiteGrid
from he3.gp import Hyperparameters
from he3.i_optimal_design import field_nodes
from he3.kernels import Matern12, SquaredExponential
from services.ground.planners import plan
from services.ground.planners.interface import PlannedRound, PlannerOptions, PlanningGoal, PlanningRequest
from services.ground.planners.tour import covering
from services.ground.planners.tour.covering import in_order, kernels_to_satisfy, tour_metres
from services.ground.planners.tour.site import reachable_site

GRID = SiteGrid(40, 40, 7.5)
SMOOTH, ROUGH = SquaredExponential(1.0, 55.0), Matern12(1.0, 80.0)
BELIEF = Hyperparameters(SMOOTH, 0.1, 8.0, 1.0)
QUICK = PlannerOptions(extra={"designs": 1.0, "final_steps": 0.0, "first_steps": 10.0, "steps": 6.0, "kicks": 5.0})
NONE = np.zeros((0, 2))


def walled() -> np.ndarray:
    """Open ground with a wall from the south that leaves a gap in the north."""
    cells = np.ones(GRID.shape, dtype=bool)
    cells[:32, 19:21] = False
    return cells


def everywhere(std_ppb: float, probability: float = 0.95) -> PlanningGoal:
    return PlanningGoal(places_of(GRID, np.ones(GRID.shape, dtype=bool), 400), std_ppb, probability)


def request(goal: PlanningGoal | None, **changes: Any) -> PlanningRequest:
    whole: dict[str, Any] = {
        "grid": GRID, "traversable": walled(), "start_m": (12.5, 12.5), "observed_m": NONE,
        "std_ppb": np.ones(GRID.shape, np.float32), "hyperparameters": BELIEF, "samples": 100, "samples_left": 100,
        "budget_m": inf, "seed": 1, "options": QUICK, "goal": goal,
    }  # fmt: skip
    return PlanningRequest(**(whole | changes))


def reaches(goal: PlanningGoal, places: np.ndarray, belief: Hyperparameters = BELIEF) -> bool:
    return CoverProblem([belief], NONE, goal.targets, goal.std_ppb).holds(places)


@pytest.fixture(autouse=True, scope="module")
def a_short_search() -> Iterator[None]:
    """Fewer starts than missions have: what is tested holds for any number of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(covering, "ROW_SPACINGS", (0.8,))
        patch.setattr(covering, "FAILURES", 1)
        patch.setattr(covering, "STEPS", 30)
        yield


@pytest.fixture(scope="module")
def whole_tour(a_short_search: None) -> PlannedRound:
    """The tour to a standard deviation of 0.75 at every cell, at once."""
    return plan("tour", request(everywhere(0.75)))


def test_after_the_tour_the_goal_holds_and_the_forecast_says_so(whole_tour: PlannedRound) -> None:
    goal = everywhere(0.75)
    assert reaches(goal, whole_tour.samples_m)
    forecast = whole_tour.forecast
    assert forecast is not None
    assert forecast.reachable
    assert forecast.samples == len(whole_tour.samples_m) < 40
    assert forecast.metres == pytest.approx(whole_tour.length_m, rel=0.15)


def test_the_tour_is_much_shorter_than_one_through_a_pruned_greedy_cover(whole_tour: PlannedRound) -> None:
    goal = everywhere(0.75)
    kernels = kernels_to_satisfy(BELIEF, goal, NONE, GRID.extent_m)
    problem = CoverProblem(kernels, NONE, goal.targets, goal.std_ppb)
    greedy = problem.pruned(problem.added(NONE, goal.targets.centres_m, 100))
    site = reachable_site(GRID, walled(), 0.0, (12.5, 12.5), field_nodes(GRID, None))
    greedy_m = tour_metres(site, in_order(site, site.snap_to_cell_centres(greedy)))
    assert whole_tour.length_m < 0.92 * greedy_m


def test_round_by_round_it_comes_to_an_end_where_the_goal_holds() -> None:
    goal, now, taken = everywhere(0.75), request(everywhere(0.75), samples=6), NONE
    for _ in range(12):
        answer = plan("tour", now)
        taken = np.vstack((taken, answer.samples_m))
        if reaches(goal, taken):
            break
        end = answer.path_m[-1]
        now = replace(
            now, start_m=(float(end[0]), float(end[1])), observed_m=taken, samples_left=100 - len(taken),
            outlook_m=answer.outlook_m, seed=now.seed + 1,
        )  # fmt: skip
    assert reaches(goal, taken)
    assert len(taken) < 42


def test_a_goal_beyond_the_samples_or_the_metres_is_foreseen_and_sampling_goes_on() -> None:
    few = plan("tour", request(everywhere(0.6), samples=5, samples_left=8))
    assert few.forecast is not None
    assert not few.forecast.reachable
    assert few.forecast.samples is None
    assert len(few.samples_m) == 5
    short = plan("tour", request(everywhere(0.75), samples=5, budget_m=300.0))
    assert short.forecast is not None
    assert not short.forecast.reachable
    assert "of 300 m left" in short.forecast.text


def test_where_the_goal_holds_already_for_the_planner_one_sample_is_taken_where_the_map_knows_least() -> None:
    axis = np.arange(26.25, 300.0, 45.0)
    lattice = np.column_stack([values.ravel() for values in np.meshgrid(axis, axis)])
    unknown = np.array([206.25, 116.25])  # the lattice lacks the places round it
    taken = lattice[np.linalg.norm(lattice - unknown, axis=1) > 70.0]
    answer = plan("tour", request(everywhere(5.0), observed_m=taken))
    (sample,) = answer.samples_m
    assert np.linalg.norm(sample - unknown) < 25.0


def test_the_whole_site_is_sampled_though_the_samples_of_one_corner_seem_to_make_it_known() -> None:
    corner = np.stack(np.meshgrid((np.arange(4) + 0.5) * 25.0, (np.arange(4) + 0.5) * 25.0), axis=-1).reshape(-1, 2)
    answer = plan("tour", request(everywhere(5.0), observed_m=corner, start_m=(37.5, 37.5)))
    assert (
        unseen_share(np.vstack((corner, answer.samples_m)), everywhere(5.0).targets, GRID.extent_m) <= MOST_UNSEEN_PLACE
    )


def test_the_kernels_to_satisfy_have_the_probability_and_leave_out_the_most_uncertain() -> None:
    belief = replace(BELIEF, alternatives=((0.5, SMOOTH), (0.46, ROUGH), (0.04, Matern12(9.0, 5.0))))
    *learned, _ = kernels_to_satisfy(belief, everywhere(0.7), NONE, GRID.extent_m)
    assert [one.kernel for one in learned] == [SMOOTH, ROUGH]
    assert len(kernels_to_satisfy(belief, everywhere(0.7, 0.97), NONE, GRID.extent_m)) == 4
    goal = everywhere(0.85)
    answer = plan("tour", request(goal, hyperparameters=belief))
    for kernel in (SMOOTH, ROUGH):
        assert reaches(goal, answer.samples_m, replace(BELIEF, kernel=kernel))


def test_blocks_and_a_corner_take_fewer_metres_than_the_whole_site(whole_tour: PlannedRound) -> None:
    corner = np.zeros(GRID.shape, dtype=bool)
    corner[20:, 20:] = True
    for targets in (blocks_of(GRID, 60.0), places_of(GRID, corner, 400)):
        goal = PlanningGoal(Targets(targets.points_m), 0.75, 0.95)
        answer = plan("tour", request(goal))
        assert reaches(goal, answer.samples_m)
        assert answer.length_m < whole_tour.length_m

"""The planner `tour` stays on open ground and within its budget, follows its outlook, and lowers the variance."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from scipy import ndimage

from he3.errors import InvalidInput, NoRoute
from he3.frames import SiteGrid
from he3.gp import Hyperparameters
from he3.i_optimal_design import AverageVariance, field_nodes
from he3.kernels import Matern12, SquaredExponential
from services.ground.planners import plan
from services.ground.planners.interface import PlannerOptions, PlanningRequest
from services.ground.planners.tour.planner import clamp_length_scales
from services.ground.planners.traversability import OpenGround

SIDE = 120
GRID = SiteGrid(SIDE, SIDE)
BELIEF = Hyperparameters(Matern12(1.0, 20.0), 0.1, 8.0, 1.0)
QUICK = PlannerOptions(extra={"designs": 1.0, "final_steps": 0.0, "first_steps": 15.0, "steps": 6.0, "kicks": 5.0})


def rough(seed=0, share=0.12):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal((SIDE, SIDE)), 3)
    traversable = noise < np.quantile(noise, 1 - share)
    traversable[:12, :12] = True
    return traversable


def request(**changes):
    start = changes.pop("start_m", (5.5, 5.5))
    whole = {
        "grid": GRID,
        "traversable": rough(),
        "start_m": start,
        "observed_m": np.zeros((0, 2)),
        "std_ppb": np.ones(GRID.shape, np.float32),
        "hyperparameters": BELIEF,
        "samples": 5,
        "samples_left": 30,
        "budget_m": inf,
        "seed": 1,
        "options": QUICK,
    }
    return PlanningRequest(**(whole | changes))


def mission(first, rounds=100):
    """Planned rounds until no sample is left, each beginning where the last one ended."""
    flown, now = [], first
    for _ in range(rounds):
        answer = plan("tour", now)
        flown.append(answer)
        left = now.samples_left - len(answer.samples_m)
        if not left:
            break
        end = answer.path_m[-1]
        now = replace(
            now, start_m=(float(end[0]), float(end[1])), observed_m=np.vstack((now.observed_m, answer.samples_m)),
            samples=min(now.samples, left), samples_left=left, budget_m=now.budget_m - answer.length_m,
            seed=now.seed + 1, outlook_m=answer.outlook_m,
        )  # fmt: skip
    return flown


def is_on(path, place):
    a, b = path[:-1], path[1:]
    along = np.clip(((place - a) * (b - a)).sum(1) / np.maximum(((b - a) ** 2).sum(1), 1e-12), 0, 1)
    return np.hypot(*(a + along[:, None] * (b - a) - place).T).min() < 1e-6


def check(asked, answer):
    ground = OpenGround(asked.grid, asked.traversable)
    assert answer.path_m[0].tolist() == list(asked.start_m)
    assert ground.segments_free(answer.path_m[:-1], answer.path_m[1:]).all()
    assert answer.samples_m.shape == (asked.samples, 2)
    assert ground.is_open(answer.samples_m).all()
    assert all(is_on(answer.path_m, place) for place in answer.samples_m)
    assert answer.length_m <= asked.budget_m
    assert answer.information_nats > 0


@pytest.mark.parametrize("seed", range(4))
def test_a_round_is_driven_on_open_ground_and_samples_on_its_path(seed):
    asked = request(traversable=rough(seed, share=0.2), seed=seed)
    check(asked, plan("tour", asked))


def test_the_same_request_gives_the_same_round():
    one, other = plan("tour", request()), plan("tour", request())
    assert one.path_m.tobytes() == other.path_m.tobytes()
    assert one.samples_m.tobytes() == other.samples_m.tobytes()


@pytest.mark.parametrize("samples", [1, 7, 30])
def test_any_number_of_samples_can_make_a_round(samples):
    asked = request(samples=samples)
    answer = plan("tour", asked)
    check(asked, answer)
    assert answer.outlook_m.shape == (30 - samples, 2)


@pytest.mark.parametrize("budget", [3.0, 60.0, 250.0, 450.0])
def test_a_mission_takes_all_its_samples_and_never_exceeds_its_budget(budget):
    flown = mission(request(budget_m=budget, samples=4))
    assert sum(len(answer.samples_m) for answer in flown) == 30
    driven = sum(answer.length_m for answer in flown)
    assert driven <= budget
    assert driven >= 0.85 * budget  # metres are information as long as they are this few


def test_a_mission_drives_what_its_first_plan_foresaw():
    first = plan("tour", request(samples=30))
    flown = mission(request())
    assert sum(answer.length_m for answer in flown) == pytest.approx(first.length_m, rel=0.08)


def test_samples_spread_over_the_field_and_not_over_its_border():
    flown = mission(request(traversable=np.ones(GRID.shape, bool)))
    places = np.vstack([answer.samples_m for answer in flown])
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    np.fill_diagonal(apart, np.inf)
    assert apart.min() > 0.5 * SIDE / np.sqrt(30)
    assert np.minimum(places, SIDE - places).min() > 3.0


def test_the_design_beats_random_places_by_far_and_a_lattice_by_metres():
    flown = mission(request(traversable=np.ones(GRID.shape, bool)))
    variance = AverageVariance(BELIEF.kernel.of_squared_distance, 0.01, field_nodes(GRID, None), np.zeros((0, 2)))
    places = np.vstack([answer.samples_m for answer in flown])
    rng = np.random.default_rng(0)
    at_random = np.mean([variance(rng.uniform(0, SIDE, (30, 2))) for _ in range(20)])
    x, y = (np.arange(6) + 0.5) * SIDE / 6, (np.arange(5) + 0.5) * SIDE / 5
    lattice = np.column_stack([axis.ravel() for axis in np.meshgrid(x, y)])
    assert variance(places) < 0.93 * at_random
    assert variance(places) < 1.03 * variance(lattice)
    assert sum(answer.length_m for answer in flown) < 5 * 100 + 4 * 24 + 5 * 20 + 20  # row by row


def test_halving_the_metres_costs_little_variance():
    variance = AverageVariance(BELIEF.kernel.of_squared_distance, 0.01, field_nodes(GRID, None), np.zeros((0, 2)))
    free = mission(request())
    driven = sum(answer.length_m for answer in free)
    held = mission(request(budget_m=driven / 2))
    left = [variance(np.vstack([answer.samples_m for answer in flown])) for flown in (free, held)]
    assert left[1] < 1.3 * left[0]
    assert left[1] < variance(np.random.default_rng(0).uniform(0, SIDE, (15, 2)))  # half the samples at random


def test_a_weight_of_interest_draws_samples():
    interest = np.full(GRID.shape, 0.05, np.float32)
    interest[:, 60:] = 1.0
    places = np.vstack([answer.samples_m for answer in mission(request(interest=interest))])
    assert (places[:, 0] > 60).mean() > 0.7


def test_samples_taken_are_not_taken_again():
    taken = np.array([(x, y) for x in np.arange(70.0, 120.0, 12) for y in np.arange(6.0, 120.0, 12)])
    places = np.vstack([answer.samples_m for answer in mission(request(observed_m=taken, samples_left=20))])
    assert (places[:, 0] < 66).mean() >= 0.8


def test_an_island_is_never_visited():
    traversable = np.ones(GRID.shape, bool)
    traversable[50:52, 40:] = traversable[50:, 40:42] = False
    for answer in mission(request(traversable=traversable)):
        assert OpenGround(GRID, traversable).segments_free(answer.path_m[:-1], answer.path_m[1:]).all()
        assert not ((answer.samples_m > (42, 52)).all(axis=1)).any()


def test_a_maze_is_driven_along_its_corridors():
    traversable = np.ones(GRID.shape, bool)
    for number, x in enumerate(range(15, 110, 15)):
        traversable[slice(0, 110) if number % 2 else slice(10, None), x : x + 2] = False
    flown = mission(request(traversable=traversable))
    assert all(
        OpenGround(GRID, traversable).segments_free(answer.path_m[:-1], answer.path_m[1:]).all() for answer in flown
    )
    places = np.vstack([answer.samples_m for answer in flown])
    assert np.ptp(places[:, 0]) > 90


def test_an_outlook_over_ground_that_has_closed_is_moved_to_where_it_is_open():
    first = plan("tour", request())
    closed = rough()
    for x, y in first.outlook_m.astype(int):
        closed[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3] = False
    closed[:12, :12] = True
    asked = request(traversable=closed, samples_left=25, outlook_m=first.outlook_m)
    check(asked, plan("tour", asked))


@pytest.mark.parametrize("more", [-20, -5, 5, 20])
def test_an_outlook_over_more_or_fewer_samples_is_no_hindrance(more):
    first = plan("tour", request(samples_left=30 + more))
    asked = request(outlook_m=np.vstack((first.samples_m, first.outlook_m)))
    answer = plan("tour", asked)
    check(asked, answer)
    assert len(answer.outlook_m) == 25


def test_an_outlook_that_is_a_few_places_short_keeps_those_that_it_has():
    first = plan("tour", request())
    lost = np.vstack((first.samples_m, first.outlook_m))[3:]
    answer = plan("tour", request(outlook_m=lost))
    again = np.vstack((answer.samples_m, answer.outlook_m))
    moved = np.hypot(*(lost[:, None] - again[None]).transpose(2, 0, 1)).min(axis=1)
    assert np.median(moved) < 5.0


def test_a_rover_on_the_edge_of_a_closed_cell_starts_all_the_same():
    traversable = np.ones(GRID.shape, bool)
    traversable[10:20, 9] = False
    answer = plan("tour", request(traversable=traversable, start_m=(10.0, 15.0)))
    assert answer.path_m[0].tolist() == [10.0, 15.0]
    assert OpenGround(GRID, traversable).segments_free(answer.path_m[1:-1], answer.path_m[2:]).all()


@pytest.mark.parametrize("budget", [0.0, -5.0])
def test_a_spent_budget_is_no_route(budget):
    with pytest.raises(NoRoute, match="budget is spent"):
        plan("tour", request(budget_m=budget))


def test_a_walled_in_rover_has_no_route():
    traversable = np.ones(GRID.shape, bool)
    traversable[4:7, 4:7] = False
    traversable[5, 5] = True
    with pytest.raises(NoRoute, match="walled in"):
        plan("tour", request(traversable=traversable))


def test_a_rover_on_closed_ground_has_no_route():
    with pytest.raises(NoRoute, match="may not cross"):
        plan("tour", request(traversable=np.zeros(GRID.shape, bool)))


def test_unknown_settings_are_refused_by_name():
    with pytest.raises(InvalidInput, match="haste"):
        plan("tour", request(options=PlannerOptions(extra={"haste": 1.0})))


@pytest.mark.parametrize("kernel", [SquaredExponential(1.0, 500.0), Matern12(1.0, 5.0), SquaredExponential(1.0, 5.0)])
def test_hyperparameters_at_their_bounds_still_make_a_tour(kernel):
    asked = request(hyperparameters=replace(BELIEF, kernel=kernel))
    check(asked, plan("tour", asked))
    places = np.vstack([answer.samples_m for answer in mission(asked)])
    assert (np.ptp(places, axis=0) > 70).all()


def test_only_length_scales_beyond_their_bounds_are_brought_back():
    assert clamp_length_scales(Matern12(2.0, 30.0), 10.0, 100.0) == Matern12(2.0, 30.0)
    assert clamp_length_scales(Matern12(2.0, 5.0), 10.0, 100.0) == Matern12(2.0, 10.0)
    assert clamp_length_scales(SquaredExponential(2.0, 400.0), 10.0, 100.0) == SquaredExponential(2.0, 100.0)


def test_coarse_cells_are_sampled_as_well():
    grid = SiteGrid(40, 50, 5.0)
    asked = request(
        grid=grid, traversable=np.ones(grid.shape, bool), std_ppb=np.ones(grid.shape, np.float32), start_m=(7.5, 7.5)
    )
    check(asked, plan("tour", asked))


@pytest.mark.parametrize("seed", [15, 79, 126])
def test_one_sample_in_a_small_cave_may_be_where_the_rover_stands(seed):
    cave = np.random.default_rng(seed).random((28, 28)) < 0.6
    cave[21, 10] = True
    asked = request(
        grid=SiteGrid(28, 28), traversable=cave, start_m=(10.5, 21.5), samples=1, samples_left=1, seed=seed,
        std_ppb=np.ones((28, 28), np.float32),
    )  # fmt: skip
    check(asked, plan("tour", asked))

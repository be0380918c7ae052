"""Rules for every planner: no returned path crosses an obstacle, leaves the region or exceeds the budget."""

from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.errors import InvalidInput, NoRoute, OutsideRegion
from he3.frames import SiteGrid, path_length
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import Matern52, SmoothPlusRough
from services.ground.planners import PLANNERS, plan, planner_named
from services.ground.planners.interface import PlannedRound, PlannerOptions, PlanningRequest
from services.ground.planners.polyline import arc_lengths, path_prefix, places_along
from services.ground.planners.rounds import after_way_back
from services.ground.planners.visiting import visiting

NAMES = sorted(PLANNERS)
SIZE = 28
QUICK_TOUR = {"designs": 1.0, "final_steps": 0.0, "first_steps": 15.0, "steps": 6.0, "kicks": 5.0}
"""Settings with which `tour` searches little: what holds for every plan holds for that one, too."""


def quick(name, request):
    """The request, to be planned in little time."""
    if name != "tour":
        return request
    return replace(request, options=replace(request.options, extra=QUICK_TOUR))


def request_over(mask, start_m=(5.2, 5.2), **changes):
    """A request over a small field with every field set."""
    given_values = {
        "grid": SiteGrid(*mask.shape),
        "traversable": mask,
        "start_m": start_m,
        "observed_m": np.empty((0, 2)),
        "hyperparameters": Hyperparameters(Matern52(1.0, 8.0), mean_ppb=7.0, scale_ppb=1.5),
        "samples": 3,
        "samples_left": 12,
        "budget_m": inf,
        "seed": 1,
        "options": PlannerOptions(clearance_m=3.0, step_m=4.0, goal_tolerance_m=2.0, max_iterations=700),
    } | changes
    if "std_ppb" not in given_values:
        belief = GaussianProcess(given_values["hyperparameters"])
        if len(given_values["observed_m"]):
            belief = belief.condition_on_places(given_values["observed_m"])
        grid = given_values["grid"]
        given_values["std_ppb"] = belief.predict(grid.points())[1].astype(np.float32).reshape(grid.shape)
    return PlanningRequest(**given_values)


def keeps_margin(request: PlanningRequest, place: np.ndarray) -> bool:
    """Whether a rover as wide as the request's margin is on open ground there."""
    angles = np.arange(8) * np.pi / 4
    rim = place + 0.999 * request.margin_m * np.column_stack((np.cos(angles), np.sin(angles)))
    rim = rim[request.grid.contains(rim)]
    return bool(request.traversable[request.grid.cells_of(rim)].all())


def expect_sound(request: PlanningRequest, answer: PlannedRound) -> None:
    """Check a round against its request by dense sampling, without code of the planners."""
    path, grid = answer.path_m, request.grid
    assert path[0].tolist() == list(request.start_m)
    assert answer.length_m <= request.budget_m * (1 + 1e-12)
    for a, b in pairwise(path):
        count = int(np.hypot(*(b - a)) / grid.resolution_m * 40) + 2
        dense = a + np.linspace(0, 1, count)[:, None] * (b - a)
        assert request.traversable[grid.cells_of(dense)].all()  # cells_of raises for a place outside
        if keeps_margin(request, a):  # a rover that stands nearer to closed ground first drives to its cell's centre
            assert all(keeps_margin(request, place) for place in dense)
    assert answer.samples_m.shape == (request.samples, 2)
    assert request.traversable[grid.cells_of(answer.samples_m)].all()
    reached = 0.0
    along = arc_lengths(path)
    for sample in answer.samples_m:  # each lies on the path, at or after the one before
        ahead = []
        for k, (a, b) in enumerate(pairwise(path)):
            leg = b - a
            length = np.hypot(*leg)
            t = 0.0 if length == 0 else float(np.clip((sample - a) @ leg / length**2, 0, 1))
            at = along[k] + t * length
            if np.hypot(*(a + t * leg - sample)) < 1e-6 and at >= reached - 1e-6:
                ahead.append(at)
        assert ahead, "a sample place is not on the path, or out of order"
        reached = min(ahead)
    assert np.isfinite(answer.information_nats)
    assert answer.information_nats >= 0.0


def noise(draw):
    share = draw(st.sampled_from([0.02, 0.1, 0.3, 0.45]))
    return np.random.default_rng(draw(st.integers(0, 2**32 - 1))).random((SIZE, SIZE)) > share


def maze(draw):
    """Corridors three cells wide between walls one cell wide, by depth-first search."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    rooms = SIZE // 4
    stack, seen = [(0, 0)], {(0, 0)}
    mask[0:3, 0:3] = True
    while stack:
        r, c = stack[-1]
        ways = [(r + i, c + j) for i, j in ((0, 1), (1, 0), (0, -1), (-1, 0))]
        ways = [w for w in ways if w not in seen and 0 <= w[0] < rooms and 0 <= w[1] < rooms]
        if not ways:
            stack.pop()
            continue
        nr, nc = ways[rng.integers(len(ways))]
        mask[4 * min(r, nr) : 4 * max(r, nr) + 3, 4 * min(c, nc) : 4 * max(c, nc) + 3] = True
        seen.add((nr, nc))
        stack.append((nr, nc))
    return mask


def islands(draw):
    mask = np.ones((SIZE, SIZE), dtype=bool)
    for _ in range(draw(st.integers(1, 3))):
        k = draw(st.integers(2, SIZE - 3))
        if draw(st.booleans()):
            mask[k, :] = False
        else:
            mask[:, k] = False
    return mask


@st.composite
def requests(draw):
    mask = draw(st.sampled_from([noise, maze, islands]))(draw)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    open_cells = np.argwhere(mask)
    row, column = open_cells[rng.integers(len(open_cells))]
    offset = draw(st.sampled_from([(0.5, 0.5), (0.0, 0.0), tuple(rng.random(2).tolist())]))
    count = draw(st.sampled_from([0, 1, 6]))
    resolution = draw(st.sampled_from([1.0, 2.0]))
    samples = draw(st.integers(1, 6))
    interest = rng.random(mask.shape).astype(np.float32) if draw(st.booleans()) else None
    return request_over(
        mask,
        ((float(column) + offset[0]) * resolution, (float(row) + offset[1]) * resolution),
        grid=SiteGrid(*mask.shape, resolution),
        observed_m=(open_cells[rng.integers(len(open_cells), size=count)][:, ::-1] + 0.5) * resolution,
        samples=samples,
        samples_left=samples * draw(st.integers(1, 8)),
        budget_m=draw(st.sampled_from([inf, 1000.0, 40.0, 1.5])),
        seed=draw(st.integers(0, 2**40)),
        interest=interest,
        margin_m=draw(st.sampled_from([0.0, 0.0, 0.15])) * resolution,
    )


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=25)
@given(requests())
def test_a_round_keeps_to_open_ground_to_the_region_and_to_the_budget_or_is_refused(name, request_):
    expect_sound_or_refused(name, quick(name, request_))


@pytest.mark.exhaustive
@settings(max_examples=100)
@given(requests())
def test_a_tour_that_searches_long_keeps_to_open_ground_to_the_region_and_to_the_budget_or_is_refused(request_):
    expect_sound_or_refused("tour", request_)


def expect_sound_or_refused(name, request_):
    refusal, answer = None, None
    try:
        answer = plan(name, request_)
    except NoRoute as error:
        refusal = str(error)
    if answer is not None:
        expect_sound(request_, answer)
    else:
        assert refusal
        assert "\n" not in refusal


@pytest.mark.parametrize("name", NAMES)
def test_a_plan_follows_from_its_request_whatever_was_planned_before(name):
    mask = np.random.default_rng(5).random((SIZE, SIZE)) > 0.05
    mask[4:7, 4:7] = True
    first, second = (quick(name, request_over(mask, seed=s)) for s in (1, 2))
    alone = plan(name, first)
    plan(name, second)
    again = plan(name, first)
    np.testing.assert_array_equal(alone.path_m, again.path_m)
    np.testing.assert_array_equal(alone.samples_m, again.samples_m)
    assert alone.information_nats == again.information_nats


@pytest.mark.parametrize("name", ["rrt", "rrtstar", "informative"])
def test_another_seed_makes_another_plan(name):
    mask = np.ones((SIZE, SIZE), dtype=bool)
    first, second = (plan(name, request_over(mask, seed=s)) for s in (1, 2))
    assert first.path_m.shape != second.path_m.shape or not np.allclose(first.path_m, second.path_m)


@pytest.mark.parametrize("name", NAMES)
def test_a_rover_that_is_walled_in_is_refused_in_one_clear_line(name):
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[3:8, 3:8] = False
    mask[5, 5] = True
    with pytest.raises(NoRoute, match=r"\(5\.[25], 5\.[25]\) m"):
        plan(name, request_over(mask))


@pytest.mark.parametrize("name", NAMES)
def test_a_rover_on_closed_ground_is_refused(name):
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[5, 5] = False
    with pytest.raises(NoRoute, match="may not"):
        plan(name, request_over(mask))


@pytest.mark.parametrize("name", NAMES)
def test_a_start_outside_the_region_is_refused(name):
    with pytest.raises(OutsideRegion, match="-1"):
        plan(name, request_over(np.ones((SIZE, SIZE), dtype=bool), (-1.0, 3.0)))


@pytest.mark.parametrize("name", NAMES)
def test_a_spent_budget_is_refused(name):
    with pytest.raises(NoRoute, match="budget"):
        plan(name, request_over(np.ones((SIZE, SIZE), dtype=bool), budget_m=0.0))


@pytest.mark.parametrize("name", NAMES)
def test_the_most_uncertain_ground_is_no_target_when_it_cannot_be_reached(name):
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[14, :] = False
    std = np.full(mask.shape, 0.1, dtype=np.float32)
    std[20:, 20:] = 5.0
    answer = plan(name, request_over(mask, std_ppb=std))
    assert (answer.path_m[:, 1] < 14.0).all()


@pytest.mark.parametrize("name", NAMES)
def test_a_whole_mission_stays_within_its_budget_and_takes_every_sample(name):
    mask = np.random.default_rng(8).random((60, 60)) > 0.04
    mask[4:7, 4:7] = True
    hyperparameters = Hyperparameters(Matern52(1.0, 15.0))
    budget, driven, start, observed = 200.0, 0.0, (5.2, 5.2), np.empty((0, 2))
    for left in range(24, 0, -4):
        request = request_over(
            mask, start, observed_m=observed, samples=4, samples_left=left, budget_m=budget - driven, seed=left,
            hyperparameters=hyperparameters,
        )  # fmt: skip
        answer = plan(name, quick(name, request))
        expect_sound(request, answer)
        driven += answer.length_m
        start = tuple(map(float, answer.path_m[-1]))
        observed = np.vstack((observed, answer.samples_m))
    assert len(observed) == 24
    assert 20.0 < driven <= budget


@pytest.mark.parametrize("name", ["rrt", "rrtstar", "informative"])
def test_a_setting_that_a_planner_does_not_know_is_refused(name):
    options = PlannerOptions(extra={"refine": 3.0})
    with pytest.raises(InvalidInput, match="got refine"):
        plan(name, request_over(np.ones((SIZE, SIZE), dtype=bool), options=options))


def test_an_unknown_planner_is_refused_with_the_names_of_those_there_are():
    with pytest.raises(InvalidInput, match=f"{', '.join(PLANNERS)}, or module:function; got 'rrt2'"):
        planner_named("rrt2")


def test_a_request_that_contradicts_itself_is_refused():
    mask = np.ones((SIZE, SIZE), dtype=bool)
    for changes, message in (
        ({"samples": 0}, "1 <= samples"),
        ({"samples": 13}, "1 <= samples"),
        ({"std_ppb": np.ones((2, 2), np.float32)}, r"std_ppb of shape \(28, 28\), got \(2, 2\)"),
        ({"seed": -1}, "seed of 0 or more, got -1"),
        ({"start_m": (np.nan, 1.0)}, "finite"),
    ):
        for name in NAMES:
            with pytest.raises(InvalidInput, match=message):
                plan(name, request_over(mask, **changes))


def test_places_along_a_path_are_equally_spaced_and_end_with_it():
    path = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [3.0, 4.0], [3.0, 4.0]])
    np.testing.assert_allclose(places_along(path, 5), [[1.4, 0], [2.8, 0], [3, 1.2], [3, 2.6], [3, 4]])
    assert path_length(path_prefix(path, 3.5)) == pytest.approx(3.5)
    assert path_prefix(path, 7.0) is path


def test_the_information_of_a_round_is_that_of_its_places_given_what_is_known():
    mask = np.ones((SIZE, SIZE), dtype=bool)
    kernel = SmoothPlusRough(0.6, 40.0, 0.4, 5.0)
    hyperparameters = Hyperparameters(kernel, scale_ppb=2.0)
    request = request_over(mask, observed_m=np.array([[20.0, 20.0]]), hyperparameters=hyperparameters)
    answer = plan("informative", request)
    places = np.vstack((request.observed_m, answer.samples_m))
    full = kernel.covariance(places, places) + (0.1 / 2.0) ** 2 * np.eye(4)
    joint = np.linalg.slogdet(full)[1] - np.log(full[0, 0]) - 3 * np.log((0.1 / 2.0) ** 2)
    assert answer.information_nats == pytest.approx(0.5 * joint, rel=1e-9)


def test_the_fewer_samples_a_mission_has_the_farther_apart_informative_takes_them():
    mask = np.ones((50, 50), dtype=bool)
    kernel = Hyperparameters(Matern52(1.0, 60.0), mean_ppb=7.0, scale_ppb=1.5)

    def metres(samples_left, seed):
        request = request_over(
            mask, (25.0, 25.0), grid=SiteGrid(50, 50, 10.0), hyperparameters=kernel, samples=5, seed=seed,
            samples_left=samples_left, options=PlannerOptions(),
        )  # fmt: skip
        return plan("informative", request).length_m

    few, some, many = (np.mean([metres(left, seed) for seed in range(4)]) for left in (10, 40, 150))
    assert few > 1.2 * some > 1.2 * 1.2 * many


def test_a_mission_of_few_samples_does_not_take_them_along_the_edge_of_the_site():
    """Nothing is known: the most uncertain places lie along the edge, where half of a sample is of no use."""
    mask = np.ones((50, 50), dtype=bool)
    kernel = Hyperparameters(Matern52(1.0, 60.0), mean_ppb=7.0, scale_ppb=1.5)
    request = request_over(
        mask, (250.0, 250.0), grid=SiteGrid(50, 50, 10.0), hyperparameters=kernel, samples=5, samples_left=20,
        options=PlannerOptions(),
    )  # fmt: skip
    for seed in range(4):
        answer = plan("informative", replace(request, seed=seed))
        from_edge_m = np.minimum(answer.samples_m, 500.0 - answer.samples_m).min(axis=1)
        assert from_edge_m.min() > 30.0


def test_a_round_through_chosen_places_goes_round_obstacles_and_stops_at_each_in_its_order() -> None:
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[4:28, 14] = False  # a wall with a gap in the south
    request = request_over(mask, samples=4)
    places = np.array([[9.5, 20.5], [20.5, 20.5], [20.5, 20.5], [5.2, 5.2]])
    answer = visiting(request, places)
    expect_sound(request, answer)
    np.testing.assert_array_equal(answer.samples_m, places)
    straight = path_length(np.vstack((request.start_m, places)))
    assert straight < answer.length_m < 2.2 * straight
    mask[:4, 14] = False
    with pytest.raises(NoRoute, match=r"no traversable path leads from \(9.5, 20.5\) to \(20.5, 20.5\) m"):
        visiting(request_over(mask, samples=4), places)


@pytest.mark.parametrize("name", ["rrt", "rrtstar"])
def test_a_tree_that_cannot_leave_a_winding_passage_gives_way_to_a_complete_search(name):
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[14:] = True
    for column in range(1, 8, 2):  # steps of two cells up to the open ground: shorter than an edge of the tree
        mask[column : column + 3, column] = mask[column + 2, column : column + 3] = True
    mask[9:14, 9] = True
    request = request_over(
        mask, (1.5, 1.5),
        options=PlannerOptions(clearance_m=3.0, step_m=12.0, goal_tolerance_m=2.0, max_iterations=20),
    )  # fmt: skip
    expect_sound(request, planner_named(name)(request))


def test_the_way_back_is_driven_before_the_planned_path():
    request = request_over(np.ones((SIZE, SIZE), dtype=bool), back_m=np.array([[9.2, 5.2], [5.2, 5.2]]))
    planned = PlannedRound(np.array([[5.2, 5.2], [20.2, 5.2]]), np.array([[20.2, 5.2]]), 1.0)
    assert after_way_back(planned, request).path_m.tolist() == [[9.2, 5.2], [5.2, 5.2], [20.2, 5.2]]
    assert after_way_back(planned, replace(request, back_m=None)) is planned

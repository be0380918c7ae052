"""Orders of visits: complete, deterministic, and short."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.errors import InvalidInput
from he3.tsp import short_tour


def tour_length(distances: np.ndarray, order: np.ndarray) -> float:
    return float(distances[order[:-1], order[1:]].sum())


def apart(points):
    return np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))


def shortest(distances):
    rest = range(1, len(distances))
    return min(tour_length(distances, np.array((0, *order))) for order in permutations(rest))


@given(n=st.integers(1, 25), seed=st.integers(0, 10_000))
@settings(max_examples=40)
def test_a_tour_begins_at_the_first_place_and_visits_each_once(n, seed):
    order = short_tour(apart(np.random.default_rng(seed).uniform(0, 100, (n, 2))), kicks=2, seed=seed)
    assert order[0] == 0
    assert sorted(order.tolist()) == list(range(n))


def test_seven_places_are_toured_as_short_as_trying_every_order_can():
    for seed in range(15):
        distances = apart(np.random.default_rng(seed).uniform(0, 100, (7, 2)))
        assert tour_length(distances, short_tour(distances, kicks=30)) <= 1.02 * shortest(distances)


def test_places_on_a_line_are_visited_from_end_to_end():
    x = np.random.default_rng(3).permutation(np.arange(1.0, 30.0))
    points = np.column_stack((np.concatenate(([0.0], x)), np.zeros(30)))
    assert points[short_tour(apart(points)), 0].tolist() == sorted(points[:, 0])


def test_a_tour_through_a_lattice_hardly_leaves_its_spacing():
    x, y = np.meshgrid(np.arange(12.0), np.arange(12.0))
    distances = apart(np.column_stack((x.ravel(), y.ravel())))
    assert tour_length(distances, short_tour(distances, kicks=30)) <= 1.05 * 143


def test_a_hundred_and_fifty_random_places_are_toured_near_the_asymptote():
    distances = apart(np.random.default_rng(0).uniform(0, 500, (150, 2)))
    asymptote = 0.7124 * np.sqrt(150 * 500.0**2)
    assert tour_length(distances, short_tour(distances, kicks=20)) <= 1.12 * asymptote  # the border costs some of it


def test_improving_an_order_never_lengthens_it():
    rng = np.random.default_rng(1)
    distances = apart(rng.uniform(0, 500, (60, 2)))
    guess = np.concatenate(([0], rng.permutation(np.arange(1, 60))))
    improved = short_tour(distances, guess)
    assert tour_length(distances, improved) < tour_length(distances, guess)
    assert tour_length(distances, short_tour(distances, improved, kicks=20)) <= tour_length(distances, improved)


def test_equal_places_make_a_tour_of_no_length():
    assert tour_length(np.zeros((9, 9)), short_tour(np.zeros((9, 9)), kicks=3)) == 0.0


def test_the_same_seed_gives_the_same_order():
    distances = apart(np.random.default_rng(5).uniform(0, 500, (80, 2)))
    assert short_tour(distances, kicks=15, seed=4).tolist() == short_tour(distances, kicks=15, seed=4).tolist()


@pytest.mark.parametrize(
    "distances", [np.zeros((2, 3)), np.zeros((0, 0)), np.array([[0.0, np.nan], [1.0, 0.0]]), -np.ones((2, 2))]
)
def test_what_is_no_table_of_distances_is_refused(distances):
    with pytest.raises(InvalidInput):
        short_tour(distances)

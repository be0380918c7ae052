"""Rounds as legs: a path is cut at its samples."""

from __future__ import annotations

import itertools
import math

from hypothesis import given
from hypothesis import strategies as st

from schemas.plans import PlannedSample, RoundPlan
from services.rover.activities import legs_of

coordinates = st.floats(1, 99)
places = st.tuples(coordinates, coordinates)


def planned(path, *samples: tuple[float, float]) -> RoundPlan:
    return RoundPlan(
        round=1,
        path_m=tuple(path),
        samples=tuple(
            PlannedSample(sample_id=f"s{k}", x_m=x, y_m=y, depth_m=0.1) for k, (x, y) in enumerate(samples, 1)
        ),
        information_nats=0.0,
    )


def stops(plan: RoundPlan):
    legs = legs_of(plan)
    assert not isinstance(legs, str), legs
    return [(leg.path_m[-1] if leg.path_m else None, leg.sample and leg.sample.sample_id) for leg in legs]


def test_a_path_is_cut_at_its_samples_and_continues_to_its_end():
    plan = planned([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)], (5.0, 0.0), (10.0, 4.0))
    assert stops(plan) == [((5.0, 0.0), "s1"), ((10.0, 4.0), "s2"), ((10.0, 10.0), None)]


def test_a_sample_at_the_end_of_the_path_is_the_last_stop():
    assert stops(planned([(0.0, 0.0), (10.0, 0.0)], (10.0, 0.0)))[0] == ((10.0, 0.0), "s1")


def test_a_sample_at_the_beginning_of_the_path_is_the_first_stop():
    assert stops(planned([(0.0, 0.0), (10.0, 0.0)], (0.0, 0.0)))[0] == ((0.0, 0.0), "s1")


def test_a_path_of_one_place_can_hold_samples():
    assert stops(planned([(3.0, 3.0)], (3.0, 3.0), (3.0, 3.0))) == [((3.0, 3.0), "s1"), ((3.0, 3.0), "s2")]


def test_on_a_path_that_comes_back_the_samples_are_taken_in_their_order():
    there_and_back = [(0.0, 0.0), (10.0, 0.0), (0.0, 0.0)]
    legs = legs_of(planned(there_and_back, (8.0, 0.0), (2.0, 0.0)))
    assert not isinstance(legs, str)
    assert legs[1].path_m == ((10.0, 0.0), (2.0, 0.0))


def test_a_sample_beside_the_path_is_named():
    assert "sample s1 within 0.5 m" in str(legs_of(planned([(0.0, 0.0), (10.0, 0.0)], (5.0, 0.6))))
    assert not isinstance(legs_of(planned([(0.0, 0.0), (10.0, 0.0)], (5.0, 0.4))), str)


def test_samples_against_the_order_of_the_path_are_named():
    assert "sample s2" in str(legs_of(planned([(0.0, 0.0), (10.0, 0.0)], (8.0, 0.0), (2.0, 0.0))))


@given(st.lists(places, min_size=2, max_size=8), st.lists(st.floats(0, 1), max_size=6))
def test_samples_on_a_path_do_not_change_its_length(path, fractions):
    lengths = [0.0, *itertools.accumulate(math.dist(a, b) for a, b in itertools.pairwise(path))]
    samples = []
    for fraction in sorted(fractions):
        s = fraction * lengths[-1]
        k = max(0, min(len(path) - 2, next(i for i, end in enumerate(lengths) if end >= s) - 1))
        step = lengths[k + 1] - lengths[k]
        part = (s - lengths[k]) / step if step else 0.0
        (ax, ay), (bx, by) = path[k], path[k + 1]
        samples.append((ax + part * (bx - ax), ay + part * (by - ay)))
    legs = legs_of(planned(path, *samples))
    assert not isinstance(legs, str), legs
    driven_path = [vertex for leg in legs for vertex in leg.path_m]
    # A path that passes a sample twice may be left for it a little earlier, by no more than the tolerance.
    driven = sum(math.dist(a, b) for a, b in itertools.pairwise(driven_path))
    assert abs(driven - lengths[-1]) <= 1.0 * len(samples) + 1e-6
    assert [leg.sample.sample_id for leg in legs if leg.sample] == [f"s{k + 1}" for k in range(len(samples))]

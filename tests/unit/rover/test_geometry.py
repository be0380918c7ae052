"""Plane geometry: places in polygons, and distances between segments and areas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.rover.geometry import Area, inside, squared_distance

coordinates = st.floats(1, 99)
places = st.tuples(coordinates, coordinates)

SQUARE = ((10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0))
HOOK = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (8.0, 10.0), (8.0, 2.0), (0.0, 2.0))


def test_a_place_is_inside_a_polygon_by_the_even_odd_rule():
    assert inside(SQUARE, (15.0, 15.0))
    assert not inside(SQUARE, (25.0, 15.0))
    assert inside(HOOK, (9.0, 8.0))
    assert not inside(HOOK, (4.0, 8.0))


@pytest.mark.parametrize(
    ("a", "b", "margin", "near"),
    [
        ((0.0, 15.0), (30.0, 15.0), 0.0, True),  # straight through, both ends outside
        ((14.0, 14.0), (15.0, 15.0), 0.0, True),  # entirely inside
        ((0.0, 9.0), (30.0, 9.0), 0.5, False),  # passes beside it
        ((0.0, 9.0), (30.0, 9.0), 1.5, True),  # too near
        ((0.0, 21.0), (9.0, 30.0), 3.0, False),  # within the box, clear of the corner
        ((21.0, 25.0), (25.0, 21.0), 4.2, False),  # the corner is sqrt(18) m away
        ((21.0, 25.0), (25.0, 21.0), 4.3, True),
    ],
)
def test_a_segment_enters_an_area_when_it_comes_nearer_than_the_margin(a, b, margin, near):
    assert Area.of(SQUARE).is_near(a, b, margin) is near


@given(places, places, st.floats(0.1, 5))
def test_nearness_to_an_area_agrees_with_sampling_the_segment(a, b, margin):
    area = Area.of(SQUARE)

    def gap(place: tuple[float, float]) -> float:
        dx = max(10 - place[0], 0.0, place[0] - 20)
        dy = max(10 - place[1], 0.0, place[1] - 20)
        return math.hypot(dx, dy)

    nearest = min(
        gap((a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1]))) for fraction in np.linspace(0, 1, 2001)
    )
    if nearest < margin:
        assert area.is_near(a, b, margin)
    elif nearest > margin + 0.1:
        assert not area.is_near(a, b, margin)


@given(places, places, places)
def test_distance_from_a_segment_agrees_with_sampling_it(p, a, b):
    sampled = min(math.dist(p, (a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]))) for s in np.linspace(0, 1, 501))
    exact = math.sqrt(squared_distance(p, a, b))
    assert exact <= sampled + 1e-9
    assert sampled <= exact + math.dist(a, b) / 500 + 1e-9

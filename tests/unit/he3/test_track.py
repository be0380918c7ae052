"""The rover's track, and the return path over it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from he3.track import return_path
from services.rover.geometry import squared_distance

coordinates = st.floats(1, 99)
places = st.tuples(coordinates, coordinates)


def on_track(place: tuple[float, float], track: list[tuple[float, float]]) -> bool:
    return any(squared_distance(place, a, b) < 1e-10 for a, b in itertools.pairwise(track))


def test_the_return_path_is_the_track_reversed():
    assert return_path([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]) == ((10.0, 0.0), (0.0, 0.0))


def test_the_return_path_leaves_out_a_loop():
    track = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (5.0, 10.0), (5.0, -5.0)]
    assert return_path(track) == ((5.0, 0.0), (0.0, 0.0))


def test_the_return_path_leaves_out_a_dead_end():
    assert return_path([(0.0, 0.0), (5.0, 0.0), (5.0, 9.0), (5.0, 0.0), (9.0, 0.0)]) == ((5.0, 0.0), (0.0, 0.0))


def test_half_way_back_the_return_path_continues():
    assert return_path([(0.0, 0.0), (10.0, 0.0), (4.0, 0.0)]) == ((0.0, 0.0),)


def test_at_the_start_the_return_path_is_empty():
    assert return_path([(3.0, 4.0)]) == ()
    assert return_path([(3.0, 4.0), (9.0, 4.0), (3.0, 4.0)]) == ()


@given(st.lists(places, min_size=2, max_size=25))
def test_the_return_path_lies_on_the_track_ends_at_its_beginning_and_is_no_longer(track):
    home = [track[-1], *return_path(track)]
    assert home[-1] == pytest.approx(track[0], abs=1e-6)
    for a, b in itertools.pairwise(home):
        for fraction in np.linspace(0, 1, 9):
            assert on_track((a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1])), track)
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(home))
    assert length <= sum(math.dist(a, b) for a, b in itertools.pairwise(track)) + 1e-6

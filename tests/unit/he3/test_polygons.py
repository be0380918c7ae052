"""An outline is simple, or the place where it meets itself is named."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.polygons import outline_objection

SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]


@pytest.mark.parametrize(
    "corners",
    [
        SQUARE,
        SQUARE[::-1],
        [*SQUARE, SQUARE[0]],  # closed by hand
        [SQUARE[0], *SQUARE],
        [(0, 0), (10, 0), (10, 10), (5, 2), (0, 10)],  # a notch
        [(0, 0), (5, 0), (10, 0), (10, 10)],  # a corner on a straight side
        [(1e5 + 0.1, 1e5), (1e5 + 0.2, 1e5), (1e5 + 0.15, 1e5 + 0.1)],
    ],
)
def test_an_outline_round_one_piece_of_ground_has_no_objection(corners):
    assert outline_objection(corners) is None


@pytest.mark.parametrize(
    ("corners", "where"),
    [
        ([(0, 0), (10, 10), (10, 0), (0, 10)], "(5.0, 5.0) m"),  # a bow tie
        ([(0, 0), (10, 0), (10, 10), (5, 0), (0, 10)], "(5.0, 0.0) m"),  # touches its side
        ([(0, 0), (10, 0), (5, 5), (10, 10), (0, 10), (5, 5)], "(5.0, 5.0) m"),  # touches itself in a corner
        ([(0, 0), (10, 0), (4, 0), (4, 5)], "(10.0, 0.0) m"),  # leads back along itself
        ([(400, 100), (100, 100), (400, 300), (100, 300)], "(250.0, 200.0) m"),
    ],
)
def test_an_outline_that_meets_itself_is_refused_with_the_place(corners, where):
    objection = outline_objection(corners)
    assert objection is not None
    assert objection.endswith(f"near {where}")


@settings(max_examples=200, deadline=None)
@given(
    angles=st.lists(st.integers(0, 359), min_size=3, max_size=12, unique=True),
    radii=st.lists(st.floats(1.0, 100.0), min_size=12, max_size=12),
    centre=st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)),
    from_corner=st.integers(0, 11),
)
def test_a_star_shaped_outline_is_simple_from_whatever_corner_and_crossed_when_two_corners_change_places(
    angles, radii, centre, from_corner
):
    turns = np.radians(sorted(angles))
    gaps = np.diff(np.append(turns, turns[0] + 2 * np.pi))
    if gaps.max() >= np.pi - 0.02 or gaps.min() < 0.02:
        return  # the centre is not inside
    radius = np.array(radii[: len(turns)])
    corners = np.column_stack((np.cos(turns), np.sin(turns))) * radius[:, None] + centre
    corners = np.roll(corners, from_corner, axis=0)
    assert outline_objection(corners.tolist()) is None
    assert outline_objection(corners[::-1].tolist()) is None
    if len(corners) >= 4 and _is_convex(corners):
        corners[[0, 1]] = corners[[1, 0]]
        assert outline_objection(corners.tolist()) is not None


def _is_convex(corners: np.ndarray) -> bool:
    edges = np.roll(corners, -1, axis=0) - corners
    turns = [a[0] * b[1] - a[1] * b[0] for a, b in pairwise([*edges, edges[0]])]
    return min(turns) > 1e-3

"""The drill: the bites of a borehole."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.rover.drill import bites_m


@given(st.floats(0.001, 3), st.floats(0.01, 1))
def test_the_bites_add_up_to_the_depth_and_none_is_deeper_than_a_full_bite(depth, bite):
    bites = bites_m(depth, bite)
    assert sum(bites) == pytest.approx(depth)
    assert all(0 < taken <= bite + 1e-8 for taken in bites)
    assert len(bites) in (math.ceil(depth / bite), math.ceil(depth / bite) - 1)


def test_a_depth_of_whole_bites_takes_no_extra_bite():
    assert len(bites_m(0.3, 0.1)) == 3
    assert len(bites_m(1.0, 0.1)) == 10

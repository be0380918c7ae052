from __future__ import annotations

import math

import pytest

from he3.constants import MOON_DISTANCE_MEAN_M
from he3.errors import InvalidInput
from he3.lighttime import PRESET_LIGHT_TIMES_S, light_time_s, preset_light_time_s

MOON_DISTANCE_MIN_M = 356_410e3  # nearest perigee, centre to centre
MOON_DISTANCE_MAX_M = 406_697e3  # farthest apogee, centre to centre


@pytest.mark.parametrize(
    ("distance_m", "seconds"),
    [(MOON_DISTANCE_MIN_M, 1.189), (MOON_DISTANCE_MEAN_M, 1.282), (MOON_DISTANCE_MAX_M, 1.357)],
)
def test_light_time_at_perigee_mean_and_apogee_is_as_published(distance_m: float, seconds: float) -> None:
    assert light_time_s(distance_m) == pytest.approx(seconds, abs=0.0005)


def test_light_crosses_an_astronomical_unit_in_499_seconds() -> None:
    assert light_time_s(149_597_870_700.0) == pytest.approx(499.004784, abs=1e-6)


@pytest.mark.parametrize("distance_m", [-1.0, math.inf, math.nan])
def test_an_impossible_distance_is_refused(distance_m: float) -> None:
    with pytest.raises(InvalidInput, match="finite distance"):
        light_time_s(distance_m)


def test_the_nominal_preset_lies_within_the_moons_own_range() -> None:
    assert light_time_s(MOON_DISTANCE_MIN_M) < preset_light_time_s("nominal") < light_time_s(MOON_DISTANCE_MAX_M)


def test_the_agencies_presets_are_halves_of_the_round_trips_that_they_studied() -> None:
    assert [2 * preset_light_time_s(name) for name in ("agency-6s", "agency-8s", "csa-10s")] == [6.0, 8.0, 10.0]


def test_the_mars_preset_is_a_distance_that_mars_can_have() -> None:
    nearest_m, farthest_m = 54.6e9, 401e9
    assert light_time_s(nearest_m) < preset_light_time_s("mars") < light_time_s(farthest_m)


def test_an_unknown_preset_is_answered_with_the_known_ones() -> None:
    with pytest.raises(InvalidInput) as caught:
        preset_light_time_s("venus")
    assert all(name in str(caught.value) for name in (*PRESET_LIGHT_TIMES_S, "venus"))
    assert "\n" not in str(caught.value)

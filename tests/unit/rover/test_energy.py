"""The battery: charge over time, and when it reaches a level."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.mission.mission_time import SECOND, seconds
from services.mission.scenario import RoverConfig
from services.rover.energy import Battery, full_battery


def battery(**changes: float) -> Battery:
    return full_battery(RoverConfig.model_validate({"capacity_wh": 1000.0, "initial_charge": 0.5} | changes), 0)


def test_the_charge_grows_by_the_solar_power_beyond_the_loads():
    # 450 - 150 - 100 W for an hour are 200 Wh.
    assert battery().drawing(100.0, 0).charge_at(seconds(3600)) == pytest.approx(700.0)


def test_the_charge_falls_in_the_dark_and_stops_at_zero():
    dark = battery(solar_w=0.0)
    assert dark.charge_at(seconds(3600)) == pytest.approx(350.0)
    assert dark.charge_at(seconds(36000)) == 0.0


def test_the_charge_stops_at_the_capacity():
    assert battery().charge_at(seconds(1e6)) == 1000.0


def test_a_change_of_load_does_not_change_the_charge_at_that_time():
    then = seconds(1800)
    assert battery().drawing(500.0, then).charge_at(then) == battery().charge_at(then)


@given(st.floats(0, 1), st.floats(1, 1000), st.floats(0, 1000))
def test_the_charge_reaches_a_level_at_the_predicted_time(fraction, level, load):
    cell = battery(initial_charge=fraction).drawing(load, 0)
    ready = cell.reaches(level, 0)
    if ready is None:
        assert load >= 300
        assert cell.charge_at(0) < level
    else:
        assert cell.charge_at(ready) >= level - 1e-9
        assert ready == 0 or cell.charge_at(ready - SECOND) < level


def test_a_step_takes_no_energy_if_solar_power_suffices():
    assert battery().need_wh(200.0, 3600) == 0.0
    assert battery().need_wh(400.0, 3600) == pytest.approx(100.0)

"""Keep-outs that are set and removed during a round."""

from __future__ import annotations

import pytest

from schemas.telemetry import RoverMode
from services.mission.mission_time import seconds
from tests.unit.rover.simulated_moon import PIT, STAGED, Moon, east, plan_of, round_plan


def test_a_keep_out_set_on_the_path_stops_the_rover_before_it():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 50.5)))
    area = moon.command("set_keep_out", 50, area_id="pit", polygon_m=PIT)
    moon.run()
    assert moon.stages(area) == STAGED
    assert {report.at for report in moon.reports} == {seconds(50)}
    assert "keep-out pit" in moon.event("blocked").detail
    assert moon.state.mode is RoverMode.SAFE
    assert moon.place == pytest.approx((15.5, 5.5))
    assert moon.event("blocked").obstacle_m == pytest.approx((20.0 - 0.8, 5.5), abs=0.02)


def test_a_keep_out_set_over_the_rover_stops_it_and_lets_a_newer_plan_lead_it_out():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 50.5)))
    wide = ((20.0, 0.0), (45.0, 0.0), (45.0, 20.0), (20.0, 20.0))
    moon.command("set_keep_out", 230, area_id="pit", polygon_m=wide)
    moon.run(5000)
    assert moon.state.mode is RoverMode.SAFE
    assert moon.place == pytest.approx((35.5, 5.5))
    here = moon.place
    moon.plan(plan_of(2, round_plan(2, [here, (here[0], 40.5)], (here[0], 40.5))), 5000)
    moon.run()
    assert [sample.sample_id for sample in moon.samples] == ["r2s1"]


def test_a_keep_out_that_is_removed_is_open_again():
    moon = Moon()
    moon.command("set_keep_out", 1, area_id="pit", polygon_m=PIT)
    closed = moon.command("go_to", 2, target_m=(25.5, 5.5))
    across = moon.command("go_to", 3, target_m=(50.5, 5.5))
    moon.command("set_keep_out", 4, area_id="pit")
    moon.command("go_to", 5, target_m=(50.5, 5.5))
    moon.run()
    assert "within a keep-out" in moon.why(closed)
    assert "enters keep-out pit" in moon.why(across)
    assert moon.place == (50.5, 5.5)


def test_removing_a_keep_out_that_is_not_there_is_rejected():
    moon = Moon()
    area = moon.command("set_keep_out", 1, area_id="pit")
    assert "no keep-out pit" in moon.run().why(area)

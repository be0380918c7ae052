"""Terrain that contradicts the plan: the rover stops before it and enters safe mode."""

from __future__ import annotations

import math

import pytest

from schemas.plans import PlannedSample, RoundPlan
from schemas.telemetry import RoverMode
from tests.unit.rover.simulated_moon import START, Moon, east, plan_of, round_plan, wall


def test_the_rover_stops_before_closed_terrain_and_enters_safe_mode():
    moon = Moon(wall)
    moon.plan(plan_of(1, round_plan(1, [START, (40.5, 5.5)], (10.5, 5.5), (30.5, 5.5)), east(2, 40.5, 45.5)))
    moon.run()
    assert moon.kinds() == [
        "plan_accepted",
        "round_started",
        "blocked",
        "round_aborted",
        "safe_mode_entered",
    ]
    blocked = moon.event("blocked")
    assert blocked.obstacle_m is not None
    assert wall(*blocked.obstacle_m)
    assert math.dist(blocked.obstacle_m, (20.0, 5.5)) < 0.8  # the nearest of them, at the side
    assert (blocked.x_m, blocked.y_m) == pytest.approx((10.5, 5.5))
    assert blocked.samples_done == ("r1s1",)
    assert (blocked.round, blocked.plan_revision) == (1, 1)
    assert moon.event("round_aborted").samples_done == ("r1s1",)
    assert moon.state.mode is RoverMode.SAFE
    assert moon.state.rounds_on_board == 0


def test_a_newer_plan_ends_safe_mode_before_an_obstacle():
    moon = Moon(wall)
    moon.plan(plan_of(1, east(1, 5.5, 40.5)))
    moon.run(5000)
    here = moon.place
    around = round_plan(2, [here, (here[0], 45.5), (30.5, 45.5)], (30.5, 45.5))
    moon.plan(plan_of(2, around), 5000)
    moon.run()
    assert moon.kinds("safe_mode_left", "round_completed") == ["safe_mode_left", "round_completed"]
    assert [sample.sample_id for sample in moon.samples] == ["r2s1"]


def test_an_aborted_round_can_be_planned_again_for_its_missing_samples():
    moon = Moon(wall)
    moon.plan(plan_of(1, round_plan(1, [START, (40.5, 5.5)], (10.5, 5.5), (30.5, 5.5))))
    moon.run(5000)
    here = moon.place
    rest = RoundPlan(
        round=1,
        path_m=(here, (here[0], 45.5)),
        samples=(PlannedSample(sample_id="r1s2", x_m=here[0], y_m=45.5, depth_m=0.1),),
        information_nats=0.0,
    )
    moon.plan(plan_of(2, rest, last=True), 5000)
    moon.run()
    assert [sample.sample_id for sample in moon.samples] == ["r1s1", "r1s2"]
    assert len(moon.finished) == 1


def test_a_rover_that_stands_on_bad_terrain_can_leave_it():
    moon = Moon(lambda x, y: x < 7)
    moon.plan(plan_of(1, east(1, 5.5, 15.5)))
    moon.run()
    assert moon.kinds("blocked", "round_completed") == ["round_completed"]

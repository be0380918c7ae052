"""Energy: no step uses up the reserve; the rover charges, or enters safe mode."""

from __future__ import annotations

import pytest

from schemas.telemetry import EventKind, RoverMode
from tests.unit.rover.simulated_moon import STAGED, START, WEAK_BATTERY, Moon, east, plan_of, round_plan


# Full sun bears drilling; at half of it a bite takes (150 + 200 - 225) W.
def test_a_rover_low_on_energy_charges_in_safe_mode_and_continues_where_it_stopped():
    moon = Moon(**WEAK_BATTERY)
    moon.plan(plan_of(1, round_plan(1, [START, (10.5, 5.5)], (10.5, 5.5), depth=1.0)))
    moon.run()
    around_one_stop = ["low_energy", "safe_mode_entered", "charged", "safe_mode_left"]
    low = moon.kinds("low_energy", "safe_mode_entered", "charged", "safe_mode_left")
    assert low == around_one_stop * (len(low) // 4)
    assert len(low) >= 8
    assert moon.kinds("round_completed", "round_aborted") == ["round_completed"]
    assert len(moon.samples) == 1
    assert moon.state.drilled_m == pytest.approx(1.0)
    assert min(state.energy_wh for state in moon.states) >= 50.0 - 1e-6
    assert "charging" in moon.modes()
    entered = next(event for event in moon.events if event.kind is EventKind.SAFE_MODE_ENTERED)
    left = next(event for event in moon.events if event.kind is EventKind.SAFE_MODE_LEFT)
    assert entered.at < left.at


def test_the_energy_of_a_drive_is_checked_before_the_drive():
    # In the dark a section of 10 m takes 100 s at 150 W and 2400 J: 4.83 Wh.
    moon = Moon(solar_w=0.0, capacity_wh=100.0, reserve=0.9, resume_charge=0.95)
    moon.plan(plan_of(1, east(1, 5.5, 45.5)))
    moon.run()
    assert moon.state.driven_m == pytest.approx(20.0)
    assert moon.state.mode is RoverMode.SAFE
    assert "4.8 Wh" in moon.event("low_energy").detail
    assert moon.kinds("charged") == []


def test_a_step_beyond_the_battery_s_capacity_leaves_the_rover_in_safe_mode_until_a_newer_plan():
    moon = Moon(solar_w=160.0, capacity_wh=10.0, drill_w=1000.0, reserve=0.2, resume_charge=0.9)
    moon.plan(plan_of(1, east(1, 5.5, 10.5)))
    moon.run()
    assert moon.state.mode is RoverMode.SAFE
    assert moon.kinds("safe_mode_entered") == ["safe_mode_entered"]


def test_a_rover_paused_while_charging_stays_paused_when_it_is_charged():
    moon = Moon(**WEAK_BATTERY)
    moon.plan(plan_of(1, round_plan(1, [START, (10.5, 5.5)], (10.5, 5.5), depth=1.0)))
    moon.run(2000)
    assert moon.state.mode is RoverMode.CHARGING
    rejected = moon.command("resume", 2000)
    moving = moon.command("go_to", 2001, target_m=(20.5, 20.5))
    paused = moon.command("pause", 2010)
    moon.run(50_000)
    assert moon.stages(rejected) == ["received", "rejected"]
    assert "goes on by itself" in moon.why(rejected)
    assert "charges" in moon.why(moving)
    assert moon.stages(paused) == STAGED
    assert moon.state.mode is RoverMode.PAUSED
    moon.command("resume", 50_000)
    moon.run(200_000)
    assert len(moon.samples) == 1


def test_a_charged_rover_whose_next_step_needs_more_than_it_charged_for_charges_again():
    # It charges for a bite of 1 cm. Meanwhile that round is aborted, and another begins there with a bite of 20 cm.
    moon = Moon(**WEAK_BATTERY | {"bite_m": 0.5, "resume_charge": 0.55, "initial_charge": 0.505})
    moon.plan(plan_of(1, round_plan(1, [START], START, depth=0.01)))
    moon.command("abort_round", 1.0)
    moon.plan(plan_of(2, round_plan(1, [START], START, depth=0.2)), 2.0)
    moon.run()
    assert moon.kinds("low_energy", "charged")[:4] == ["low_energy", "charged", "low_energy", "charged"]
    assert [sample.depth_m for sample in moon.samples] == [0.2]

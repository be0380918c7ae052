"""Telecommands: what each does, and when it is rejected."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from schemas.telemetry import RoverMode
from schemas.topics import MEASURE
from services.mission.mission_time import seconds
from services.runtime.node import NoReply
from tests.unit.rover.simulated_moon import (
    ANALYSIS_S,
    BITE_S,
    DAY_S,
    STAGED,
    START,
    Moon,
    east,
    moon_with_plan,
    plan_of,
    round_plan,
    wall,
)


def test_pause_takes_effect_at_the_end_of_the_section_and_resume_continues():
    moon = moon_with_plan()
    pause = moon.command("pause", 30)
    moon.run(5000)
    assert moon.stages(pause) == STAGED
    assert [report.at for report in moon.reports] == [seconds(30), seconds(30), seconds(100), seconds(100)]
    assert moon.state.mode is RoverMode.PAUSED
    assert moon.place == pytest.approx((15.5, 5.5))
    resume = moon.command("resume", 5000)
    moon.run()
    assert moon.stages(resume) == STAGED
    assert moon.kinds("paused", "resumed", "round_completed") == ["paused", "resumed", *["round_completed"] * 2]
    assert moon.samples[0].measured_at == seconds(2300 + 4900)


def test_pause_takes_effect_at_the_end_of_the_bite():
    moon = moon_with_plan()
    moon.command("pause", 300)
    moon.run(5000)
    assert moon.event("paused").at == seconds(560)
    assert moon.state.drilled_m == pytest.approx(0.1)
    moon.command("resume", 5000)
    moon.run()
    assert moon.samples[0].measured_at == seconds(5000 + 4 * BITE_S + ANALYSIS_S)
    assert moon.samples[0].depth_m == 0.5


def test_pause_takes_effect_at_the_end_of_the_analysis_and_the_measurement_follows_afterwards():
    moon = moon_with_plan()
    moon.command("pause", 2100)
    moon.run(5000)
    assert moon.event("paused").at == seconds(2300)
    assert not moon.samples
    moon.command("resume", 5000)
    moon.run(5000)
    assert moon.samples[0].measured_at == seconds(5000)


def test_a_rover_that_waits_for_a_silent_instrument_pauses_at_once():
    moon = moon_with_plan()
    moon.refuses[MEASURE] = (NoReply.TIMEOUT, "")
    moon.command("pause", 2417)
    moon.run(3000)
    assert moon.event("paused").at == seconds(2417)
    asked = len(moon.asked)
    moon.run(10_000)
    assert len(moon.asked) == asked
    moon.refuses.clear()
    moon.command("resume", 10_000)
    moon.run()
    assert [sample.sample_id for sample in moon.samples] == ["r1s1", "r2s1"]


def test_a_paused_rover_accepts_plans_and_begins_none():
    moon = Moon()
    moon.command("pause", 1)
    moon.plan(plan_of(1, east(1, 5.5, 10.5)), 10)
    moon.run(5000)
    assert moon.kinds() == ["paused", "plan_accepted"]
    assert moon.state.rounds_on_board == 1
    moon.command("resume", 5000)
    moon.run()
    assert len(moon.samples) == 1


def test_a_second_pause_changes_nothing():
    moon = moon_with_plan()
    moon.command("pause", 30)
    second = moon.command("pause", 500)
    moon.run(1000)
    assert moon.stages(second) == STAGED
    assert moon.kinds("paused") == ["paused"]


def test_resume_is_rejected_if_the_rover_is_not_held():
    moon = moon_with_plan()
    resume = moon.command("resume", 30)
    moon.run()
    assert moon.stages(resume) == ["received", "rejected"]
    assert "neither" in moon.why(resume)


def test_abort_round_drops_the_current_round_and_those_behind_it_at_the_next_safe_point():
    moon = moon_with_plan()
    abort = moon.command("abort_round", 300)
    moon.run()
    assert moon.stages(abort) == STAGED
    assert moon.kinds() == ["plan_accepted", "round_started", "round_aborted", "parked"]
    assert moon.event("round_aborted").at == seconds(560)
    assert moon.state.rounds_on_board == 0
    assert not moon.samples
    moon.plan(plan_of(2, east(2, 25.5, 30.5)), DAY_S)
    moon.run(2 * DAY_S)
    assert [sample.sample_id for sample in moon.samples] == ["r2s1"]


def test_abort_round_is_rejected_if_no_round_is_under_way():
    moon = Moon()
    abort = moon.command("abort_round", 1)
    assert "no round" in moon.run().why(abort)


def test_a_paused_round_can_be_aborted_and_the_rover_stays_paused():
    moon = moon_with_plan()
    moon.command("pause", 30)
    abort = moon.command("abort_round", 500)
    moon.run(1000)
    assert moon.stages(abort) == STAGED
    assert moon.state.mode is RoverMode.PAUSED
    moon.command("resume", 1000)
    assert moon.run().state.mode is RoverMode.PARKED


def test_go_to_drives_straight_there_and_completes_on_arrival():
    moon = Moon()
    go = moon.command("go_to", 10, target_m=(5.5, 35.5))
    moon.run()
    assert moon.stages(go) == STAGED
    assert moon.reports[-1].at == seconds(310)
    assert moon.place == (5.5, 35.5)
    assert moon.kinds() == ["parked"]


def test_go_to_aborts_the_current_round():
    moon = moon_with_plan()
    go = moon.command("go_to", 30, target_m=(15.5, 15.5))
    moon.run()
    assert moon.stages(go) == STAGED
    assert moon.kinds() == ["plan_accepted", "round_started", "round_aborted", "parked"]
    assert go in moon.event("round_aborted").detail


def test_go_to_leaves_safe_mode():
    moon = Moon(wall)
    moon.plan(plan_of(1, east(1, 5.5, 40.5)))
    go = moon.command("go_to", 5000, target_m=START)
    moon.run()
    assert moon.stages(go) == STAGED
    assert moon.kinds("safe_mode_entered", "safe_mode_left") == ["safe_mode_entered", "safe_mode_left"]
    assert moon.place == START


def test_go_to_stops_before_closed_terrain_and_fails():
    moon = Moon(wall)
    go = moon.command("go_to", 10, target_m=(40.5, 5.5))
    moon.run()
    assert moon.stages(go) == ["received", "accepted", "started", "failed"]
    assert "closed terrain" in moon.why(go)
    assert moon.event("blocked").round == 0
    assert moon.state.mode is RoverMode.SAFE
    assert moon.place[0] < 20 - 0.8


def test_go_to_beyond_the_site_is_rejected():
    moon = Moon()
    go = moon.command("go_to", 10, target_m=(61.0, 5.5))
    moon.run()
    assert moon.stages(go) == ["received", "rejected"]
    assert "0..60 m east" in moon.why(go)


def test_go_to_replaces_an_earlier_go_to():
    moon = Moon()
    first = moon.command("go_to", 10, target_m=(5.5, 55.5))
    second = moon.command("go_to", 20, target_m=(55.5, 15.5))
    moon.run()
    assert moon.stages(first) == ["received", "accepted", "started", "failed"]
    assert second in moon.why(first)
    assert moon.stages(second) == STAGED
    assert moon.place == (55.5, 15.5)


def test_a_paused_go_to_is_resumed():
    moon = Moon()
    go = moon.command("go_to", 10, target_m=(5.5, 55.5))
    moon.command("pause", 20)
    moon.command("resume", 5000)
    moon.run()
    assert moon.stages(go) == STAGED
    assert moon.reports[-1].at == seconds(5000 + 400)


def test_rounds_on_board_that_a_go_to_makes_useless_are_reported():
    moon = Moon()
    moon.command("pause", 1)
    moon.plan(plan_of(1, east(1, 5.5, 10.5)), 10)
    moon.command("go_to", 20, target_m=(30.5, 30.5))
    moon.run()
    assert "will not be where" in moon.event("plan_rejected").detail
    assert moon.state.rounds_on_board == 0


def test_a_plan_that_begins_at_the_target_of_a_go_to_is_executed_after_it():
    moon = Moon()
    moon.command("go_to", 10, target_m=(5.5, 25.5))
    moon.plan(plan_of(1, east(1, 5.5, 10.5, y=25.5)), 20)
    moon.run()
    assert len(moon.samples) == 1


def test_return_to_start_follows_the_rover_s_own_track_back():
    moon = Moon(state_period_s=5.0)
    track = [START, (25.5, 5.5), (25.5, 25.5), (15.5, 25.5)]
    moon.plan(plan_of(1, round_plan(1, track)))
    home = moon.command("return_to_start", 1000)
    moon.run(5000)
    assert moon.stages(home) == STAGED
    assert moon.place == START
    assert moon.state.driven_m == pytest.approx(100.0)
    for state in moon.states:
        assert any(
            min(math.dist((state.x_m, state.y_m), (a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])))
                for s in np.linspace(0, 1, 401)) < 0.1
            for a, b in itertools.pairwise(track)
        )  # fmt: skip


def test_at_the_start_return_to_start_completes_at_once():
    moon = Moon()
    home = moon.command("return_to_start", 10)
    moon.run()
    assert moon.stages(home) == STAGED
    assert {report.at for report in moon.reports} == {seconds(10)}


def test_a_newer_plan_does_not_end_commanded_safe_mode_and_resume_does():
    moon = moon_with_plan()
    safe = moon.command("safe", 30)
    moon.plan(plan_of(2, east(2, 25.5, 40.5)), 1000)
    moon.run(5000)
    assert moon.stages(safe) == STAGED
    assert moon.state.mode is RoverMode.SAFE
    assert moon.kinds("plan_accepted", "plan_rejected") == ["plan_accepted"] * 2
    pause = moon.command("pause", 5000)
    resume = moon.command("resume", 5100)
    moon.run()
    assert "safe mode already" in moon.why(pause)
    assert moon.stages(resume) == STAGED
    assert [(s.sample_id, s.x_m) for s in moon.samples] == [("r1s1", 25.5), ("r2s1", 40.5)]


def test_resume_before_an_obstacle_parks_the_rover_there():
    moon = Moon(wall)
    moon.plan(plan_of(1, east(1, 5.5, 40.5)))
    moon.command("resume", 5000)
    moon.run()
    assert moon.kinds()[-2:] == ["safe_mode_left", "parked"]

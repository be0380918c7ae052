"""Rounds: driven, drilled, analysed, measured and reported."""

from __future__ import annotations

import time

import pytest

from he3.measurement import sample_noise
from schemas.telemetry import RoverMode
from schemas.topics import MEASURE, TERRAIN
from services.mission.mission_time import SECOND, seconds
from services.rover.node import RoverNode
from services.runtime.node import Effect, Event, QueueDepthChanged, Started
from tests.unit.rover.simulated_moon import ANALYSIS_S, DAY_S, GRID, SAMPLE_S, START, Moon, east, plan_of, round_plan
from tests.waiting import expect_within


def test_a_round_is_driven_drilled_analysed_and_reported():
    moon = Moon()
    moon.plan(plan_of(1, round_plan(1, [(5.5, 5.5), (15.5, 5.5), (15.5, 15.5)], (10.5, 5.5), (15.5, 10.5))))
    moon.run()
    assert moon.kinds() == ["plan_accepted", "round_started", "round_completed", "parked"]
    first, second = moon.samples
    assert (first.sample_id, first.x_m, first.y_m, first.driven_m) == ("r1s1", 10.5, 5.5, 5.0)
    assert first.measured_at == seconds(50 + SAMPLE_S)
    assert first.helium3_ppb == pytest.approx(5.0 + 1.05 + sample_noise(1, "r1s1", 0.1))
    assert (second.sample_id, second.x_m, second.y_m, second.driven_m) == ("r1s2", 15.5, 10.5, 15.0)
    assert second.measured_at == seconds(150 + 2 * SAMPLE_S)
    assert (second.round, second.plan_revision, second.depth_m, second.noise_std_ppb) == (1, 1, 0.1, 0.1)
    done = moon.event("round_completed")
    assert done.samples_done == ("r1s1", "r1s2")
    assert (done.x_m, done.y_m, done.driven_m) == (15.5, 15.5, 20.0)
    assert done.at == seconds(200 + 2 * SAMPLE_S)
    assert moon.modes() == ["idle", "driving", "drilling", "analysing"] * 1 + ["driving", "drilling", "analysing"] + [
        "driving",
        "parked",
    ]
    state = moon.state
    assert (state.round, state.samples_done, state.rounds_on_board, state.plan_revision) == (1, 2, 0, 1)
    assert state.drilled_m == pytest.approx(0.2)
    assert state.heading_deg == pytest.approx(0.0)
    assert not moon.finished


def test_a_rover_that_does_not_report_its_steps_reports_when_it_begins_and_ends_to_work():
    moon = Moon()
    moon.rover = RoverNode(moon.config, GRID, START, 0, reports_steps=False)
    moon.plan(plan_of(1, round_plan(1, [(5.5, 5.5), (15.5, 5.5), (15.5, 15.5)], (10.5, 5.5), (15.5, 10.5))))
    moon.run()
    assert moon.modes() == ["idle", "driving", "parked"]
    assert moon.kinds() == ["plan_accepted", "round_started", "round_completed", "parked"]
    assert moon.rover.state(moon.now) == moon.state


def test_the_rover_scans_each_section_once_before_it_drives_it():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 40.5)))
    moon.run()
    assert len([ask for ask in moon.asked if ask.topic is TERRAIN]) == 4
    assert len([ask for ask in moon.asked if ask.topic is MEASURE]) == 1


def test_a_deep_hole_is_drilled_bite_by_bite():
    moon = Moon()
    moon.plan(plan_of(1, round_plan(1, [START, (6.5, 5.5)], (6.5, 5.5), depth=0.35)))
    moon.run()
    assert moon.samples[0].measured_at == pytest.approx(seconds(10 + 0.35 * 3600 + ANALYSIS_S), abs=10)
    assert moon.state.drilled_m == pytest.approx(0.35)


def test_several_samples_at_one_place_are_taken_one_after_the_other():
    moon = Moon()
    moon.plan(plan_of(1, round_plan(1, [START], START, START)))
    moon.run()
    assert [sample.sample_id for sample in moon.samples] == ["r1s1", "r1s2"]
    assert moon.state.driven_m == 0.0


def test_rounds_on_board_are_executed_one_after_the_other_and_the_last_completes_the_mission():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), east(2, 10.5, 15.5), east(3, 15.5, 20.5), last=True))
    moon.run()
    assert moon.kinds() == ["plan_accepted", *["round_started", "round_completed"] * 3, "mission_completed"]
    assert [finish.ok for finish in moon.finished] == [True]
    assert moon.state.mode is RoverMode.PARKED
    assert [sample.round for sample in moon.samples] == [1, 2, 3]


def test_the_state_is_reported_each_period_and_at_each_change_of_mode():
    moon = Moon(state_period_s=60.0)
    moon.plan(plan_of(1, east(1, 5.5, 15.5)))
    moon.run(600)
    assert len(moon.states) == 1 + 10 + 3  # at the start, each minute, and at each change: driving, drilling, analysing
    at_one_minute = moon.states[2]
    assert (at_one_minute.mode, at_one_minute.x_m) == (RoverMode.DRIVING, pytest.approx(11.5))
    assert at_one_minute.driven_m == pytest.approx(6.0)
    assert at_one_minute.heading_deg == pytest.approx(90.0)


def test_the_state_reports_the_last_known_depth_of_the_queue():
    moon = Moon(state_period_s=60.0)
    moon.put(1.0, QueueDepthChanged(7))
    assert moon.run(60).state.queue_depth == 7


def test_a_restarted_rover_continues_as_if_there_had_been_no_restart():
    plan = plan_of(1, round_plan(1, [START, (25.5, 5.5)], (10.5, 5.5), (20.5, 5.5), depth=0.3), last=True)
    undisturbed = Moon()
    undisturbed.plan(plan)
    undisturbed.run()
    instants = sorted({at for at, _ in undisturbed.history if at > 0})
    assert len(instants) > 10
    for instant in instants:
        moon = Moon()
        moon.plan(plan)
        moon.run(instant / SECOND - 1e-9)
        reborn = RoverNode(moon.config, GRID, START, 0)
        for at, event in moon.history:
            reborn.handle(event, at)
        assert len(reborn.handle(Started(2), moon.now)) == 1
        moon.rover = reborn
        moon.run()
        assert moon.samples == undisturbed.samples
        assert moon.events == undisturbed.events


def test_a_mission_of_15_km_and_150_samples_takes_the_rover_less_than_a_second_of_computing():
    corners = [START, (55.5, 5.5), (55.5, 55.5), (5.5, 55.5)]
    moon = Moon(state_period_s=60.0)
    rounds = [
        round_plan(k, [*corners, *corners, *corners[:2], START][:11], *corners[:3], *corners[:2]) for k in range(1, 31)
    ]
    moon.plan(plan_of(1, *rounds, last=True))
    spent = 0.0
    handle = moon.rover.handle

    def timed(event: Event, now: int) -> list[Effect]:
        nonlocal spent
        begin = time.process_time()
        effects = handle(event, now)
        spent += time.process_time() - begin
        return effects

    moon.rover.handle = timed  # type: ignore[method-assign]
    moon.run(10 * DAY_S)
    assert moon.finished
    assert moon.states[-1].samples_done == 150
    assert moon.states[-1].driven_m >= 15_000
    expect_within(1.0, spent, "the rover of a mission of 15 km", time.process_time)

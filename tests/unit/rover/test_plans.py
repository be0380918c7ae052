"""Plans: accepted behind the rounds that have begun, or rejected with the reason."""

from __future__ import annotations

import pytest

from schemas.plans import MissionPlan, PlannedSample, RoundPlan
from schemas.telemetry import RoverMode
from tests.unit.rover.simulated_moon import SAMPLE_S, START, Moon, east, plan_of, round_plan


def rejection(plan: MissionPlan, *before: MissionPlan, closed_areas: bool = False) -> str:
    moon = Moon()
    for k, earlier in enumerate(before):
        moon.plan(earlier, 2000.0 * k)
    if closed_areas:
        moon.command("set_keep_out", 5000.0, area_id="pit", polygon_m=((20.0, 0.0), (30.0, 0.0), (30.0, 60.0)))
    moon.plan(plan, 50_000.0)
    moon.run(60_000.0)
    event = moon.event("plan_rejected")
    assert event.plan_revision == plan.revision
    assert event.round == plan.rounds[0].round
    assert "\n" not in event.detail
    assert moon.state.mode in (RoverMode.IDLE, RoverMode.PARKED)
    assert moon.state.plan_revision == max((p.revision for p in before), default=0)
    return event.detail


def test_a_plan_of_an_older_revision_is_rejected():
    assert "newer than 3, got 2" in rejection(plan_of(2, east(2, 10.5, 15.5)), plan_of(3, east(1, 5.5, 10.5)))


def test_another_plan_under_the_same_revision_is_rejected():
    assert "newer than 3, got 3" in rejection(plan_of(3, east(2, 10.5, 15.5)), plan_of(3, east(1, 5.5, 10.5)))


def test_the_same_plan_received_again_changes_and_reports_nothing():
    moon = Moon()
    for at in (0.0, 10.0, 5000.0):
        moon.plan(plan_of(1, east(1, 5.5, 10.5)), at)
    moon.run()
    assert moon.kinds() == ["plan_accepted", "round_started", "round_completed", "parked"]
    assert len(moon.samples) == 1


def test_a_plan_that_leaves_out_a_round_is_rejected():
    assert "round 1 next, got 2" in rejection(plan_of(1, east(2, 5.5, 10.5)))


def test_a_plan_whose_rounds_have_all_begun_is_rejected():
    assert "all have begun" in rejection(plan_of(2, east(1, 10.5, 15.5)), plan_of(1, east(1, 5.5, 10.5)))


def test_a_plan_that_begins_elsewhere_is_rejected_with_the_distance():
    why = rejection(plan_of(1, east(1, 8.5, 15.5)))
    assert "(5.50, 5.50)" in why
    assert "3.0 m away" in why


def test_a_plan_may_begin_a_little_beside_the_rover():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 6.5, 10.5)))
    moon.run()
    assert moon.samples[0].driven_m == pytest.approx(5.0)


def test_a_plan_whose_rounds_do_not_join_is_rejected():
    assert "round 2 to begin within" in rejection(plan_of(1, east(1, 5.5, 10.5), east(2, 20.5, 25.5)))


def test_a_plan_that_leaves_the_site_is_rejected():
    assert "0..60 m east" in rejection(plan_of(1, east(1, 5.5, 60.5)))


def test_a_plan_with_a_sample_beside_its_path_is_rejected():
    assert "sample r1s1" in rejection(plan_of(1, round_plan(1, [START, (15.5, 5.5)], (10.5, 8.5))))


def test_a_plan_that_repeats_a_measured_sample_is_rejected():
    again = RoundPlan(
        round=2,
        path_m=((10.5, 5.5), (15.5, 5.5)),
        samples=(PlannedSample(sample_id="r1s1", x_m=12.5, y_m=5.5, depth_m=0.1),),
        information_nats=0.0,
    )
    assert "r1s1, which is measured already" in rejection(plan_of(2, again), plan_of(1, east(1, 5.5, 10.5)))


def test_a_plan_through_a_keep_out_is_rejected():
    assert "enters keep-out pit" in rejection(plan_of(1, east(1, 5.5, 40.5)), closed_areas=True)


def test_a_plan_with_a_path_longer_than_the_limit_is_rejected():
    path = [START, *[(50.5, 5.5), START] * 600]
    assert "at most 50000 m" in rejection(plan_of(1, round_plan(1, path)))


def test_a_newer_plan_replaces_the_rounds_that_have_not_begun_and_keeps_the_current_one():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 15.5), east(2, 15.5, 20.5), east(3, 20.5, 25.5)))
    north = round_plan(2, [(15.5, 5.5), (15.5, 15.5)], (15.5, 15.5))
    moon.plan(plan_of(2, north), 50.0)
    moon.run()
    assert [(s.sample_id, s.plan_revision, s.x_m, s.y_m) for s in moon.samples] == [
        ("r1s1", 1, 15.5, 5.5),
        ("r2s1", 2, 15.5, 15.5),
    ]
    assert moon.kinds("round_started", "round_completed", "round_aborted") == ["round_started", "round_completed"] * 2


def test_rounds_of_a_newer_plan_that_have_begun_meanwhile_are_skipped():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), east(2, 10.5, 15.5)))
    # It comes while round 2 is under way, made when that had not begun; round 3 fits where round 2 ends.
    moon.plan(plan_of(2, east(2, 10.5, 15.5), east(3, 15.5, 20.5)), 50 + SAMPLE_S + 10)
    moon.run()
    assert [(s.sample_id, s.plan_revision) for s in moon.samples] == [("r1s1", 1), ("r2s1", 1), ("r3s1", 2)]


def test_a_newer_plan_that_does_not_fit_the_current_round_is_rejected_and_the_older_one_kept():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), east(2, 10.5, 15.5), east(3, 15.5, 20.5)))
    other = [round_plan(2, [(10.5, 5.5), (10.5, 30.5)], (10.5, 30.5)), east(3, 10.5, 20.5, y=30.5)]
    moon.plan(plan_of(2, *other), 50 + SAMPLE_S + 10)
    moon.run()
    assert "round 3 to begin within" in moon.event("plan_rejected").detail
    assert [(s.sample_id, s.plan_revision) for s in moon.samples] == [("r1s1", 1), ("r2s1", 1), ("r3s1", 1)]


def test_a_completed_mission_continues_with_a_newer_plan():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), last=True))
    moon.plan(plan_of(2, east(2, 10.5, 15.5), last=True), 10_000)
    moon.run()
    assert moon.kinds("mission_completed", "parked") == ["mission_completed"] * 2
    assert len(moon.samples) == 2


def test_a_mission_is_reported_completed_once():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), last=True))
    moon.command("go_to", 5000, target_m=START)
    moon.run()
    assert moon.kinds("mission_completed", "parked") == ["mission_completed", "parked"]
    assert len(moon.finished) == 1

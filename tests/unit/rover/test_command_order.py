"""Telecommands are executed at most once, in order, and in time."""

from __future__ import annotations

from schemas.commands import CommandStage
from schemas.telemetry import RoverMode
from services.mission.mission_time import seconds
from tests.unit.rover.simulated_moon import PIT, STAGED, Moon, moon_with_plan


def test_a_command_received_after_its_expiry_expires():
    moon = moon_with_plan()
    pause = moon.command("pause", 30, expires_s=29.0)
    moon.run()
    assert moon.stages(pause) == ["received", "expired"]
    assert moon.kinds("paused") == []


def test_a_command_for_which_no_safe_point_comes_in_time_expires():
    moon = moon_with_plan()
    pause = moon.command("pause", 30, expires_s=60.0)
    moon.run()
    assert moon.stages(pause) == ["received", "accepted", "expired"]
    assert moon.kinds("paused") == []


def test_a_command_is_still_executed_at_the_instant_of_its_expiry():
    moon = Moon()
    pause = moon.command("pause", 30, expires_s=30.0)
    assert moon.run().stages(pause) == STAGED


def test_a_command_received_twice_is_executed_once_and_reported_on_again():
    moon = moon_with_plan()
    moon.command("pause", 30, "c1")
    moon.command("resume", 500, "c2")
    moon.command("pause", 600, "c1", made_s=30)
    moon.run()
    assert moon.kinds("paused") == ["paused"]
    assert moon.stages("c1") == [*STAGED, "completed"]
    first, again = (
        [report for report in moon.reports if report.stage is CommandStage.COMPLETED][:2][0],
        moon.reports[-1],
    )
    assert first == again


def test_another_command_under_a_known_id_is_ignored():
    moon = moon_with_plan()
    moon.command("pause", 30, "c1")
    moon.command("abort_round", 500, "c1")
    moon.run()
    assert moon.stages("c1") == STAGED
    assert moon.kinds("round_aborted") == []


def test_a_pause_that_comes_after_the_resume_that_was_to_end_it_is_rejected():
    moon = moon_with_plan()
    resume = moon.command("resume", 30, made_s=20)
    pause = moon.command("pause", 40, made_s=10)
    moon.run()
    assert moon.stages(resume) == ["received", "rejected"]
    assert moon.stages(pause) == ["received", "rejected"]
    assert f"resume {resume} was made later" in moon.why(pause)
    assert len(moon.samples) == 2


def test_safe_is_never_outdated():
    moon = moon_with_plan()
    moon.command("pause", 30, made_s=20)
    safe = moon.command("safe", 40, made_s=10)
    moon.run()
    assert moon.stages(safe) == STAGED


def test_an_older_command_on_a_keep_out_does_not_undo_a_newer_one():
    moon = Moon()
    moon.command("set_keep_out", 30, area_id="pit", polygon_m=PIT, made_s=20)
    older = moon.command("set_keep_out", 40, area_id="pit", polygon_m=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)), made_s=10)
    other = moon.command("set_keep_out", 50, area_id="hole", polygon_m=PIT, made_s=15)
    moon.run()
    assert moon.stages(older) == ["received", "rejected"]
    assert moon.stages(other) == STAGED


def test_waiting_commands_are_executed_in_order():
    moon = moon_with_plan()
    pause, resume = moon.command("pause", 30), moon.command("resume", 40)
    moon.run()
    assert moon.stages(pause) == moon.stages(resume) == STAGED
    assert moon.kinds("paused", "resumed") == ["paused", "resumed"]
    assert moon.samples[0].measured_at == seconds(2300)


def test_a_waiting_command_that_is_no_longer_possible_fails():
    moon = moon_with_plan()
    moon.command("pause", 30)
    first, second = moon.command("resume", 31), moon.command("resume", 32)
    moon.run()
    assert moon.stages(first) == STAGED
    assert moon.stages(second) == ["received", "accepted", "failed"]


def test_the_queue_of_commands_is_bounded():
    moon = moon_with_plan()
    ids = [moon.command("pause", 30 + k / 10) for k in range(40)]
    moon.run(1000)
    assert [moon.stages(name)[-1] for name in ids] == ["completed"] * 32 + ["rejected"] * 8
    assert "at most 32" in moon.why(ids[-1])


def test_safe_resume_and_pause_that_wait_for_one_safe_point_leave_the_rover_paused():
    moon = moon_with_plan()
    ids = [moon.command("safe", 30), moon.command("resume", 31), moon.command("pause", 32)]
    moon.run(5000)
    assert [moon.stages(command_id) for command_id in ids] == [STAGED] * 3
    assert moon.kinds("safe_mode_entered", "safe_mode_left", "paused") == [
        "safe_mode_entered",
        "safe_mode_left",
        "paused",
    ]
    assert moon.state.mode is RoverMode.PAUSED

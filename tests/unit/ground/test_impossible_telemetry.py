"""Telemetry that cannot be true changes nothing."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.plans import PlannedSample, RoundPlan
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import (
    EVENT,
    SAMPLE,
    STATE,
)
from services.runtime.node import (
    Finish,
)
from tests.unit.ground.stand_in_mission import Mission, Rover, sample_report, scenario, smooth_field, state


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"sample_id": "r77s1"}, "expected one that was planned"),
        ({"x_m": 61.0}, "expected a place within"),
        ({"helium3_ppb": 1e9}, "expected -1000 to 1.001e+06 ppb"),
    ],
)
def test_an_impossible_sample_is_left_out_and_changes_nothing(changes: dict[str, object], complaint: str) -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(100.0)
    before, revision = mission.snapshot, mission.status.map_revision
    mission.tell_ground(SAMPLE, sample_report(**changes))
    assert complaint in mission.warnings()[-1]
    assert mission.snapshot.mean_ppb is before.mean_ppb
    assert (mission.status.samples, mission.status.map_revision) == (0, revision)


@pytest.mark.parametrize("pipeline", [0, 1])
def test_an_impossible_reading_is_not_waited_for_and_another_is_taken_in_its_place(pipeline: int) -> None:
    field = smooth_field()
    mission = Mission(scenario(ground={"pipeline": pipeline}))
    mission.rover.twice = True
    spoilt: list[str] = []

    def measured(planned: RoundPlan, sample: PlannedSample, now: int) -> None:
        mission.rover._field = field if spoilt else np.full_like(field, -5000.0)
        spoilt.append(sample.sample_id)
        Rover._measured(mission.rover, planned, sample, now)

    mission.rover._measured = measured  # type: ignore[method-assign]
    end = mission.run()
    assert end == Finish(True, "12 of 12 samples are in the map")
    assert spoilt[0] == "r01s1"
    taken = [sample.sample_id for sample in mission.snapshot.samples]
    assert sorted(taken) == sorted(spoilt[1:])
    assert len(taken) == 12
    assert sum("r01s1 is left out" in text for text in mission.warnings()) == 1


def test_an_event_of_a_round_never_planned_or_from_outside_the_region_changes_nothing() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(100.0)
    at = mission.simulation.now
    plans = len(mission.rover.plans)
    for event in (
        RoverEvent(kind=EventKind.ROUND_ABORTED, at=at, x_m=5.0, y_m=5.0, round=9, plan_revision=1),
        RoverEvent(kind=EventKind.BLOCKED, at=at, x_m=500.0, y_m=5.0, round=1, plan_revision=1),
    ):
        mission.tell_ground(EVENT, event)
        assert mission.warnings()[-1].startswith(f"event {event.kind.value}: expected")
    mission.simulation.run_for(100.0)
    assert len(mission.rover.plans) == plans
    assert mission.run().ok


def test_an_older_state_does_not_replace_a_newer_one() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(100.0)
    now = mission.simulation.now
    mission.tell_ground(STATE, state(1, (20.0, 20.0), 1, "driving"), made_at=now)
    mission.tell_ground(STATE, state(1, (10.0, 10.0), 1, "driving"), made_at=now - 5)
    assert mission.status.rover is not None
    assert (mission.status.rover.x_m, mission.status.rover_made_at) == (20.0, now)


def test_silence_of_the_rover_is_reported_once_and_ends_when_it_is_heard() -> None:
    mission = Mission(scenario(ground={"rover_timeout_s": 600.0}))
    mission.simulation.run_for(3000.0)
    assert sum("nothing heard" in text for text in mission.warnings()) == 1
    assert mission.status.detail.startswith("the rover is silent")
    mission.simulation.run_for(700.0)
    assert "silent" not in mission.status.detail


@pytest.mark.parametrize("ago_s", [0.0, 5.0])
def test_a_state_that_comes_again_and_again_does_not_hide_that_the_rover_is_silent(ago_s: float) -> None:
    mission = Mission(scenario(ground={"rover_timeout_s": 600.0}))
    mission.simulation.run_for(100.0)
    newest = mission.simulation.now
    mission.tell_ground(STATE, state(1, (20.0, 20.0), 1, "driving"), made_at=newest)
    for _ in range(8):
        mission.simulation.run_for(100.0)
        mission.tell_ground(STATE, state(1, (20.0, 20.0), 1, "driving"), made_at=newest - round(ago_s * 1e9))
    assert sum("nothing heard" in text for text in mission.warnings()) == 1
    assert mission.status.detail.startswith("the rover is silent")


def test_a_silent_instrument_is_said_until_the_rover_has_a_measurement_or_drives() -> None:
    mission = Mission(scenario(ground={"rover_timeout_s": 1e6}))
    mission.simulation.run_for(100.0)
    now = mission.simulation.now
    silent = RoverEvent(
        kind=EventKind.INSTRUMENT_SILENT, at=now, x_m=5.0, y_m=5.0, driven_m=7.0, detail="moon/field/terrain: timeout"
    )
    for driven_m, made_at, said in ((7.0, now + 5, True), (7.5, now - 5, True), (7.5, now + 9, False)):
        mission.tell_ground(EVENT, silent, made_at=now)
        here = state(1, (6.0, 5.0), 1, "driving").model_copy(update={"driven_m": driven_m})
        mission.tell_ground(STATE, here, made_at=made_at)
        assert mission.status.detail.startswith("instrument silent: moon/field/terrain") is said

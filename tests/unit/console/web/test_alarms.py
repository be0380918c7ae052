"""Alarms: raised by conditions and events, kept until gone and seen."""

from __future__ import annotations

from schemas.ground import GroundStatus, MissionPhase
from schemas.link import DirectionConditions, DirectionCounts, LinkConditions, LinkStatus
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState
from services.console.web.alarms import AlarmKind, Alarms
from services.mission.mission_time import SECOND

START = 1_893_456_000 * SECOND


def rover(mode: RoverMode = RoverMode.DRIVING, energy_wh: float = 4000.0) -> RoverState:
    return RoverState(
        mode=mode, x_m=1.0, y_m=2.0, heading_deg=0.0, energy_wh=energy_wh, capacity_wh=5000.0, driven_m=0.0,
        drilled_m=0.0, round=1, plan_revision=1, rounds_on_board=0, samples_done=0, queue_depth=0,
    )  # fmt: skip


def status(state: RoverState, phase: MissionPhase = MissionPhase.EXECUTING) -> GroundStatus:
    return GroundStatus(
        phase=phase, planner="rrtstar", round=0, rounds=3, samples=0, samples_total=9, driven_m=0.0, budget_m=None,
        plan_revision=1, plans_in_work=0, map_revision=1, mean_std_ppb=1.0, kernel=None, score=None, rover=state,
        rover_made_at=START,
    )  # fmt: skip


def link(contact: bool = True, light_s: float = 1.282) -> LinkStatus:
    each = DirectionConditions(one_way_light_time_s=light_s)
    return LinkStatus(
        conditions=LinkConditions(up=each, down=each), contact=contact, contact_changes_at=None,
        up=DirectionCounts(), down=DirectionCounts(), in_flight=(), incarnation=1,
    )  # fmt: skip


def event(kind: EventKind, at: int = START) -> RoverEvent:
    return RoverEvent(kind=kind, at=at, x_m=10.0, y_m=20.0)


def kinds(alarms: Alarms) -> list[AlarmKind]:
    return [alarm.kind for alarm in alarms.current]


def test_what_we_see_of_the_rover_is_stale_after_three_missed_reports_beyond_the_light_time() -> None:
    alarms = Alarms()
    assert not alarms.look(status(rover()), link(light_s=1200.0), START + 1380 * SECOND)
    assert alarms.look(status(rover()), link(light_s=1200.0), START + 1382 * SECOND)
    assert kinds(alarms) == [AlarmKind.STALE]


def test_a_rover_that_reports_seldom_is_not_stale_sooner_than_three_of_its_own_periods() -> None:
    alarms = Alarms()
    assert not alarms.look(status(rover()), link(), START + 1800 * SECOND, state_period_s=600.0)
    assert alarms.look(status(rover()), link(), START + 1803 * SECOND, state_period_s=600.0)


def test_a_mission_that_is_over_may_be_silent() -> None:
    alarms = Alarms()
    alarms.look(status(rover(), MissionPhase.COMPLETED), link(contact=False), START + 10_000 * SECOND)
    assert kinds(alarms) == []


def test_an_alarm_stays_until_its_cause_is_gone_and_somebody_has_seen_it() -> None:
    alarms = Alarms()
    alarms.look(status(rover(energy_wh=1000.0)), link(), START)
    (alarm,) = alarms.current
    assert (alarm.kind, alarm.active, alarm.acknowledged) == (AlarmKind.LOW_ENERGY, True, False)
    assert alarms.acknowledge(alarm.alarm_id)
    assert kinds(alarms) == [AlarmKind.LOW_ENERGY]
    assert alarms.look(status(rover()), link(), START)
    assert kinds(alarms) == []
    assert not alarms.acknowledge(alarm.alarm_id)


def test_an_alarm_that_nobody_saw_stays_when_its_cause_is_gone_and_counts_its_returns() -> None:
    alarms = Alarms()
    for contact in (False, True, False, True):
        alarms.look(None, link(contact), START)
    (alarm,) = alarms.current
    assert (alarm.kind, alarm.active, alarm.times) == (AlarmKind.NO_CONTACT, False, 2)
    assert alarms.acknowledge(alarm.alarm_id)
    assert kinds(alarms) == []


def test_events_raise_and_end_alarms() -> None:
    alarms = Alarms()
    assert alarms.happened(event(EventKind.BLOCKED))
    assert alarms.happened(event(EventKind.SAFE_MODE_ENTERED))
    assert "(10, 20) m" in alarms.current[0].text
    assert kinds(alarms) == [AlarmKind.BLOCKED, AlarmKind.SAFE_MODE]
    assert not alarms.happened(event(EventKind.SAFE_MODE_ENTERED))
    assert alarms.happened(event(EventKind.ROUND_STARTED))
    assert alarms.happened(event(EventKind.SAFE_MODE_LEFT))
    assert [alarm.active for alarm in alarms.current] == [False, False]


def test_one_safe_mode_counts_once_whatever_the_order_in_which_its_event_and_the_states_arrive() -> None:
    alarms = Alarms()
    assert alarms.happened(event(EventKind.SAFE_MODE_ENTERED, START + 10 * SECOND))
    alarms.look(status(rover(RoverMode.DRIVING)), link(), START + 11 * SECOND)  # made at START, before the event
    alarms.look(status(rover(RoverMode.SAFE)), link(), START + 12 * SECOND)
    (alarm,) = alarms.current
    assert (alarm.active, alarm.times) == (True, 1)
    assert not alarms.happened(event(EventKind.SAFE_MODE_LEFT, START + 5 * SECOND))
    assert alarms.happened(event(EventKind.SAFE_MODE_LEFT, START + 20 * SECOND))
    assert not alarms.current[0].active


def test_safe_mode_is_seen_in_the_state_even_when_its_event_is_still_on_the_way() -> None:
    alarms = Alarms()
    alarms.look(status(rover(RoverMode.SAFE)), link(), START)
    assert kinds(alarms) == [AlarmKind.SAFE_MODE]


def test_a_process_that_failed_upon_a_message_raises_an_alarm_that_stays():
    alarms = Alarms()
    line = "messages set aside upon which a process failed (see its log): ground 1"
    assert alarms.look(None, None, START, defects=line)
    assert not alarms.look(None, None, START + SECOND, defects=line)
    (alarm,) = alarms.current
    assert (alarm.kind.value, alarm.text, alarm.active) == ("defect", line, True)

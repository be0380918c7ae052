"""Alarms: raised by conditions and events, kept until gone and seen."""

from __future__ import annotations

from schemas.ground import GroundStatus, MissionPhase
from schemas.link import DirectionConditions, DirectionCounts, LinkConditions, LinkEvent, LinkStatus
from schemas.mission_log import AlarmAction, AlarmKind, AlarmMark, HeardEvent, LogEntry, LogKind, MissionLog
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState
from services.console.cli.alarms import _shelved_lines, alarm_lines
from services.console.client.alarms import Alarms, Severity
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


def link(contact: bool = True, light_s: float = 1.282, forced: bool | None = None, since: int = START) -> LinkStatus:
    each = DirectionConditions(one_way_light_time_s=light_s)
    return LinkStatus(
        conditions=LinkConditions(up=each, down=each), contact=contact, contact_changes_at=None,
        up=DirectionCounts(), down=DirectionCounts(), in_flight=(), incarnation=1, contact_forced=forced,
        events=(LinkEvent(at=since - SECOND, contact=True), LinkEvent(at=since, contact=contact)),
    )  # fmt: skip


def marked(action: AlarmAction, kind: AlarmKind, number: int = 1, at: int = START + SECOND) -> LogEntry:
    until = at + 600 * SECOND if action is AlarmAction.SHELVE else None
    mark = AlarmMark(kind=kind, action=action, by="anna", until=until)
    return LogEntry(number=number, at=at, kind=LogKind.ALARM, text="said", by="anna", mark=mark)


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
    assert alarms.logged(marked(AlarmAction.ACKNOWLEDGE, AlarmKind.LOW_ENERGY))
    (alarm,) = alarms.current
    assert (alarm.acknowledged_by, alarm.acknowledged_at, alarm.wants_attention) == ("anna", START + SECOND, False)
    assert alarms.look(status(rover()), link(), START)
    assert kinds(alarms) == []
    assert [(each.kind, each.acknowledged_by) for each in alarms.history] == [(AlarmKind.LOW_ENERGY, "anna")]
    assert not alarms.logged(marked(AlarmAction.ACKNOWLEDGE, AlarmKind.LOW_ENERGY, number=2))


def test_an_alarm_that_nobody_saw_stays_when_its_cause_is_gone_and_counts_its_returns() -> None:
    alarms = Alarms()
    for contact in (False, True, False, True):
        alarms.look(None, link(contact), START)
    (alarm,) = alarms.current
    assert (alarm.kind, alarm.active, alarm.times) == (AlarmKind.NO_CONTACT, False, 2)
    assert alarms.logged(marked(AlarmAction.ACKNOWLEDGE, AlarmKind.NO_CONTACT))
    assert kinds(alarms) == []
    assert len(alarms.history) == 2


def test_events_raise_and_end_alarms() -> None:
    alarms = Alarms()
    assert alarms.happened(event(EventKind.BLOCKED))
    assert alarms.happened(event(EventKind.SAFE_MODE_ENTERED))
    assert all("(10, 20) m" in alarm.text for alarm in alarms.current)
    assert kinds(alarms) == [AlarmKind.SAFE_MODE, AlarmKind.BLOCKED]
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


def test_the_text_of_an_alarm_says_the_same_for_as_long_as_its_cause_is_the_same() -> None:
    alarms = Alarms()
    low = status(rover(energy_wh=1000.0))
    alarms.look(low, link(), START + 600 * SECOND)
    said = {alarm.kind: alarm.text for alarm in alarms.current}
    assert said[AlarmKind.STALE] == "no report of the rover since 2030-01-01T00:00:00Z"
    assert said[AlarmKind.LOW_ENERGY] == "the rover's battery is below 25%"
    assert not alarms.look(low, link(), START + 9000 * SECOND)
    alarms.look(status(rover(energy_wh=500.0)), link(), START + 9000 * SECOND)
    joined_late = Alarms()
    joined_late.look(low, link(), START + 9000 * SECOND)
    assert {alarm.kind: alarm.text for alarm in alarms.current} == said
    assert {alarm.kind: alarm.text for alarm in joined_late.current} == said


def test_a_failure_of_a_second_process_is_named_and_the_alarm_ends_with_the_process_that_failed() -> None:
    alarms = Alarms()
    alarms.look(None, None, START, defects="ground 1")
    assert alarms.look(None, None, START + SECOND, defects="ground 1, rover 2")
    assert [alarm.text for alarm in alarms.current] == ["ground 1, rover 2"]
    assert alarms.look(None, None, START + 2 * SECOND)
    assert [(alarm.active, alarm.ended_at) for alarm in alarms.current] == [(False, START + 2 * SECOND)]


def test_contact_that_the_schedule_ended_becomes_a_warning_when_a_person_holds_it_off() -> None:
    alarms = Alarms()
    alarms.look(None, link(contact=False), START)
    assert [alarm.severity for alarm in alarms.current] == [Severity.ADVISORY]
    assert alarms.look(None, link(contact=False, forced=False), START + SECOND)
    assert [(alarm.severity, alarm.times) for alarm in alarms.current] == [(Severity.WARNING, 1)]


def test_what_wants_attention_comes_first_then_what_is_active_then_the_more_severe() -> None:
    alarms = Alarms()
    alarms.happened(event(EventKind.BLOCKED))
    alarms.look(status(rover(RoverMode.SAFE, energy_wh=1000.0)), link(contact=False), START)
    assert kinds(alarms) == [AlarmKind.SAFE_MODE, AlarmKind.BLOCKED, AlarmKind.LOW_ENERGY, AlarmKind.NO_CONTACT]
    alarms.logged(marked(AlarmAction.ACKNOWLEDGE, AlarmKind.SAFE_MODE))
    assert kinds(alarms)[-1] is AlarmKind.SAFE_MODE
    assert [alarm.severity for alarm in alarms.current][-2:] == [Severity.ADVISORY, Severity.CRITICAL]


def test_contact_that_no_schedule_ends_is_a_warning_and_counts_from_when_it_ended() -> None:
    alarms = Alarms()
    alarms.look(None, link(contact=False, forced=False, since=START + 5 * SECOND), START + 60 * SECOND)
    (alarm,) = alarms.current
    assert (alarm.severity, alarm.raised_at) == (Severity.WARNING, START + 5 * SECOND)


def test_a_display_that_joins_late_shows_losses_of_contact_that_nobody_has_acknowledged() -> None:
    def at(second: int, contact: bool, by: str = "") -> LinkEvent:
        return LinkEvent(at=START + second * SECOND, contact=contact, by=by)

    events = (at(0, True), at(10, False), at(20, True), at(30, True, by="cora"), at(40, False, by="cora"), at(50, True))
    later = link().model_copy(update={"events": events})
    alarms = Alarms()
    alarms.look(None, later, START + 60 * SECOND)
    (alarm,) = alarms.current
    assert (alarm.active, alarm.times, alarm.severity) == (False, 2, Severity.WARNING)
    assert (alarm.raised_at, alarm.ended_at) == (START + 40 * SECOND, START + 50 * SECOND)
    assert [each.severity for each in alarms.history] == [Severity.ADVISORY]

    acknowledged = Alarms()
    acknowledged.logged(marked(AlarmAction.ACKNOWLEDGE, AlarmKind.NO_CONTACT, at=START + 25 * SECOND))
    acknowledged.look(None, later, START + 60 * SECOND)
    assert [each.raised_at for each in acknowledged.current] == [START + 40 * SECOND]
    assert [each.acknowledged_by for each in acknowledged.history] == ["anna"]

    both = Alarms()
    both.logged(marked(AlarmAction.ACKNOWLEDGE, AlarmKind.NO_CONTACT, at=START + 55 * SECOND))
    both.look(None, later, START + 60 * SECOND)
    assert both.current == ()


def test_a_shelved_alarm_wants_no_attention_until_its_time_is_over() -> None:
    alarms = Alarms()
    alarms.look(None, link(contact=False), START)
    alarms.logged(marked(AlarmAction.SHELVE, AlarmKind.NO_CONTACT))
    (alarm,) = alarms.current
    assert (alarm.shelved, alarm.shelved_by, alarm.wants_attention) == (True, "anna", False)
    alarms.look(None, link(contact=True), START + 2 * SECOND)
    alarms.look(None, link(contact=False, since=START + 3 * SECOND), START + 3 * SECOND)
    assert alarms.current[0].shelved  # it came again: shelved is the kind
    assert not alarms.look(None, link(contact=False), START + 600 * SECOND)
    assert alarms.look(None, link(contact=False), START + 601 * SECOND)
    assert alarms.current[0].wants_attention
    alarms.logged(marked(AlarmAction.SHELVE, AlarmKind.NO_CONTACT, number=2))
    assert alarms.logged(marked(AlarmAction.UNSHELVE, AlarmKind.NO_CONTACT, number=3))
    assert alarms.current[0].wants_attention


def test_a_kind_that_is_shelved_is_listed_without_an_alarm_until_its_time_is_over() -> None:
    alarms = Alarms()
    alarms.logged(marked(AlarmAction.SHELVE, AlarmKind.NO_CONTACT))
    assert _shelved_lines(alarms) == ["shelved   no-contact      until 2030-01-01T00:10:01Z by anna; no alarm now"]
    alarms.look(None, link(contact=False), START)
    assert _shelved_lines(alarms) == []  # the alarm itself says so
    assert alarm_lines(alarms.current)[0].startswith("advisory  no-contact      active")
    alarms.look(None, link(contact=True), START + 601 * SECOND)
    assert alarms.shelved == {}


def test_a_display_that_joins_late_shows_the_alarms_and_marks_of_before() -> None:
    early, late = Alarms(), Alarms()
    entered = event(EventKind.SAFE_MODE_ENTERED)
    seen = marked(AlarmAction.ACKNOWLEDGE, AlarmKind.SAFE_MODE)
    early.happened(entered)
    early.logged(seen)
    log = MissionLog(entries=(seen,), events=(HeardEvent(event=entered, received_at=START + SECOND),))
    late.past(log)
    for alarms in (early, late):
        alarms.look(status(rover(RoverMode.SAFE)), link(contact=False), START + 9 * SECOND)
        alarms.past(log)  # once more changes nothing
    assert early.current == late.current
    assert early.current[-1].acknowledged_by == "anna"


def test_an_alarm_that_is_raised_after_it_was_acknowledged_wants_attention_again() -> None:
    alarms = Alarms()
    alarms.look(None, link(contact=False), START)
    alarms.logged(marked(AlarmAction.ACKNOWLEDGE, AlarmKind.NO_CONTACT))
    alarms.look(None, link(contact=True), START + 2 * SECOND)
    alarms.look(None, link(contact=False, since=START + 3 * SECOND), START + 3 * SECOND)
    (alarm,) = alarms.current
    assert (alarm.wants_attention, alarm.times, len(alarms.history)) == (True, 1, 1)

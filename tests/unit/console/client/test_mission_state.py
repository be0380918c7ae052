"""The newest facts of a mission: messages out of turn, repeated messages, and a mission that is started anew."""

from __future__ import annotations

import time
from typing import Any

import pytest

from schemas.commands import CommandKind, CommandList, CommandReport, CommandStage, CommandStatus, Telecommand
from schemas.ground import GroundStatus, MissionPhase, Presence
from schemas.link import ClockMode, ClockState
from schemas.mission_log import HeardEvent, LogEntry, LogKind, MissionLog, ModeChange
from schemas.telemetry import EventKind, RoverEvent, RoverMode
from schemas.topics import (
    COMMAND_STATUS,
    EARTH_CLOCK,
    EARTH_PRESENCE,
    EVENT,
    GROUND_STATUS,
    LIST_COMMANDS,
    LOG_ENTRY,
    SHOW_LOG,
    Topic,
)
from schemas.wire import Header
from services.console.client.mission_state import MAX_COMMANDS, MissionState, supersedes

SECOND = 1_000_000_000
START = 1_893_456_000 * SECOND


def header(made_at: int, incarnation: int = 1, sequence: int = 0, source: str = "ground") -> Header:
    return Header(mission="m", source=source, incarnation=incarnation, sequence=sequence, made_at=made_at)


def ground(samples: int) -> GroundStatus:
    return GroundStatus(
        phase=MissionPhase.EXECUTING, planner="rrt", round=0, rounds=3, samples=samples, samples_total=9, driven_m=0.0,
        budget_m=None, plan_revision=0, plans_in_work=0, map_revision=samples, mean_std_ppb=None, kernel=None,
        score=None, rover=None, rover_made_at=None,
    )  # fmt: skip


def lockstep(at: int) -> ClockState:
    return ClockState(mode=ClockMode.LOCKSTEP, rate=0.0, anchor_wall_ns=1, anchor_mission_ns=at, start_ns=START)


def timekeeper(pid: int) -> Presence:
    return Presence(name="link", side="earth", incarnation=1, software="1", pid=pid, host="h", refused=0, events=0)


def event(detail: str = "") -> RoverEvent:
    return RoverEvent(kind=EventKind.BLOCKED, at=START, x_m=1.0, y_m=2.0, round=1, samples_done=(), detail=detail)


def status(*stages: CommandStage, name: str = "c1", at: int = START) -> CommandStatus:
    return CommandStatus(
        command=Telecommand(command_id=name, kind=CommandKind.PAUSE),
        stages=tuple(CommandReport(command_id=name, stage=stage, at=at) for stage in stages),
    )


@pytest.mark.parametrize(
    ("new", "last", "newer"),
    [
        (header(5), header(4), True),
        (header(4), header(5), False),
        (header(5, sequence=2), header(5, sequence=1), True),
        (header(5, sequence=1), header(5, sequence=2), False),
        (header(1, incarnation=2), header(5, incarnation=1), True),
        (header(5, incarnation=1), header(5, incarnation=2), False),
        (header(6, incarnation=1), header(5, incarnation=2), True),
    ],
)
def test_the_later_message_of_a_start_counts_and_the_later_start(new: Any, last: Any, newer: bool) -> None:
    assert supersedes(new, last) is newer


def test_a_status_that_was_overtaken_changes_nothing(session: Any) -> None:
    told: list[Topic | None] = []
    state = MissionState(session.client, told.append)
    state.follow()
    session.send(GROUND_STATUS, header(START + 5), ground(2))
    session.send(GROUND_STATUS, header(START + 3), ground(1))
    assert state.status == ground(2)
    assert told == [GROUND_STATUS]


def test_facts_of_before_are_asked_for(session: Any) -> None:
    session.kept = {
        EARTH_CLOCK: (header(START + 7), lockstep(START + 7)),
        GROUND_STATUS: (header(START + 2), ground(1)),
    }
    session.answers[LIST_COMMANDS] = lambda: CommandList(commands=(status(CommandStage.QUEUED),))
    state = MissionState(session.client)
    state.follow()
    assert (state.status, state.commands) == (ground(1), (status(CommandStage.QUEUED),))
    assert state.time.now() == START + 7
    assert state.time.elapsed_s() == 7e-9
    assert not state.knows_nothing


def test_an_event_that_is_repeated_counts_once(session: Any) -> None:
    state = MissionState(session.client)
    state.follow()
    for sequence in (1, 1, 2, 1):
        session.send(EVENT, header(START, sequence=sequence, source="rover"), event(str(sequence)))
    assert [each.event.detail for each in state.events] == ["1", "2"]


def test_what_the_ground_has_logged_comes_before_what_was_heard_and_nothing_twice(session: Any) -> None:
    state = MissionState(session.client)
    state.follow()
    session.send(EVENT, header(START, source="rover"), event("2"))
    entries = tuple(LogEntry(number=number, at=START, kind=LogKind.PLAN, text=f"{number}") for number in (0, 1))
    session.send(LOG_ENTRY, header(START), entries[1])
    heard = tuple(HeardEvent(event=event(text), received_at=START) for text in ("1", "2"))
    modes = (ModeChange(mode=RoverMode.IDLE, made_at=1, received_at=2),)
    session.answers[SHOW_LOG] = lambda: MissionLog(entries=entries, events=heard, modes=modes)
    state.catch_up()
    assert [each.event.detail for each in state.events] == ["1", "2"]
    assert (state.entries, state.modes) == (entries, modes)


def test_what_was_made_on_the_moon_does_not_tell_the_time_on_earth(session: Any) -> None:
    state = MissionState(session.client)
    state.follow()
    session.send(GROUND_STATUS, header(START + 5), ground(0))
    session.send(EVENT, header(START + 9, source="rover"), event())
    assert state.time.now() == START + 5


def test_a_command_keeps_its_longest_list_of_stages_and_its_place_in_the_order_of_issue(
    session: Any,
) -> None:
    state = MissionState(session.client)
    state.follow()
    later = status(CommandStage.QUEUED, name="b", at=START + 1)
    session.send(COMMAND_STATUS, header(2), later)
    session.send(COMMAND_STATUS, header(1), status(CommandStage.QUEUED, CommandStage.RELEASED))
    session.send(COMMAND_STATUS, header(3), status(CommandStage.QUEUED))
    assert state.commands == (status(CommandStage.QUEUED, CommandStage.RELEASED), later)


def test_a_mission_that_is_started_anew_replaces_everything_that_was_known(session: Any) -> None:
    told: list[Topic | None] = []
    state = MissionState(session.client, told.append)
    session.kept = {EARTH_CLOCK: (header(START + 900 * SECOND, source="link"), lockstep(START + 900 * SECOND))}
    state.follow()
    session.send(EARTH_PRESENCE, header(START + 900 * SECOND).model_copy(update={"source": "link"}), timekeeper(7))
    session.send(GROUND_STATUS, header(START + 900 * SECOND), ground(5))
    session.send(EVENT, header(START, source="rover"), event())

    session.kept = {
        EARTH_CLOCK: (header(START + 1, source="link"), lockstep(START + 1)),
        GROUND_STATUS: (header(START + 1), ground(0)),
    }
    session.send(EARTH_PRESENCE, header(START + 1).model_copy(update={"source": "link"}), timekeeper(8))
    told.clear()
    state.refresh()
    assert told[0] is None
    assert (state.status, state.events, state.time.now()) == (ground(0), (), START + 1)


def test_a_timekeeper_that_continues_the_mission_replaces_nothing(session: Any) -> None:
    told: list[Topic | None] = []
    state = MissionState(session.client, told.append)
    session.kept = {EARTH_CLOCK: (header(START + 900 * SECOND, source="link"), lockstep(START + 900 * SECOND))}
    state.follow()
    session.send(EARTH_PRESENCE, header(START + 900 * SECOND).model_copy(update={"source": "link"}), timekeeper(7))
    session.send(EVENT, header(START, source="rover"), event())
    session.send(EARTH_PRESENCE, header(START + 900 * SECOND).model_copy(update={"source": "link"}), timekeeper(8))
    state.refresh()
    assert None not in told
    assert len(state.events) == 1


def test_a_mission_is_silent_once_nothing_has_come_for_long(session: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    state = MissionState(session.client)
    state.follow()
    session.send(GROUND_STATUS, header(START), ground(0))
    assert not state.is_silent
    late = time.monotonic() + 16.0
    monkeypatch.setattr("services.console.client.mission_state.time.monotonic", lambda: late)
    assert state.is_silent


def that_lost_a_status(session: Any) -> MissionState:
    """A state that follows a mission and has its status of 5 samples; the ground has sent one of 6 since."""
    state = MissionState(session.client)
    state.follow()
    session.send(GROUND_STATUS, header(START), ground(5))
    session.kept = {GROUND_STATUS: (header(START + 1), ground(6))}
    return state


def test_a_status_that_was_lost_is_asked_for_while_the_ground_is_alive(
    session: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = time.monotonic()
    monkeypatch.setattr("services.console.client.mission_state.time.monotonic", lambda: now)
    state = that_lost_a_status(session)
    beat = Presence(name="ground", side="earth", incarnation=1, software="1", pid=1, host="h", refused=0, events=0)
    for later_s, samples in ((1.0, 5), (4.0, 6)):
        now += later_s
        session.send(EARTH_PRESENCE, header(START), beat)
        state.refresh()
        assert state.status is not None
        assert state.status.samples == samples


def test_a_ground_that_is_silent_is_not_asked_for_its_status(session: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    now = time.monotonic()
    monkeypatch.setattr("services.console.client.mission_state.time.monotonic", lambda: now)
    state = that_lost_a_status(session)
    now += 60.0
    state.refresh()
    assert state.status == ground(5)


def test_of_many_commands_the_newest_and_those_under_way_are_kept(session: Any) -> None:
    state = MissionState(session.client)
    state.follow()
    session.send(COMMAND_STATUS, header(0), status(CommandStage.QUEUED, name="under-way"))
    for number in range(MAX_COMMANDS + 50):
        ended = status(CommandStage.QUEUED, CommandStage.REJECTED, name=f"c{number}")
        session.send(COMMAND_STATUS, header(number + 1), ended)
    kept = {each.command.command_id for each in state.commands}
    assert len(kept) == MAX_COMMANDS
    assert {"under-way", f"c{MAX_COMMANDS + 49}"} <= kept

"""A host: headers, checks, queries, custody and counts."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from schemas.codec import decode, encode
from schemas.commands import CommandKind, NoParameters, Telecommand
from schemas.link import LinkChange
from schemas.measurement import MeasurementReply, MeasurementRequest
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState
from schemas.topics import (
    ACK_DOWN,
    ACK_UP,
    COMMAND,
    EVENT,
    ISSUE_COMMAND,
    LINK_SET,
    LIST_COMMANDS,
    MEASURE,
    PLAN,
    SAMPLE,
    STATE,
    TOPICS,
    Crosses,
    Side,
)
from schemas.wire import Header
from services.mission.mission_time import MAX_AHEAD
from services.runtime.actions import Publish, PutQuery, Reply, ReplyError
from services.runtime.host import Host, origin
from services.runtime.inputs import (
    CheckedQueryArrived,
    MessageArrived,
    ProcessStarted,
    QueryArrived,
    QueryUnanswered,
    ReplyArrived,
    TimerElapsed,
)
from services.runtime.node import (
    Cause,
    Event,
    Interface,
    Level,
    LogRecord,
    NoReply,
    QueryFailed,
    QueryReceived,
    QueueDepthChanged,
    Received,
    ReceivedRaw,
    RefuseQuery,
    ReplyReceived,
    Send,
    SendQuery,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
)

STATE_NOW = RoverState(
    mode=RoverMode.IDLE, x_m=1.0, y_m=2.0, heading_deg=0.0, energy_wh=1.0, capacity_wh=2.0, driven_m=0.0, drilled_m=0.0,
    round=0, plan_revision=0, rounds_on_board=0, samples_done=0, queue_depth=0,
)  # fmt: skip
MEASUREMENT = MeasurementRequest(sample_id="s1", x_m=1.0, y_m=2.0, depth_m=0.1)


class Scripted:
    """A node that stores its events and returns scripted effects."""

    def __init__(self, **interface: object) -> None:
        self.interface = Interface(**{"name": "rover", "sides": (Side.MOON,), "custody": False, **interface})
        self.seen: list[Event] = []
        self.next: list[object] = []

    def handle(self, event: Event, now: int) -> Iterable[object]:
        self.seen.append(event)
        effects, self.next = self.next, []
        return effects


def hosted(**interface: object) -> tuple[Scripted, Host]:
    node = Scripted(**interface)
    host = Host(node, "short")
    host.handle(ProcessStarted(3), 10)
    node.seen.clear()
    return node, host


def message(topic, body, mission="short", sequence=0, source="ground", made_at=4) -> bytes:
    return encode(Header(mission=mission, source=source, incarnation=1, sequence=sequence, made_at=made_at), body)


PAUSE = Telecommand(command_id="c1", kind=CommandKind.PAUSE)


def test_a_message_gets_a_header_with_a_sequence_of_its_topic():
    node, host = hosted()
    node.next = [Send(STATE, STATE_NOW), Send(STATE, STATE_NOW), Send(SAMPLE, STATE_NOW)]
    published = host.handle(TimerElapsed("t"), 99)
    headers = [decode(STATE, action.payload, "short")[0] for action in published if isinstance(action, Publish)]
    assert [(h.source, h.incarnation, h.sequence, h.made_at) for h in headers] == [
        ("rover", 3, 0, 99),
        ("rover", 3, 1, 99),
        ("rover", 3, 0, 99),
    ]
    assert {action.side for action in published} == {Side.MOON}


def test_a_new_start_counts_from_0_in_its_own_incarnation():
    node, host = hosted()
    node.next = [Send(STATE, STATE_NOW)]
    host.handle(TimerElapsed("t"), 11)
    node.next = [Send(STATE, STATE_NOW)]
    (published,) = host.handle(ProcessStarted(4), 12)
    header = decode(STATE, published.payload, "short")[0]
    assert (header.incarnation, header.sequence) == (4, 0)
    assert node.seen[-1] == Started(4)
    assert host.incarnation == 4


def test_a_message_is_checked_and_delivered():
    node, host = hosted(subscribes=(COMMAND,))
    assert host.handle(MessageArrived(COMMAND, message(COMMAND, PAUSE)), 20) == []
    (event,) = node.seen
    assert isinstance(event, Received)
    assert (event.topic, event.body) == (COMMAND, PAUSE)
    assert host.events == 2
    assert host.refused == 0


@pytest.mark.parametrize("payload", [b"", b"{}", message(COMMAND, PAUSE, mission="other")])
def test_a_bad_message_is_refused_and_counted_and_does_not_reach_the_node(payload):
    node, host = hosted(subscribes=(COMMAND,))
    (note,) = host.handle(MessageArrived(COMMAND, payload), 20)
    assert isinstance(note, LogRecord)
    assert (note.level, note.fields) == (Level.WARNING, {"refused": 1})
    assert note.text.startswith("refused: he3/short/tc/command: ")
    assert (node.seen, host.refused, host.events) == ([], 1, 1)


def test_a_raw_message_is_delivered_as_it_arrived():
    node, host = hosted(name="link", sides=(Side.MOON, Side.EARTH), receives_raw=(COMMAND,))
    payload = message(COMMAND, PAUSE)[:-9] + b"damaged"
    host.handle(MessageArrived(COMMAND, payload), 20)
    assert node.seen == [ReceivedRaw(COMMAND, payload)]
    assert host.refused == 0


@pytest.mark.parametrize(
    ("payload", "line"),
    [
        (b"\xff sealed", "refused: tc/command: expected a message of ground, got one of 'none'"),
        (
            message(COMMAND, PAUSE, source="mallory"),
            "refused: tc/command: expected a message of ground, got one of 'mallory'",
        ),
        (b'{"header":{"source":"\\ud800"}}', "refused: tc/command: expected a message of ground, got one of '\\ud800'"),
        (message(COMMAND, PAUSE) + b" " * 16_384, "refused: tc/command: expected at most 16384 bytes, got "),
    ],
)
def test_a_raw_message_that_is_too_long_or_of_another_source_is_refused(payload, line):
    node, host = hosted(name="link", sides=(Side.MOON, Side.EARTH), receives_raw=(COMMAND,))
    (record,) = host.handle(MessageArrived(COMMAND, payload), 20)
    assert record.text.startswith(line)
    assert (node.seen, host.refused) == ([], 1)


def test_a_message_from_the_future_is_refused():
    node, host = hosted(subscribes=(COMMAND,))
    header = Header(mission="short", source="ground", incarnation=1, sequence=0, made_at=20 + MAX_AHEAD)
    host.handle(MessageArrived(COMMAND, encode(header, PAUSE)), 20)
    assert len(node.seen) == 1
    for made_at in (21 + MAX_AHEAD, 2**63 - 1):
        later = header.model_copy(update={"made_at": made_at})
        (record,) = host.handle(MessageArrived(COMMAND, encode(later, PAUSE)), 20)
        assert "expected a message of ground made by 20 ns" in record.text
    assert len(node.seen) == 1


@pytest.mark.parametrize(
    ("payload", "cause"),
    [
        (b"x", Cause("tc/command: malformed", "")),
        (message(COMMAND, PAUSE)[:-2] + b" }", Cause("tc/command: damaged", "ground")),
        (message(COMMAND, PAUSE) + b" " * 16_384, Cause("tc/command: oversized", "ground")),
        (message(COMMAND, PAUSE, source="mallory"), Cause("tc/command: foreign", "mallory")),
        (message(COMMAND, PAUSE, mission="other"), Cause("tc/command: foreign", "ground")),
        (message(COMMAND, PAUSE, made_at=2**62), Cause("tc/command: not permitted", "ground")),
    ],
)
@pytest.mark.parametrize("way", ["admit", "handle"])
def test_a_refusal_says_of_what_kind_and_source_it_is_so_that_the_log_limits_its_lines(payload, cause, way):
    _, host = hosted(subscribes=(COMMAND,))
    given = MessageArrived(COMMAND, payload)
    lines = [host.admit(given, 20)[1] if way == "admit" else host.handle(given, 20) for _ in range(100)]
    assert host.refused == 100
    assert {record.cause for (record,) in lines} == {cause}


def test_a_query_of_the_node_is_sent_and_its_reply_is_checked_and_delivered_once():
    node, host = hosted()
    node.next = [SendQuery(MEASURE, MEASUREMENT, "q1", 5.0)]
    (put,) = host.handle(TimerElapsed("t"), 20)
    assert isinstance(put, PutQuery)
    assert (put.topic, put.side, put.query, put.timeout_s) == (MEASURE, Side.MOON, "q1", 5.0)
    assert decode(MEASURE, put.payload, "short")[1] == MEASUREMENT
    assert host.open_queries() == [put]
    reply = MeasurementReply(sample_id="s1", x_m=1.0, y_m=2.0, helium3_ppb=8.0, noise_std_ppb=0.1)
    host.handle(ReplyArrived("q1", message(MEASURE, reply, source="field")), 21)
    assert node.seen[-1] == ReplyReceived(MEASURE, "q1", reply)
    assert host.open_queries() == []
    seen = len(node.seen)
    assert host.handle(ReplyArrived("q1", message(MEASURE, reply, source="field")), 22) == []
    assert host.handle(QueryUnanswered("q1", NoReply.TIMEOUT, ""), 23) == []
    assert len(node.seen) == seen, "an answer that comes twice is taken once"


def test_a_bad_reply_is_refused_and_counted_and_ends_the_query():
    node, host = hosted()
    node.next = [SendQuery(MEASURE, MEASUREMENT, "q1")]
    host.handle(TimerElapsed("t"), 20)
    actions = host.handle(ReplyArrived("q1", b"rubbish"), 21)
    assert isinstance(actions[0], LogRecord)
    event = node.seen[-1]
    assert isinstance(event, QueryFailed)
    assert (event.why, host.refused) == (NoReply.REFUSED, 1)
    assert "(reply)" in event.detail


def test_a_query_without_a_reply_fails_with_its_reason():
    node, host = hosted()
    node.next = [SendQuery(MEASURE, MEASUREMENT, "q1")]
    host.handle(TimerElapsed("t"), 20)
    host.handle(QueryUnanswered("q1", NoReply.NO_ROUTE, ""), 21)
    assert node.seen[-1] == QueryFailed(MEASURE, "q1", NoReply.NO_ROUTE, "")


def test_a_query_is_answered_once_however_often_the_node_replies():
    node, host = hosted(name="ground", sides=(Side.EARTH,), serves=(LIST_COMMANDS,))
    node.next = [SendReply(7, STATE_NOW), SendReply(7, STATE_NOW), RefuseQuery(7, "again")]
    (reply,) = host.handle(QueryArrived(LIST_COMMANDS, message(LIST_COMMANDS, NoParameters()), 7), 20)
    assert isinstance(reply, Reply)
    assert (reply.token, reply.topic) == (7, LIST_COMMANDS)
    assert node.seen == [QueryReceived(LIST_COMMANDS, NoParameters(), 7)]


def test_a_query_may_be_answered_later_but_not_after_a_new_start():
    node, host = hosted(name="ground", sides=(Side.EARTH,), serves=(LIST_COMMANDS,))
    host.handle(QueryArrived(LIST_COMMANDS, message(LIST_COMMANDS, NoParameters()), 7), 20)
    host.handle(QueryArrived(LIST_COMMANDS, message(LIST_COMMANDS, NoParameters()), 8), 20)
    node.next = [RefuseQuery(7, "not now")]
    assert host.handle(TimerElapsed("t"), 21) == [ReplyError(7, LIST_COMMANDS, "not now")]
    host.handle(ProcessStarted(4), 22)
    node.next = [SendReply(8, STATE_NOW)]
    assert host.handle(TimerElapsed("t"), 23) == []


def test_a_bad_query_is_refused_and_counted():
    node, host = hosted(name="link", sides=(Side.MOON, Side.EARTH), serves=(LINK_SET,))
    note, reply = host.handle(QueryArrived(LINK_SET, b"nonsense", 7), 20)
    assert isinstance(note, LogRecord)
    assert isinstance(reply, ReplyError)
    assert (reply.token, host.refused, node.seen) == (7, 1, [])
    assert "expected" in reply.why or "invalid" in reply.why
    host.handle(CheckedQueryArrived(LINK_SET, LinkChange(), 8), 20)
    assert node.seen == [QueryReceived(LINK_SET, LinkChange(), 8)]


def test_timers_and_log_records_pass_through():
    node, host = hosted()
    note, wake = LogRecord(Level.INFO, "so"), SetTimer("t", 50)
    node.next = [note, wake]
    assert host.handle(TimerElapsed("t"), 40) == [note, wake]
    assert node.seen == [TimerFired("t")]


def test_telemetry_is_made_on_the_moon_and_commands_on_earth():
    for topic in TOPICS:
        expected = {Crosses.UP: Side.EARTH, Crosses.DOWN: Side.MOON}.get(topic.crosses, topic.sides[0])
        assert origin(topic) is expected


def test_a_node_receives_what_it_subscribes_to_on_its_own_side_only():
    _, rover = hosted(subscribes=(PLAN, COMMAND))
    assert rover.received_topics() == [(PLAN, Side.MOON), (COMMAND, Side.MOON)]
    assert not rover.receives(PLAN, Side.EARTH)
    assert not rover.receives(SAMPLE, Side.MOON)
    _, link = hosted(name="link", sides=(Side.MOON, Side.EARTH), receives_raw=(PLAN, SAMPLE))
    assert link.received_topics() == [(SAMPLE, Side.MOON), (PLAN, Side.EARTH)], "only where they are made"


def test_a_node_with_custody_receives_the_acknowledgements_of_the_other_side():
    _, rover = hosted(subscribes=(COMMAND,), custody=True)
    assert rover.receives(ACK_UP, Side.MOON)
    assert not rover.receives(ACK_DOWN, Side.MOON)
    _, ground = hosted(name="ground", sides=(Side.EARTH,), subscribes=(SAMPLE,), custody=True)
    assert ground.receives(ACK_DOWN, Side.EARTH)
    assert not ground.receives(ACK_UP, Side.EARTH)


def test_a_node_that_asks_for_it_sees_the_depth_of_its_queue_once_an_input():
    report = RoverEvent(kind=EventKind.PARKED, at=0, x_m=0.0, y_m=0.0, round=0)
    for asked, expected in ((True, [QueueDepthChanged(2), QueueDepthChanged(3)]), (False, [])):
        lines: list[str] = []
        node = Scripted(subscribes=(COMMAND,), custody=True, reports_queue_depth=asked)
        host = Host(node, "short", lambda _now, _name, what, lines=lines: lines.append(what))
        host.handle(ProcessStarted(1), 10)
        node.next = [Send(EVENT, report), Send(EVENT, report)]
        host.handle(TimerElapsed("a"), 20)
        host.handle(TimerElapsed("b"), 30)
        node.next = [Send(EVENT, report)]
        host.handle(TimerElapsed("c"), 40)
        assert [event for event in node.seen if isinstance(event, QueueDepthChanged)] == expected
        assert lines == ["started 1", "due a", "due b", "due c"]
        assert host.events == 4


def test_every_event_is_a_line_of_the_event_log():
    lines: list[tuple[int, str, str]] = []
    host = Host(Scripted(subscribes=(COMMAND,)), "short", lambda *line: lines.append(line))
    host.handle(ProcessStarted(1), 10)
    host.handle(MessageArrived(COMMAND, message(COMMAND, PAUSE)), 20)
    host.handle(TimerElapsed("look"), 30)
    assert [(at, name, what.split()[0]) for at, name, what in lines] == [
        (10, "rover", "started"),
        (20, "rover", "received"),
        (30, "rover", "due"),
    ]


def test_an_event_log_has_what_changes_the_mission_and_no_query_of_an_observer():
    lines = []
    node = Scripted(name="ground", sides=(Side.EARTH,), serves=(LIST_COMMANDS, ISSUE_COMMAND))
    host = Host(node, "short", lambda now, name, what: lines.append(what))
    host.handle(QueryArrived(LIST_COMMANDS, message(LIST_COMMANDS, NoParameters()), 7), 20)
    pause = Telecommand(command_id="c", kind=CommandKind.PAUSE)
    host.handle(QueryArrived(ISSUE_COMMAND, message(ISSUE_COMMAND, pause), 8), 20)
    assert lines == ["asked earth/ground/command"]

"""An input that a node fails upon is set aside: it ends no process, is answered, reported and kept for diagnosis."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from pathlib import Path

import pytest

from schemas.codec import encode
from schemas.commands import CommandKind, NoParameters, Telecommand
from schemas.measurement import MeasurementReply, MeasurementRequest
from schemas.refusal import RefusalCode
from schemas.topics import COMMAND, LIST_COMMANDS, MEASURE, Side, Topic
from schemas.wire import Header, Wire
from services.runtime.actions import ReplyError, SetAside
from services.runtime.host import Host
from services.runtime.inputs import Input, MessageArrived, ProcessStarted, QueryArrived, ReplyArrived, TimerElapsed
from services.runtime.node import (
    Effect,
    Event,
    Interface,
    NoReply,
    QueryFailed,
    QueryReceived,
    Received,
    ReplyReceived,
    SendQuery,
    SetTimer,
)
from services.runtime.scheduler import InlineExecutor, NodeScheduler
from services.runtime.set_aside import MAX_KEPT, SetAsideFile

PAUSE = Telecommand(command_id="c1", kind=CommandKind.PAUSE)


class Fragile:
    """A node that fails upon the events of these types, after its first effect."""

    def __init__(self, *fails_upon: type) -> None:
        self.interface = Interface("rover", (Side.MOON,), subscribes=(COMMAND,), serves=(LIST_COMMANDS,), custody=False)
        self.seen: list[Event] = []
        self._fails_upon = fails_upon

    def handle(self, event: Event, now: int) -> Iterable[Effect]:
        self.seen.append(event)
        yield SetTimer("first", now)
        if isinstance(event, self._fails_upon):
            raise ZeroDivisionError("poison\x1b[2J")
        yield SetTimer("second", now)


def sent(topic: Topic, body: Wire, source: str = "ground") -> bytes:
    return encode(Header(mission="m", source=source, incarnation=1, sequence=0, made_at=0), body)


POISON = MessageArrived(COMMAND, sent(COMMAND, PAUSE))


def host_of(node: Fragile, contains_defects: bool = True) -> Host:
    host = Host(node, "m", contains_defects=contains_defects)
    host.handle(ProcessStarted(1), 0)
    return host


def test_a_message_that_its_node_fails_upon_is_set_aside_and_the_node_goes_on() -> None:
    node = Fragile(Received)
    host = host_of(node)
    first, aside = host.handle(POISON, 5)
    assert first == SetTimer("first", 5), "what was done before the exception stands"
    assert isinstance(aside, SetAside)
    assert aside.payload == POISON.payload
    assert aside.what.startswith("tc/command ")
    assert aside.error.startswith("ZeroDivisionError: poison\\x1b[2J (")
    assert "test_set_aside.py" in aside.error
    assert (host.defects, host.refused) == (1, 0)
    assert host.handle(TimerElapsed("t"), 6) == [SetTimer("first", 6), SetTimer("second", 6)]


def test_a_query_that_its_node_fails_upon_is_answered_with_a_refusal() -> None:
    host = host_of(Fragile(QueryReceived))
    *_, answer = host.handle(QueryArrived(LIST_COMMANDS, sent(LIST_COMMANDS, NoParameters(), "operator"), 7), 5)
    assert isinstance(answer, ReplyError)
    assert (answer.token, answer.code) == (7, RefusalCode.INTERNAL)
    assert "defect" in answer.why


def test_a_reply_that_its_node_fails_upon_ends_the_query() -> None:
    class Asking(Fragile):
        def handle(self, event: Event, now: int) -> Iterable[Effect]:
            if len(self.seen) == 1:
                yield SendQuery(MEASURE, MeasurementRequest(sample_id="s", x_m=1.0, y_m=1.0, depth_m=0.1), "q1")
            yield from super().handle(event, now)

    node = Asking(ReplyReceived)
    host = host_of(node)
    host.handle(TimerElapsed("t"), 1)
    reply = MeasurementReply(sample_id="s", x_m=1.0, y_m=1.0, helium3_ppb=8.0, noise_std_ppb=0.1)
    host.handle(ReplyArrived("q1", sent(MEASURE, reply, "field")), 2)
    assert isinstance(node.seen[-1], QueryFailed)
    assert node.seen[-1].why is NoReply.REFUSED


@pytest.mark.parametrize("given", [TimerElapsed("t"), ProcessStarted(2)])
def test_a_defect_that_no_input_from_outside_has_caused_ends_the_process(given: Input) -> None:
    host = host_of(Fragile())
    host._node._fails_upon = (Event,)  # type: ignore[attr-defined]
    with pytest.raises(ZeroDivisionError):
        host.handle(given, 5)


def test_a_simulation_shows_every_defect() -> None:
    with pytest.raises(ZeroDivisionError):
        host_of(Fragile(Received), contains_defects=False).handle(POISON, 5)


def test_a_poison_input_in_the_journal_does_not_end_the_restart() -> None:
    node = Fragile(Received)
    scheduler = NodeScheduler(Host(node, "m", contains_defects=True), InlineExecutor())
    scheduler.replay([(0, ProcessStarted(1)), (5, POISON), (6, TimerElapsed("t"))])
    assert len(node.seen) == 3
    assert scheduler.host.defects == 1


def test_each_input_of_a_flood_of_poison_is_counted_with_the_place_of_its_defect() -> None:
    host = host_of(Fragile(Received))
    asides = [each for _ in range(1_000) for each in host.handle(POISON, 5) if isinstance(each, SetAside)]
    assert host.defects == len(asides) == 1_000
    (place,) = {aside.place for aside in asides}
    assert __file__ in place, "the log limits the lines of one place"


def test_the_first_inputs_that_were_set_aside_are_kept_over_restarts(tmp_path: Path) -> None:
    path = tmp_path / "rover.set-aside.jsonl"
    action = SetAside("tc/command 3 00000000", b"abc" * 100_000, "ZeroDivisionError: x", ("line",), 1)
    kept = [SetAsideFile(path).keep(action, 5) for _ in range(MAX_KEPT + 3)]
    assert kept == [True] * MAX_KEPT + [False] * 3
    lines = [json.loads(line) for line in io.StringIO(path.read_text())]
    assert len(lines) == MAX_KEPT
    assert lines[0]["bytes"] == 300_000
    assert path.stat().st_size < MAX_KEPT * 100_000
    assert path.stat().st_mode & 0o077 == 0
    assert not SetAsideFile(None).keep(action, 5)
    assert not SetAsideFile(tmp_path / "no" / "folder").keep(action, 5)

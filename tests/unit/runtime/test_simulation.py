"""The simulation driver: order, time, queries, computations."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from schemas.codec import encode
from schemas.ground import Presence
from schemas.measurement import MeasurementReply, MeasurementRequest
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT, MEASURE, MOON_PRESENCE, STATE, Side
from schemas.wire import Header
from services.mission.mission_time import SECOND
from services.runtime.drivers.simulation import Simulation
from services.runtime.node import (
    Compute,
    Computed,
    Effect,
    Event,
    Interface,
    NoReply,
    QueryFailed,
    QueryReceived,
    Received,
    ReplyReceived,
    Send,
    SendQuery,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
)


class Scripted:
    """A node whose effects come from a function; it stores its events."""

    def __init__(self, interface: Interface, script: Callable[[Event, int], Iterable[Effect]]) -> None:
        self.interface = interface
        self.seen: list[tuple[int, Event]] = []
        self._script = script

    def handle(self, event: Event, now: int) -> Iterable[Effect]:
        self.seen.append((now, event))
        return self._script(event, now)


def beat(number: int) -> Presence:
    return Presence(name="n", side="moon", incarnation=1, software="", pid=1, host="", refused=0, events=number)


def happened(number: int) -> RoverEvent:
    return RoverEvent(kind=EventKind.PARKED, at=0, x_m=0.0, y_m=0.0, round=number)


def simulation(*nodes: Scripted) -> Simulation:
    return Simulation(nodes, "m", 0)


def rover(script: Callable[[Event, int], Iterable[Effect]]) -> Scripted:
    return Scripted(Interface("rover", (Side.MOON,)), script)


def test_a_timer_fires_at_its_nanosecond_and_a_moved_timer_only_once() -> None:
    def script(event: Event, now: int) -> Iterable[Effect]:
        if isinstance(event, Started):
            return [SetTimer("a", 5), SetTimer("a", 7), SetTimer("b", 3), SetTimer("c", 4), SetTimer("c", None)]
        return []

    node = rover(script)
    simulation(node).run()
    assert [(at, event.timer) for at, event in node.seen if isinstance(event, TimerFired)] == [(3, "b"), (7, "a")]


def test_messages_of_one_instant_are_handled_by_sender_and_order_of_sending_in_any_order_of_nodes() -> None:
    def sender(name: str) -> Scripted:
        return Scripted(
            Interface(name, (Side.MOON,)),
            lambda event, now: [Send(MOON_PRESENCE, beat(i)) for i in (1, 2)] if isinstance(event, Started) else [],
        )

    orders = []
    for names in (("field", "rover"), ("rover", "field")):
        listener = Scripted(Interface("link", (Side.MOON,), subscribes=(MOON_PRESENCE,)), lambda event, now: [])
        simulation(*(sender(name) for name in names), listener).run()
        orders.append([(e.header.source, e.body.events) for _, e in listener.seen if isinstance(e, Received)])
    assert orders[0] == orders[1] == [("field", 1), ("field", 2), ("rover", 1), ("rover", 2)]


def test_a_message_reaches_only_the_nodes_on_its_side() -> None:
    def talk(event: Event, now: int) -> Iterable[Effect]:
        return [Send(EVENT, happened(1))] if isinstance(event, Started) else []

    earth = Scripted(Interface("ground", (Side.EARTH,), subscribes=(EVENT,)), lambda event, now: [])
    simulation(rover(talk), earth).run()
    assert not [event for _, event in earth.seen if isinstance(event, Received)]


def test_a_query_is_answered_in_the_same_instant_and_one_without_a_server_fails() -> None:
    request = MeasurementRequest(sample_id="s", x_m=1.0, y_m=2.0, depth_m=0.1)

    def asker(event: Event, now: int) -> Iterable[Effect]:
        return [SendQuery(MEASURE, request, "q")] if isinstance(event, Started) else []

    def server(event: Event, now: int) -> Iterable[Effect]:
        if isinstance(event, QueryReceived):
            reply = MeasurementReply(sample_id="s", x_m=1.0, y_m=2.0, helium3_ppb=8.0, noise_std_ppb=0.1)
            return [SendReply(event.token, reply)]
        return []

    node = rover(asker)
    simulation(node, Scripted(Interface("field", (Side.MOON,), serves=(MEASURE,)), server)).run()
    answers = [event for _, event in node.seen if isinstance(event, ReplyReceived)]
    assert [(a.query, a.reply.helium3_ppb) for a in answers] == [("q", 8.0)]

    alone = rover(asker)
    simulation(alone).run()
    assert [e.why for _, e in alone.seen if isinstance(e, QueryFailed)] == [NoReply.NO_ROUTE]


def test_a_computation_ends_exactly_when_it_says_with_its_result_or_its_error() -> None:
    def script(event: Event, now: int) -> Iterable[Effect]:
        if isinstance(event, Started):
            return [Compute("sum", sum, ((1, 2),), takes_s=2.5), Compute("bad", int, ("x",), takes_s=1.0)]
        return []

    node = rover(script)
    simulation(node).run()
    ended = [(at, e.job, e.result, type(e.error)) for at, e in node.seen if isinstance(e, Computed)]
    assert ended == [(SECOND, "bad", None, ValueError), (5 * SECOND // 2, "sum", 3, type(None))]


def test_a_bad_message_from_outside_is_refused_with_one_line_and_reaches_no_node() -> None:
    listener = Scripted(Interface("listener", (Side.MOON,), subscribes=(STATE, EVENT)), lambda event, now: [])
    world = simulation(listener)
    world.run()
    before = list(listener.seen)
    world.inject(STATE, Side.MOON, b"not json")
    header = Header(mission="m", source="x", incarnation=1, sequence=0, made_at=0)
    world.inject(STATE, Side.MOON, encode(header, happened(1)))
    world.run()
    assert listener.seen == before
    assert world.host("listener").refused == 2
    texts = [note.text for _, _, note in world.log_records]
    assert len(texts) == 2
    assert all(text.startswith("refused: he3/m/tm/state: ") and "\n" not in text for text in texts)

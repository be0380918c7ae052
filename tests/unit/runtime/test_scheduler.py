"""A scheduler: the order in which the inputs of one instant are handled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from random import Random

from schemas.codec import encode
from schemas.ground import Presence
from schemas.topics import MOON_PRESENCE, Side
from schemas.wire import Header
from services.runtime.host import Host
from services.runtime.inputs import Input, MessageArrived, ProcessStarted
from services.runtime.node import (
    Compute,
    Computed,
    Effect,
    Event,
    Interface,
    Received,
    SavedState,
    SetTimer,
    Started,
    TimerFired,
)
from services.runtime.scheduler import InlineExecutor, Kind, NodeScheduler


class Scripted:
    def __init__(self, script: Callable[[Event, int], Iterable[Effect]] = lambda event, now: ()) -> None:
        self.interface = Interface("rover", (Side.MOON,), subscribes=(MOON_PRESENCE,), custody=False)
        self.seen: list[tuple[int, Event]] = []
        self._script = script

    def handle(self, event: Event, now: int) -> Iterable[Effect]:
        self.seen.append((now, event))
        return self._script(event, now)


class ManualExecutor:
    """Computations end when the test says so."""

    def __init__(self) -> None:
        self.futures: list[Future[object]] = []

    def submit(self, function: Callable[..., object], /, *arguments: object) -> Future[object]:
        future: Future[object] = Future()
        self.futures.append(future)
        return future


def message(number: int, source: str = "field") -> Input:
    header = Header(mission="m", source=source, incarnation=1, sequence=number, made_at=0)
    beat = Presence(name=source, side="moon", incarnation=1, software="", pid=1, host="", refused=0, events=number)
    return MessageArrived(MOON_PRESENCE, encode(header, beat))


def scheduler_of(node: Scripted, executor: object = None) -> NodeScheduler:
    return NodeScheduler(Host(node, "m"), executor or InlineExecutor())


def test_messages_come_before_queries_replies_results_and_timers_ordered_by_sender_and_number() -> None:
    node = Scripted(
        lambda event, now: (
            [SetTimer("b", 7), SetTimer("a", 7), Compute("job", int)] if isinstance(event, Started) else []
        )
    )
    scheduler = scheduler_of(node)
    scheduler.put((Kind.MESSAGE, "", 0), ProcessStarted(1))
    scheduler.run(5)
    inputs = [((Kind.MESSAGE, who, number), message(number, who)) for who in ("field", "rover") for number in (1, 2)]
    Random(1).shuffle(inputs)
    for order, given in inputs:
        scheduler.put(order, given)
    scheduler.run(7)
    kinds = [type(event).__name__ for _, event in node.seen[1:]]
    assert kinds == ["Received"] * 4 + ["Computed", "TimerFired", "TimerFired"]
    assert [(e.header.source, e.body.events) for _, e in node.seen if isinstance(e, Received)] == [
        ("field", 1), ("field", 2), ("rover", 1), ("rover", 2)
    ]  # fmt: skip
    assert [e.timer for _, e in node.seen if isinstance(e, TimerFired)] == ["a", "b"]


class RecordingJournal:
    """Keeps, for each append, its inputs and how many events the node had seen by then."""

    def __init__(self, node: Scripted) -> None:
        self.appended: list[tuple[int, list[Input], int]] = []
        self.checkpoints = 0
        self._node = node

    def append(self, now: int, inputs: Sequence[Input]) -> None:
        self.appended.append((now, [*inputs], len(self._node.seen)))

    def checkpoint(self, state: SavedState) -> None:
        self.checkpoints += 1


class Durable(Scripted):
    """A scripted node that keeps nothing."""

    state_types: tuple[type, ...] = ()
    functions: Mapping[str, Callable[..., object]] = {}

    def checkpoint(self) -> SavedState:
        return {}

    def restore(self, state: SavedState) -> None:
        assert state == {}


def test_what_nobody_can_read_is_refused_and_counted_and_takes_no_room_in_the_journal() -> None:
    node = Scripted()
    journal = RecordingJournal(node)
    host = Host(node, "m")
    scheduler = NodeScheduler(host, InlineExecutor(), journal)
    junk: list[Input] = [MessageArrived(MOON_PRESENCE, b"junk"), MessageArrived(MOON_PRESENCE, b"x" * 20_000_000)]
    for number, given in enumerate([*junk, message(0)]):
        scheduler.put((Kind.MESSAGE, "", number), given)
    records = scheduler.run(5)
    assert [inputs for _, inputs, _ in journal.appended] == [[message(0)]]
    assert host.refused == len(records) == 2


def test_inputs_are_in_the_journal_before_the_node_sees_them() -> None:
    node = Durable()
    journal = RecordingJournal(node)
    scheduler = NodeScheduler(Host(node, "m"), InlineExecutor(), journal)
    scheduler.put((Kind.MESSAGE, "", 0), ProcessStarted(1))
    scheduler.run(5)
    scheduler.put((Kind.MESSAGE, "field", 1), message(1))
    scheduler.put((Kind.MESSAGE, "field", 0), message(0))
    scheduler.run(7)
    assert journal.appended == [(5, [ProcessStarted(1)], 0), (7, [message(0), message(1)], 1)]


def test_a_checkpoint_follows_each_result() -> None:
    node = Durable(lambda event, now: [Compute("job", int)] if isinstance(event, Started) else [])
    journal = RecordingJournal(node)
    scheduler = NodeScheduler(Host(node, "m"), InlineExecutor(), journal)
    scheduler.put((Kind.MESSAGE, "", 0), ProcessStarted(1))
    scheduler.run(5)
    assert journal.checkpoints == 0
    scheduler.run(5)
    assert journal.checkpoints == 1


def test_without_waiting_a_computation_that_is_due_is_left_until_it_has_ended() -> None:
    executor = ManualExecutor()
    node = Scripted(lambda event, now: [Compute("job", int)] if isinstance(event, Started) else [])
    scheduler = scheduler_of(node, executor)
    scheduler.put((Kind.MESSAGE, "", 0), ProcessStarted(1))
    scheduler.run(5, wait=False)
    assert scheduler.next_wake(wait=False) is None
    scheduler.run(6, wait=False)
    assert [type(event) for _, event in node.seen] == [Started]
    executor.futures[0].set_result(7)
    assert scheduler.next_wake(wait=False) == 5
    scheduler.run(8, wait=False)
    assert [type(event) for _, event in node.seen] == [Started, Computed]

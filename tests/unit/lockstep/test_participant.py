"""A participant in lockstep: it acts when a step is granted and every announced input has arrived."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future

from schemas.codec import encode
from schemas.ground import Presence
from schemas.lockstep import Grant, Joined
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT, MEASURE, MOON_PRESENCE, Side
from schemas.wire import Header
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError
from services.runtime.host import Host
from services.runtime.inputs import Input, MessageArrived, QueryUnanswered
from services.runtime.lockstep.participant import Participant
from services.runtime.node import (
    Compute,
    Effect,
    Event,
    Interface,
    NoReply,
    QueryFailed,
    Received,
    Send,
    SetTimer,
    Started,
)
from services.runtime.scheduler import InlineExecutor, NodeScheduler
from services.runtime.stamp import Stamp


class Scripted:
    def __init__(self, script: Callable[[Event, int], Iterable[Effect]] = lambda event, now: ()) -> None:
        self.interface = Interface("rover", (Side.MOON,), subscribes=(MOON_PRESENCE,), custody=False)
        self.seen: list[tuple[int, Event]] = []
        self._script = script

    def handle(self, event: Event, now: int) -> Iterable[Effect]:
        self.seen.append((now, event))
        return self._script(event, now)


class ManualExecutor:
    """An executor whose computations end only when the test says so."""

    def __init__(self) -> None:
        self.futures: list[Future[object]] = []

    def submit(self, function: Callable[..., object], /, *arguments: object) -> Future[object]:
        future: Future[object] = Future()
        self.futures.append(future)
        return future


class Carrier:
    """A transport that stores what it receives."""

    def __init__(self) -> None:
        self.sent: list[tuple[Action, Stamp | None]] = []

    def publish(self, action: Publish, stamp: Stamp) -> None:
        self.sent.append((action, stamp))

    def query(self, action: PutQuery, stamp: Stamp) -> None:
        self.sent.append((action, stamp))

    def reply(self, action: Reply | ReplyError, stamp: Stamp) -> None:
        self.sent.append((action, stamp))

    def perform(self, action: Action) -> None:
        self.sent.append((action, None))


def message(number: int, source: str = "field") -> Input:
    header = Header(mission="m", source=source, incarnation=1, sequence=number, made_at=0)
    beat = Presence(name=source, side="moon", incarnation=1, software="", pid=1, host="", refused=0, events=number)
    return MessageArrived(MOON_PRESENCE, encode(header, beat))


def scheduler_of(node: Scripted, executor: object = None) -> NodeScheduler:
    return NodeScheduler(Host(node, "m"), executor or InlineExecutor())


def part_of(node: Scripted, executor: object = None) -> Participant:
    part = Participant(scheduler_of(node, executor), "rover.1")
    part.obey("k")
    part.joined(Joined(term="k", admitted=True, now=100, step=0, starts=1))
    return part


def granted(part: Participant, step: int, at: int, **expects: int) -> Participant:
    part.grant(Grant(term="k", step=step, at=at, process=part.process, expects=expects))
    return part


def stamp(sender: str, number: int, step: int) -> Stamp:
    return Stamp(sender, f"{sender}.1", number, step, 100)


def test_what_arrives_during_a_step_waits_for_the_next() -> None:
    node = Scripted()
    part = part_of(node)
    part.take_message(message(1), stamp("field", 1, step=4))
    part.take_message(message(2), stamp("field", 2, step=5))
    granted(part, 5, 100, field=1).act(Carrier())
    assert [e.body.events for _, e in node.seen if isinstance(e, Received)] == [1]
    granted(part, 6, 100, field=1).act(Carrier())
    assert [e.body.events for _, e in node.seen if isinstance(e, Received)] == [1, 2]


def test_a_step_waits_for_every_input_that_its_grant_announces() -> None:
    part = part_of(Scripted())
    granted(part, 5, 100, field=2)
    part.take_message(message(1), stamp("field", 1, step=4))
    assert not part.ready()
    assert part.lacks() == {"field": 1}
    part.take_message(message(2), stamp("field", 2, step=4))
    assert part.ready()


def test_an_input_of_an_earlier_step_does_not_count_as_announced() -> None:
    part = part_of(Scripted())
    part.take_message(message(1), stamp("field", 1, step=3))
    granted(part, 5, 100, field=1)
    assert part.lacks() == {"field": 1}


def test_an_input_from_outside_needs_a_poke_and_does_not_count_as_announced() -> None:
    part = part_of(Scripted())
    granted(part, 5, 100, field=1)
    assert part.take_message(message(1), None)
    assert part.lacks() == {"field": 1}


def test_an_input_from_outside_that_arrives_during_a_step_waits_for_the_next() -> None:
    node = Scripted()
    part = part_of(node)
    granted(part, 5, 100)
    part.take_message(message(1), None)
    part.act(Carrier())
    assert node.seen == []
    granted(part, 6, 100).act(Carrier())
    assert [e.body.events for _, e in node.seen if isinstance(e, Received)] == [1]


def test_inputs_from_outside_are_held_while_a_mission_ends_and_all_others_are_handled() -> None:
    node = Scripted()
    part = part_of(node)
    part.hold_outside = True
    part.take_message(message(1), None)
    part.take_message(message(2), stamp("field", 1, step=4))
    granted(part, 5, 100, field=1).act(Carrier())
    assert [e.body.events for _, e in node.seen if isinstance(e, Received)] == [2]
    assert part.holds_outside
    part.hold_outside = False
    granted(part, 6, 100).act(Carrier())
    assert [e.body.events for _, e in node.seen if isinstance(e, Received)] == [2, 1]
    assert not part.holds_outside


def test_a_process_does_not_receive_its_own_messages() -> None:
    node = Scripted()
    part = part_of(node)
    assert not part.take_message(message(1), Stamp("rover", "rover.1", 1, 4, 100))
    granted(part, 5, 100).act(Carrier())
    assert node.seen == []


def test_a_grant_for_another_process_of_the_name_or_of_a_past_step_is_ignored() -> None:
    part = part_of(Scripted())
    part.grant(Grant(term="k", step=1, at=100, process="rover.2", expects={}))
    assert not part.ready()
    granted(part, 4, 100).act(Carrier())
    granted(part, 4, 100)
    assert not part.ready()


def test_a_grant_of_an_earlier_term_is_void_and_an_input_that_it_counted_needs_a_poke() -> None:
    part = part_of(Scripted())
    granted(part, 5, 100, field=1)
    part.obey("another")
    assert part.granted is None
    granted(part, 6, 100)
    assert part.granted is None, "no grant of this term has come"
    assert part.join().step == 5
    part.joined(Joined(term="another", admitted=True, now=100, step=7, starts=1))
    assert part.take_message(message(1), stamp("field", 1, step=4))
    part.grant(Grant(term="another", step=8, at=100, process="rover.1", expects={}))
    assert part.ready()


def test_a_reply_to_the_join_that_comes_after_the_first_grant_changes_nothing() -> None:
    part = part_of(Scripted())
    part.obey("another")
    part.grant(Grant(term="another", step=8, at=100, process="rover.1", expects={}))
    part.joined(Joined(term="another", admitted=True, now=100, step=7, starts=1))
    assert part.ready()


def test_a_query_without_a_reply_counts_in_the_step_in_which_it_was_sent() -> None:
    node = Scripted(lambda event, now: [])
    part = part_of(node)
    asked = Stamp("rover", "rover.1", 9, 4, 100)
    granted(part, 5, 100, rover=1)
    assert not part.ready()
    assert part.take_outcome(QueryUnanswered("q", NoReply.NO_ROUTE, ""), asked, None)
    assert part.ready()


def test_a_computation_that_has_not_ended_delays_the_step_in_which_it_is_due_and_no_other() -> None:
    executor = ManualExecutor()
    node = Scripted(lambda event, now: [Compute("job", int, (), 1e-9 * 50)] if isinstance(event, Started) else [])
    part = part_of(node, executor)
    part.start(1)
    done = granted(part, 1, 100).act(Carrier())
    assert done.next_wake == 150
    assert granted(part, 2, 120).ready()
    part.act(Carrier())
    granted(part, 3, 150)
    assert (part.ready(), part.computing()) == (False, ("job",))
    executor.futures[0].set_result(7)
    assert part.ready()
    part.act(Carrier())
    assert node.seen[-1][0] == 150


def test_everything_sent_is_stamped_and_reported() -> None:
    event = RoverEvent(kind=EventKind.PARKED, at=0, x_m=0, y_m=0, round=1)
    node = Scripted(lambda seen, now: [Send(EVENT, event), Send(EVENT, event)] if isinstance(seen, Started) else [])
    part = part_of(node)
    part.start(1)
    carrier = Carrier()
    done = granted(part, 3, 200).act(carrier)
    assert [sent[1] for sent in carrier.sent] == [Stamp("rover", "rover.1", n, 3, 200) for n in (1, 2)]
    assert done.published == ((EVENT.name, "moon", 2),)
    assert granted(part, 4, 200).act(carrier).published == ()


def test_a_timer_in_the_past_is_due_now() -> None:
    node = Scripted(lambda event, now: [SetTimer("late", now - 50)] if isinstance(event, Started) else [])
    part = part_of(node)
    part.start(1)
    assert granted(part, 1, 100).act(Carrier()).next_wake == 100


def test_a_query_without_a_reply_reaches_the_node_once() -> None:
    def script(event: Event, now: int) -> Iterable[Effect]:
        from schemas.measurement import MeasurementRequest
        from services.runtime.node import SendQuery

        request = MeasurementRequest(sample_id="s", x_m=1.0, y_m=1.0, depth_m=0.1)
        return [SendQuery(MEASURE, request, "q")] if isinstance(event, Started) else []

    node = Scripted(script)
    part = part_of(node)
    part.start(1)
    carrier = Carrier()
    done = granted(part, 1, 100).act(carrier)
    assert done.asked == ((MEASURE.name, "moon"),)
    asked = carrier.sent[0][1]
    assert asked is not None
    for _ in range(2):
        part.take_outcome(QueryUnanswered("q", NoReply.NO_ROUTE, ""), asked, None)
    granted(part, 2, 100, rover=1).act(carrier)
    assert [type(event) for _, event in node.seen] == [Started, QueryFailed]

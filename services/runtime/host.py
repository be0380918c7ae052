"""A host stands between a node and its driver: it makes headers, checks messages and keeps custody, without I/O.

A driver reports inputs (bytes, times, names) and carries out the actions that the host returns. What all drivers must
do alike is done here, so a mission is the same in one process, in many, and after a restart.
"""

from __future__ import annotations

import traceback
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from he3.errors import InvalidInput
from schemas.codec import NotPermitted, Refused, decode, decode_reply, encode, header_of, passed, raw_objection
from schemas.refusal import RefusalCode
from schemas.signing import Part
from schemas.topics import COMMAND, Crosses, Query, Side, Topic, under_custody
from schemas.wire import MAX_TEXT, Header, Wire, printable
from services.mission.mission_time import MAX_AHEAD, MissionTime
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError, SetAside
from services.runtime.audit_trail import RefusalCounter, named_in
from services.runtime.custody.endpoint import CUSTODY_TIMER, CustodyEndpoint
from services.runtime.custody.endpoint import STATE_TYPES as CUSTODY_STATE_TYPES
from services.runtime.inputs import (
    CheckedQueryArrived,
    ComputationEnded,
    Input,
    MessageArrived,
    ProcessStarted,
    QueryArrived,
    QueryUnanswered,
    ReplyArrived,
    TimerElapsed,
)
from services.runtime.node import (
    Cause,
    Compute,
    Computed,
    DurableNode,
    Effect,
    Event,
    Finish,
    Forward,
    Interface,
    Level,
    LogRecord,
    Node,
    NoReply,
    PublishSnapshot,
    QueryFailed,
    QueryReceived,
    QueueDepthChanged,
    Received,
    ReceivedRaw,
    RefuseQuery,
    ReplyReceived,
    Send,
    SendIfHeard,
    SendQuery,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
)
from services.runtime.state_codec import StateCodec

if TYPE_CHECKING:
    from services.runtime.audit_trail import AuditTrail
    from services.runtime.custody.protocol import CustodyConfig
    from services.runtime.node import SavedState
    from services.runtime.trust.gate import Gate


def origin(topic: Topic) -> Side:
    """The side on which messages of that topic are made."""
    if topic.crosses is Crosses.NEVER:
        return topic.sides[0]
    return Side.EARTH if topic.crosses is Crosses.UP else Side.MOON


def _from_outside(given: Input) -> bool:
    return isinstance(given, MessageArrived | QueryArrived | CheckedQueryArrived | ReplyArrived)


def _described(given: Input | None) -> tuple[str, bytes]:
    """The input in one line, and its bytes."""
    match given:
        case MessageArrived(topic, payload) | QueryArrived(topic, payload):
            return f"{topic.name} {len(payload)} {zlib.crc32(payload):08x}", payload
        case ReplyArrived(query, payload):
            return f"reply to {query} {len(payload)} {zlib.crc32(payload):08x}", payload
        case CheckedQueryArrived(topic, request):
            payload = request.model_dump_json().encode()
            return f"{topic.name} {len(payload)} {zlib.crc32(payload):08x}", payload
    return type(given).__name__, b""


def _sender(given: Input) -> str:
    """The sender that a message names, which is not proven; empty if it names none."""
    match given:
        case MessageArrived(_, payload) | QueryArrived(_, payload, _) | ReplyArrived(_, payload):
            return _named(payload)
    return ""


def _named(payload: bytes) -> str:
    header = header_of(payload)
    return printable(str(header.get("signer") or header.get("source") or ""))[:80]


EventSink = Callable[[MissionTime, str, str], None]
"""Called for each event handled with mission time, node and a line that describes it: the event log."""

FROM_OUTSIDE: Final = (Received, ReceivedRaw, QueryReceived, ReplyReceived)
"""Events that follow from what others send. An exception upon any other event ends the process."""

SHOWN_OF_KNOWN: Final = 20
"""Refusals of what came with a right signature of which each has a line in the audit log; later every tenfold has."""

DEFECT: Final = "a defect in the program: the input is set aside, see the log"

STATE_TYPES: Final[tuple[type, ...]] = (Compute, Finish, PublishSnapshot, PutQuery, Side, *CUSTODY_STATE_TYPES)
"""The types in the state of a host and its scheduler, beside plain values and the node's own types."""


class Host:
    """One node with its headers, queries and custody. `handle` is all that a driver calls while it runs."""

    def __init__(
        self,
        node: Node,
        mission: str,
        event_sink: EventSink | None = None,
        custody: CustodyConfig | None = None,
        contains_defects: bool = False,
        gate: Gate | None = None,
        audit: AuditTrail | None = None,
        passes_objects: bool = False,
        heard: Callable[[Topic, Side], bool] = lambda topic, side: True,
    ) -> None:
        """contains_defects: whether an exception upon an input from outside sets that input aside. False: it is raised,
        so that simulations and tests show it. gate: signs and verifies messages; None in a mission without keys. audit:
        where changes are written down. passes_objects: whether messages carry what they were made of, for readers in
        the same process. heard: whether anyone receives messages of that topic there; others are not made.
        """
        self._node = node
        self._encode = passed if passes_objects else encode
        self._heard = heard
        self._contains_defects = contains_defects
        self._given: Input | None = None
        self._defects = 0
        self._interface = node.interface
        self._mission = mission
        self._event_sink = event_sink
        self._incarnation = 0
        self._sequences: dict[str, int] = {}
        self._asked: dict[int, Topic] = {}
        self._queries: dict[str, PutQuery] = {}
        self._refused = 0
        self._refusals = RefusalCounter()
        self._refusals_of_known = RefusalCounter(SHOWN_OF_KNOWN)
        self._asking: dict[int, str] = {}
        self._gate = gate
        self._audit = audit
        self._events = 0
        interface = self._interface
        self._custody: CustodyEndpoint | None = None
        if interface.custody and any(under_custody(topic) for topic in interface.subscribes):
            self._custody = CustodyEndpoint(interface.name, interface.sides[0], custody, self._encoded)
        self._reported_depth = 0

    @property
    def node(self) -> Node:
        return self._node

    @property
    def interface(self) -> Interface:
        return self._interface

    @property
    def mission(self) -> str:
        return self._mission

    @property
    def incarnation(self) -> int:
        return self._incarnation

    @property
    def refused(self) -> int:
        """Messages from outside that were refused since the start."""
        return self._refused

    @property
    def defects(self) -> int:
        """Inputs from outside that were set aside since the start, because of a defect in the program."""
        return self._defects

    @property
    def retransmitted(self) -> int:
        """Messages under custody that were sent again."""
        return 0 if self._custody is None else self._custody.retransmitted

    @property
    def events(self) -> int:
        """Events handled since the start."""
        return self._events

    @property
    def admits_all(self) -> bool:
        """Whether `admit` checks no more than `handle` does, and `answered` has nothing to write down."""
        return self._gate is None and self._audit is None

    def receives(self, topic: Topic, side: Side) -> bool:
        """Whether a message published on that side is for this node.

        The link receives a topic that crosses only on the side on which its messages are made.
        """
        if side not in self._interface.sides:
            return False
        if topic in self._interface.receives_raw:
            return side is origin(topic)
        return topic in self._interface.subscribes or (self._custody is not None and topic is self._custody.ack_topic)

    def received_topics(self) -> list[tuple[Topic, Side]]:
        """The topics whose messages reach this node, each with the side on which they do."""
        interface = self._interface
        topics = [
            *interface.subscribes,
            *interface.receives_raw,
            *([self._custody.ack_topic] if self._custody is not None else []),
        ]
        return [(topic, side) for side in interface.sides for topic in topics if self.receives(topic, side)]

    def served_topics(self) -> list[tuple[Topic, Side]]:
        """The topics whose queries this node answers, each with the side on which they are received."""
        interface = self._interface
        return [(topic, side) for side in interface.sides for topic in interface.serves if side in topic.sides]

    def open_queries(self) -> list[PutQuery]:
        """Queries of this node that have not ended; a restarted process sends them again."""
        return list(self._queries.values())

    # --- checkpoints --------------------------------------------------------------------------------------------

    @property
    def codec(self) -> StateCodec:
        """The codec of its state and of the results of its computations; raises InvalidInput unless it is durable."""
        node = self._durable()
        return StateCodec((*STATE_TYPES, *node.state_types), node.functions)

    def checkpoint(self) -> SavedState:
        """The state of node and host, as named parts, without what belongs to this process only."""
        return {
            "node": self._durable().checkpoint(),
            "custody": None if self._custody is None else self._custody.checkpoint(),
            "incarnation": self._incarnation,
            "sequences": dict(self._sequences),
            "asked": dict(self._asked),
            "queries": dict(self._queries),
            "refused": self._refused,
            "defects": self._defects,
            "events": self._events,
            "reported_depth": self._reported_depth,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the host from this state."""
        self._durable().restore(state["node"])
        if self._custody is not None:
            self._custody.restore(state["custody"])
        self._incarnation, self._sequences = state["incarnation"], state["sequences"]
        self._asked, self._queries = state["asked"], state["queries"]
        self._refused, self._events, self._defects = state["refused"], state["events"], state["defects"]
        self._reported_depth = state["reported_depth"]

    def _durable(self) -> DurableNode:
        if not isinstance(self._node, DurableNode):
            raise InvalidInput(f"{self._interface.name}: expected a node that names its state, got one that does not")
        return self._node

    def reply_check(self, topic: Topic, now: MissionTime) -> Callable[[bytes], bool] | None:
        """Gives whether a reply to a query of that topic counts, for any thread; None: each of the right form does.

        `admit` checks the reply once more. now: when the query is sent.
        """
        gate = self._gate
        if gate is None or not topic.signed:
            return None

        def counts(payload: bytes) -> bool:
            try:
                header, _ = decode_reply(topic, payload, self._mission)
                gate.admit(Part.REPLY, topic, header, payload, now)
            except Refused:
                return False
            return True

        return counts

    # --- what a driver reports ----------------------------------------------------------------------------------

    def admit(self, given: Input, now: MissionTime) -> tuple[Input | None, list[Action]]:
        """The input as it is to be kept and handled, and the actions that follow if it is refused (then it is None).

        It is asked once about each input, before a journal keeps it: its answer depends on wall time and on the
        present roster, and messages that cannot be decoded must not fill the disk. What it refuses changes nothing.
        """
        try:
            if self._gate is None:
                self._require_form(given, now)
            if self.admits_all:
                return given, []
            match given:
                case MessageArrived(topic, payload) if topic.signed and topic not in self._interface.receives_raw:
                    return self._admit_message(given, topic, payload, now), []
                case QueryArrived(topic, payload) if topic.signed:
                    self._admit_query(given, topic, payload, now)
                case CheckedQueryArrived(topic, request) if topic.signed:
                    if self._gate is not None:
                        raise NotPermitted(f"{topic.name}: expected a signed message, got selector parameters")
                    self._write_down(topic, None, request, now)
                case ReplyArrived(query, payload) if query in self._queries:
                    topic = self._queries[query].topic
                    if topic.signed and self._gate is not None:
                        header, _ = decode_reply(topic, payload, self._mission)
                        self._gate.admit(Part.REPLY, topic, header, payload, now)
        except Refused as refusal:
            return self._not_admitted(given, refusal, now)
        except Exception as error:
            if not self._contains_defects:
                raise
            return self._defect_at_the_gate(given, error)
        return given, []

    def _require_form(self, given: Input, now: MissionTime) -> None:
        """Raise Refused for an input that its topic does not admit from any sender."""
        match given:
            case MessageArrived(topic, payload) if topic not in self._interface.receives_raw:
                self._decoded(topic, payload, now)
            case QueryArrived(topic, payload):
                decode(topic, payload, self._mission)
            case ReplyArrived(query, payload) if query in self._queries:
                decode_reply(self._queries[query].topic, payload, self._mission)

    def _decoded(self, topic: Topic, payload: bytes, now: MissionTime) -> tuple[Header, Any]:
        """Header and body of a message; raises Refused, also for one that was made in the future."""
        header, body = decode(topic, payload, self._mission)
        if header.made_at > now + MAX_AHEAD:
            raise NotPermitted(
                f"{topic.name}: expected a message of {header.source} made by {now} ns, got one of {header.made_at} ns"
            )
        return header, body

    def _admit_message(self, given: MessageArrived, topic: Topic, payload: bytes, now: MissionTime) -> Input:
        if self._gate is None and topic is not COMMAND:
            return given
        header, body = decode(topic, payload, self._mission)
        if self._gate is None:
            self._write_down(topic, header, body, now)
            return given
        self._gate.admit(Part.MESSAGE, topic, header, payload, now)
        if topic is not COMMAND:
            return given
        # The ground's message is genuine, so custody takes it: the rover answers for the command, and says why not.
        try:
            self._gate.admit_command(topic, header, body, now)
        except Refused as refusal:
            self._refused += 1
            self._audit_refusal(topic, named_in(header, body), str(refusal), now, each_of_first=True)
            return replace(given, objection=str(refusal))
        self._write_down(topic, header, body, now)
        return given

    def _admit_query(self, given: QueryArrived, topic: Topic, payload: bytes, now: MissionTime) -> None:
        header, body = decode(topic, payload, self._mission)
        if self._gate is not None:
            self._gate.admit(Part.QUERY, topic, header, payload, now)
            self._gate.admit_person(topic, header, body)
            self._gate.admit_command(topic, header, body, now)
        if self._audit is not None:
            self._asking[given.token] = named_in(header, body)
        self._write_down(topic, header, body, now)

    def answered(self, action: Action, now: MissionTime) -> None:
        """Write down a change that the node itself refuses, such as a command of who does not hold authority."""
        match action:
            case Reply(token):
                self._asking.pop(token, None)
            case ReplyError(token, topic, why):
                who = self._asking.pop(token, None)
                if who is not None and topic.signed:
                    known = self._gate is not None
                    self._audit_refusal(topic, who, why, now, verified=known, each_of_first=known)

    def _write_down(self, topic: Topic, header: Header | None, body: Wire, now: MissionTime) -> None:
        if self._audit is not None and (isinstance(topic.service, Query) or topic is COMMAND):
            self._audit.changed(topic, header, body, self._gate is not None, now)

    def _not_admitted(self, given: Input, refusal: Refused, now: MissionTime) -> tuple[Input | None, list[Action]]:
        """What becomes of an input that is refused: nothing, apart from an answer to who asks, and a log line."""
        sender, topic, why = _sender(given), self._topic_of(given), str(refusal)
        actions = self.refuse(topic, refusal, sender)
        self._audit_refusal(topic, sender, why, now)
        match given:
            case QueryArrived(asked, _, token) | CheckedQueryArrived(asked, _, token):
                actions.append(ReplyError(token, asked, why))
            case ReplyArrived(query):
                return QueryUnanswered(query, NoReply.REFUSED, why), actions
        return None, actions

    def _audit_refusal(
        self, topic: Topic, who: str, why: str, now: MissionTime, *, verified: bool = False, each_of_first: bool = False
    ) -> None:
        """Write down a refusal, unless there were many of that sender: each is counted, few have a line.

        verified: whether the name is proven. each_of_first: whether each of the first has a line, since a process with
        a right signature brought it.
        """
        if self._audit is None:
            return
        number, report = (self._refusals_of_known if each_of_first else self._refusals).count(who)
        if report:
            self._audit.refused(topic, who, why, number, now, verified=verified)

    def _defect_at_the_gate(self, given: Input, error: Exception) -> tuple[Input | None, list[Action]]:
        """Set aside an input whose check has failed: it does not count as admitted."""
        self._given = given
        actions = self._set_aside(error)
        self._given = None
        match given:
            case QueryArrived(asked, _, token) | CheckedQueryArrived(asked, _, token):
                actions.append(ReplyError(token, asked, DEFECT, RefusalCode.INTERNAL))
            case ReplyArrived(query):
                return QueryUnanswered(query, NoReply.REFUSED, DEFECT), actions
        return None, actions

    def _topic_of(self, given: Input) -> Topic:
        match given:
            case MessageArrived(topic) | QueryArrived(topic) | CheckedQueryArrived(topic):
                return topic
            case ReplyArrived(query):
                return self._queries[query].topic
        raise AssertionError(f"{type(given).__name__} does not come from outside")

    def handle(self, given: Input, now: MissionTime) -> list[Action]:
        """Actions that follow from the input, in order. `ProcessStarted` is the first input of each start."""
        self._given = given
        try:
            actions = self._dispatch(given, now)
        except Exception as error:
            if not (self._contains_defects and _from_outside(given)):
                raise
            actions = self._set_aside(error)
            if isinstance(given, QueryArrived | CheckedQueryArrived):
                self._asked.pop(given.token, None)
                actions.append(ReplyError(given.token, given.topic, DEFECT, RefusalCode.INTERNAL))
        finally:
            self._given = None
        if self._custody is not None:
            actions += self._report_queue_depth(self._custody.depth, now)
            actions += self._custody.move_timer()
        return actions

    # --- inside -------------------------------------------------------------------------------------------------

    def _dispatch(self, given: Input, now: MissionTime) -> list[Action]:
        match given:
            case TimerElapsed(timer):
                return self._timer(timer, now)
            case MessageArrived(topic, payload, objection):
                return self._message(topic, payload, objection, now)
            case ProcessStarted(incarnation):
                return self._start(incarnation, now)
            case QueryArrived(topic, payload, token):
                return self._query(topic, payload, token, now)
            case CheckedQueryArrived(topic, request, token):
                return self._checked_query(topic, request, token, now)
            case ReplyArrived(query, payload):
                return self._reply(query, payload, now)
            case QueryUnanswered(query, why, detail):
                return self._unanswered(query, why, detail, now)
            case ComputationEnded(job, result, error):
                what = f"computed {job}{' failed' if error else ''}"
                return self._handle(Computed(job, result, error), now, what)

    def _start(self, incarnation: int, now: MissionTime) -> list[Action]:
        self._incarnation = incarnation
        self._sequences = {}
        self._asked = {}
        if self._custody is not None:
            self._custody.start(self._mission, incarnation)
        return self._handle(Started(incarnation), now, f"started {incarnation}")

    def _message(self, topic: Topic, payload: bytes, objection: str | None, now: MissionTime) -> list[Action]:
        """The actions for an incoming message; one that its topic does not admit is refused and counted."""
        logs = self._event_sink is not None
        what = f"received {topic.name} {len(payload)} {zlib.crc32(payload):08x}" if logs else None
        if topic in self._interface.receives_raw:
            objection_to_raw = raw_objection(topic, payload)
            if objection_to_raw is not None:
                return self.refuse(topic, objection_to_raw, _named(payload))
            return self._handle(ReceivedRaw(topic, payload), now, what)
        try:
            header, body = self._decoded(topic, payload, now)
        except Refused as refusal:
            return self.refuse(topic, refusal, _named(payload))
        if topic is COMMAND and body.objection != objection:
            body = body.model_copy(update={"objection": objection})  # what a sender writes there does not count
        endpoint = self._custody
        if endpoint is None or topic.direction is None:
            return self._handle(Received(topic, header, body), now, what)
        why = endpoint.objection(topic, header, body)
        if why is not None:
            return self.refuse(topic, NotPermitted(why), header.source)
        if topic is endpoint.ack_topic:
            return endpoint.acknowledged(body, header, now)
        deliveries, actions = endpoint.received(topic, header, body, len(payload), now)
        for delivery in deliveries:
            actions += self._handle(Received(delivery.topic, delivery.header, delivery.body), now, what)
        return actions

    def _query(self, topic: Topic, payload: bytes, token: int, now: MissionTime) -> list[Action]:
        """The actions for an incoming query; one that its topic does not admit is answered with a refusal."""
        try:
            _, body = decode(topic, payload, self._mission)
        except Refused as refusal:
            return [*self.refuse(topic, refusal, _named(payload)), ReplyError(token, topic, str(refusal))]
        return self._checked_query(topic, body, token, now)

    def _checked_query(self, topic: Topic, request: Wire, token: int, now: MissionTime) -> list[Action]:
        self._asked[token] = topic
        observed = isinstance(topic.service, Query) and topic.service.observes
        return self._handle(QueryReceived(topic, request, token), now, None if observed else f"asked {topic.name}")

    def _reply(self, query: str, payload: bytes, now: MissionTime) -> list[Action]:
        """The actions for a reply; one that its topic does not admit is refused, one to an ended query is ignored."""
        put = self._queries.pop(query, None)
        if put is None:
            return []
        topic = put.topic
        try:
            _, reply = decode_reply(topic, payload, self._mission)
        except Refused as refusal:
            unanswered = QueryFailed(topic, query, NoReply.REFUSED, str(refusal))
            follows = self._handle(unanswered, now, f"unanswered {topic.name}")
            return [*self.refuse(topic, refusal, _named(payload)), *follows]
        logs = self._event_sink is not None
        what = f"answered {topic.name} {zlib.crc32(payload):08x} {query}" if logs else None
        return self._handle(ReplyReceived(topic, query, reply), now, what)

    def _unanswered(self, query: str, why: NoReply, detail: str, now: MissionTime) -> list[Action]:
        put = self._queries.pop(query, None)
        if put is None:
            return []
        topic = put.topic
        return self._handle(QueryFailed(topic, query, why, detail), now, f"unanswered {topic.name} {why.name} {query}")

    def _timer(self, timer: str, now: MissionTime) -> list[Action]:
        if self._custody is not None and timer == CUSTODY_TIMER:
            return self._custody.timer_elapsed(now)
        return self._handle(TimerFired(timer), now, f"due {timer}")

    def _handle(self, event: Event, now: MissionTime, what: str | None) -> list[Action]:
        """The actions that follow from the event; `what` is its line in the event log, None without one."""
        self._events += 1
        if self._event_sink is not None and what is not None:
            self._event_sink(now, self._interface.name, what)
        actions: list[Action] = []
        try:
            for action in self._actions(self._node.handle(event, now), now):
                actions.append(action)  # noqa: PERF402 - what was done before an exception is kept
        except Exception as error:
            if not (self._contains_defects and isinstance(event, FROM_OUTSIDE)):
                raise
            actions += self._set_aside(error)
            match event:
                case QueryReceived(topic, _, token) if self._asked.pop(token, None) is not None:
                    actions.append(ReplyError(token, topic, DEFECT, RefusalCode.INTERNAL))
                case ReplyReceived(topic, query):
                    actions += self._handle(QueryFailed(topic, query, NoReply.REFUSED, DEFECT), now, None)
        return actions

    def _set_aside(self, error: Exception) -> list[Action]:
        """Set the present input aside. What the node did up to the exception stands."""
        self._defects += 1
        what, payload = _described(self._given)
        frames = traceback.extract_tb(error.__traceback__)
        place = f"{frames[-1].filename}:{frames[-1].lineno}" if frames else ""
        text = printable(f"{type(error).__name__}: {error}")[:MAX_TEXT]
        lines = tuple(line.rstrip() for line in traceback.format_exception(error))
        shown = f"{text} ({place})" if place else text
        return [SetAside(what, payload, shown, lines, self._defects, place)]

    def _report_queue_depth(self, depth: int, now: MissionTime) -> list[Action]:
        """Report a changed queue depth, at most once per input. A replay repeats it, so it is not journalled."""
        if not self._interface.reports_queue_depth or depth == self._reported_depth:
            return []
        self._reported_depth = depth
        return list(self._actions(self._node.handle(QueueDepthChanged(depth), now), now))

    def _actions(self, effects: Iterable[Effect], now: MissionTime) -> Iterable[Action]:
        for effect in effects:
            match effect:
                case SetTimer() | LogRecord():
                    yield effect
                case SendIfHeard(topic, make):
                    side = self._side_of(topic)
                    if self._heard(topic, side):
                        yield Publish(topic, side, self._encoded(topic, self._header(topic, now), make()))
                    else:
                        self._next_sequence(topic)
                case Send(topic, body):
                    header = self._header(topic, now)
                    if self._custody is not None and under_custody(topic):
                        yield from self._custody.offer(topic, header, body, now)
                    else:
                        yield Publish(topic, self._side_of(topic), self._encoded(topic, header, body))
                case Forward(topic, payload, side):
                    yield Publish(topic, side, payload)
                case SendQuery(topic, request, query, timeout_s):
                    payload = self._encoded(topic, self._header(topic, now), request, Part.QUERY)
                    put = PutQuery(topic, self._side_of(topic), payload, query, timeout_s)
                    self._queries[query] = put
                    yield put
                case SendReply(token, reply):
                    asked = self._asked.pop(token, None)
                    if asked is not None:
                        payload = self._encoded(asked, self._header(asked, now), reply, Part.REPLY)
                        yield Reply(token, asked, payload)
                case RefuseQuery(token, why, code):
                    asked = self._asked.pop(token, None)
                    if asked is not None:
                        yield ReplyError(token, asked, why, code)
                case _:
                    yield effect

    def _side_of(self, topic: Topic) -> Side:
        sides = self._interface.sides
        return sides[0] if len(sides) == 1 else topic.sides[0]

    def encode_reply(self, topic: Topic, header: Header, reply: Wire) -> bytes:
        """The reply to a query that a driver answers itself, signed like those of the node."""
        return self._encoded(topic, header, reply, Part.REPLY)

    def _encoded(self, topic: Topic, header: Header, body: Wire, part: Part = Part.MESSAGE) -> bytes:
        if self._gate is None:
            return self._encode(header, body)
        if part is Part.QUERY and topic.signed:
            from services.runtime.trust.signing import REQUEST_VALID_NS  # slow, and only with keys

            header = header.model_copy(update={"expires_at": header.made_at + REQUEST_VALID_NS})
        return self._gate.encode(part, topic, header, body)

    def _header(self, topic: Topic, now: MissionTime) -> Header:
        return Header(
            mission=self._mission,
            source=self._interface.name,
            incarnation=self._incarnation,
            sequence=self._next_sequence(topic),
            made_at=now,
        )

    def _next_sequence(self, topic: Topic) -> int:
        sequence = self._sequences.get(topic.name, 0)
        self._sequences[topic.name] = sequence + 1
        return sequence

    def refuse(self, topic: Topic, why: Refused | InvalidInput, source: str = "", *, count: int = 1) -> list[Action]:
        """Count something from outside that is refused; returns its log record.

        source: the sender that it names. count: messages that the record stands for.
        """
        self._refused += count
        kind = why.kind if isinstance(why, Refused) else Refused.kind
        return [
            LogRecord(
                Level.WARNING,
                f"refused: {why}",
                {"refused": self._refused},
                Cause(f"{topic.name}: {kind}", source),
            )
        ]

"""All nodes and the link in one process, in virtual time, as fast as the CPU allows.

Time jumps from event to event. At each instant there are rounds: in a round every node handles what was sent to it in
the round before, in the order of its scheduler, and what it sends is handled in the next. So the order of the nodes
does not matter, and a mission is the same, event for event, whether its nodes share a process or run in lockstep.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, Final

from he3.errors import He3Error
from schemas.codec import decode_reply, encode
from schemas.link import LinkConditions
from schemas.topics import Side, Topic
from schemas.wire import Header, Wire
from services.mission.mission_time import MissionTime, seconds
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError
from services.runtime.custody.endpoint import custody_config
from services.runtime.host import EventSink, Host
from services.runtime.inputs import MessageArrived, ProcessStarted, QueryArrived, QueryUnanswered, ReplyArrived
from services.runtime.node import Finish, LogRecord, Node, NoReply, PublishSnapshot
from services.runtime.scheduler import Executor, InlineExecutor, Kind, NodeScheduler

if TYPE_CHECKING:
    from services.runtime.drivers.simulated_journal import SimulatedJournal

Tap = Callable[[Topic, Side, bytes, MissionTime], None]
"""Called for each message published, with its topic, its side, its bytes and the mission time."""

OUTSIDE: Final = ""
"""The sender of messages and queries that come from no node."""


class Simulation:
    """The nodes of a mission on their two sides, and virtual time."""

    def __init__(
        self,
        nodes: Iterable[Node],
        mission: str,
        start_ns: MissionTime,
        executor: Executor | None = None,
        event_sink: EventSink | None = None,
        link: LinkConditions | None = None,
        passes_objects: bool = True,
    ) -> None:
        """link: the conditions that the nodes' custody expects of the link; None: the default ones.

        passes_objects: whether a message that was not changed on its way reaches its readers as the objects that it was
        made of, and one without a receiver is not made. False: all are made and parsed, as between processes.
        """
        self._passes_objects = passes_objects
        self._link = link or LinkConditions()
        self._event_sink = event_sink
        self._journals: dict[str, list[SimulatedJournal]] = {}
        self._starts: dict[str, int] = {}
        self._crashing: set[str] = set()
        self.now: MissionTime = start_ns
        self.snapshots: dict[str, object] = {}
        """The latest snapshot of each node."""
        self.log_records: list[tuple[MissionTime, str, LogRecord]] = []
        self.finished: dict[str, Finish] = {}
        """The nodes that have nothing left to do."""
        self.messages = 0
        """Messages published so far."""
        self._mission = mission
        self._executor = executor or InlineExecutor()
        self._schedulers: dict[str, NodeScheduler] = {}
        self._taps: list[tuple[Tap, frozenset[Topic] | None]] = []
        self._receivers: dict[tuple[Topic, Side], list[NodeScheduler]] = {}
        self._order = 0
        self._queries: dict[int, tuple[str, str]] = {}
        self._outside: dict[int, list[bytes | str]] = {}
        self._served_by: dict[int, str] = {}
        for node in nodes:
            self._add_scheduler(NodeScheduler(self._host_of(node, event_sink), self._executor))

    # --- driving ------------------------------------------------------------------------------------------------

    def step(self) -> bool:
        """Advance to the next instant at which something happens, and handle it; False if nothing is left."""
        instant = self._next_instant()
        if instant is None:
            return False
        self._handle(instant)
        return True

    def run(self, until: MissionTime | None = None, stop: Callable[[], bool] = lambda: False) -> None:
        """Step until `stop()` holds, nothing is left, or the next event lies beyond `until` [ns]."""
        while not stop():
            instant = self._next_instant()
            if instant is None or (until is not None and instant > until):
                break
            self._handle(instant)
        if until is not None and not stop():
            self.now = max(self.now, until)

    def run_for(self, duration_s: float) -> None:
        """Step through that many seconds of mission time."""
        self.run(until=self.now + seconds(duration_s))

    def tap(self, tap: Tap, topics: Iterable[Topic] | None = None) -> None:
        """Call `tap` for each message from now on. topics: only for messages of these topics."""
        self._taps.append((tap, None if topics is None else frozenset(topics)))

    # --- faults -------------------------------------------------------------------------------------------------

    def keep_journals(self, names: Iterable[str], identity: dict[str, str]) -> None:
        """Keep journals of those nodes; to be called before the first step."""
        for name in names:
            host = self._schedulers[name].host
            journal = _journal(identity, host)
            self._journals[name] = [journal]
            self._schedulers[name] = NodeScheduler(host, self._executor, journal)
            self._receivers.clear()
            self._schedulers[name].put((Kind.MESSAGE, OUTSIDE, 0), ProcessStarted(1))

    def alive(self, name: str) -> bool:
        """Whether the node's process runs."""
        return name in self._schedulers

    def crash_next(self, name: str) -> None:
        """End the node's process the next time it acts: after it has written its journal, before its actions."""
        if name in self._schedulers:
            self._crashing.add(name)

    def kill(self, name: str) -> None:
        """End the node's process now. Its inputs are lost, and the queries that it serves end without a reply."""
        if self._schedulers.pop(name, None) is None:
            return
        self._receivers.clear()
        self._crashing.discard(name)
        self.finished.pop(name, None)
        for token, server in list(self._served_by.items()):
            if server == name:
                self._end_query(OUTSIDE, token, NoReply.NO_ROUTE)

    def restart(self, node: Node, torn_tail: bytes = b"") -> None:
        """Start the node's process again, from its journals if it keeps any.

        torn_tail: the beginning of a record that its last start did not finish.
        """
        name = node.interface.name
        host = self._host_of(node, self._event_sink)
        journals = self._journals.get(name)
        if journals is None:
            self._add_scheduler(NodeScheduler(host, self._executor))
            return
        journals[-1].tear(torn_tail)
        # A process that ends in the middle of a record may lose the checkpoint as well; then the journals have it all.
        latest = next((n for n in reversed(range(len(journals))) if journals[n].has_checkpoint), None)
        state = None if latest is None or torn_tail else journals[latest].state()
        if latest is None or state is None:
            kept = [entry for journal in journals for entry in journal.entries()]
        else:
            later = [entry for journal in journals[latest + 1 :] for entry in journal.entries()]
            kept = [*journals[latest].entries(since_checkpoint=True), *later]
        journals.append(_journal(journals[-1].identity, host))
        scheduler = NodeScheduler(host, self._executor, journals[-1])
        remaining = scheduler.replay(kept, state)
        self._add_scheduler(scheduler)
        for action in remaining:
            self._perform(scheduler, action)

    def replayed_snapshot(self, node: Node) -> object | None:
        """The snapshot that a new node publishes after its journals alone; this mission is not changed."""
        name = node.interface.name
        host = self._host_of(node, None)
        kept = [entry for journal in self._journals[name] for entry in journal.entries()]
        shown = [
            action.snapshot
            for action in NodeScheduler(host, _Idle()).replay(kept)
            if isinstance(action, PublishSnapshot)
        ]
        return shown[-1] if shown else None

    def _host_of(self, node: Node, event_sink: EventSink | None) -> Host:
        return Host(
            node,
            self._mission,
            event_sink,
            custody_config(self._link, node.interface),
            passes_objects=self._passes_objects,
            heard=self._is_heard,
        )

    def _add_scheduler(self, scheduler: NodeScheduler) -> None:
        starts = self._starts.get(scheduler.name, 0) + 1
        self._starts[scheduler.name] = starts
        self._schedulers[scheduler.name] = scheduler
        self._receivers.clear()
        scheduler.put((Kind.MESSAGE, OUTSIDE, 0), ProcessStarted(starts))

    # --- the outside world --------------------------------------------------------------------------------------

    def inject(self, topic: Topic, side: Side, payload: bytes) -> None:
        """Publish bytes on that side from outside; they are handled at the next step."""
        self._publish(Publish(topic, side, payload), OUTSIDE, self._next_order())

    def ask(self, topic: Topic, request: Wire, source: str = "operator") -> Any:
        """The body of the reply to an operator's query; raises He3Error with the refusal."""
        header = Header(mission=self._mission, source=source, incarnation=0, sequence=0, made_at=self.now)
        answer = self.ask_raw(topic, encode(header, request))
        if isinstance(answer, str):
            raise He3Error(answer)
        return decode_reply(topic, answer, self._mission)[1]

    def ask_raw(self, topic: Topic, payload: bytes) -> bytes | str:
        """The reply to a query in bytes: bytes, or the one line of the refusal."""
        token = self._next_order()
        answers: list[bytes | str] = []
        self._outside[token] = answers
        self._route_query(topic, topic.sides[0], payload, token, OUTSIDE)
        while not answers:
            ready = [each for each in self._schedulers.values() if each.is_due(self.now)]
            if not ready:
                raise He3Error(f"{topic.name}: no reply")
            self._round(ready)
        return answers[0]

    def host(self, name: str) -> Host:
        """The host of that node."""
        return self._schedulers[name].host

    def node(self, name: str) -> Node | None:
        """The node of that name; None while its process does not run."""
        scheduler = self._schedulers.get(name)
        return None if scheduler is None else scheduler.host.node

    # --- inside -------------------------------------------------------------------------------------------------

    def _next_order(self) -> int:
        self._order += 1
        return self._order

    def _next_instant(self) -> MissionTime | None:
        """When something happens next, now or later; None if nothing is left."""
        earliest: MissionTime | None = None
        for scheduler in self._schedulers.values():
            if scheduler.waiting:
                return self.now
            wake = scheduler.next_wake()
            if wake is not None and (earliest is None or wake < earliest):
                earliest = wake
        return None if earliest is None else max(self.now, earliest)

    def _handle(self, instant: MissionTime) -> None:
        """Move time to that instant, and let the nodes handle all that happens then."""
        self.now = instant
        while ready := [each for each in self._schedulers.values() if each.is_due(self.now)]:
            self._round(ready)

    def _round(self, ready: Iterable[NodeScheduler]) -> None:
        """Let these nodes handle the inputs that wait now."""
        for scheduler, actions in [(scheduler, scheduler.run(self.now)) for scheduler in ready]:
            if scheduler.name in self._crashing:
                self.kill(scheduler.name)
                continue
            for action in actions:
                self._perform(scheduler, action)

    def _perform(self, scheduler: NodeScheduler, action: Action) -> None:
        match action:
            case Publish():
                scheduler.emitted += 1
                self._publish(action, scheduler.name, scheduler.emitted)
            case PutQuery(topic, side, payload, query, _):
                token = self._next_order()
                self._queries[token] = (scheduler.name, query)
                self._route_query(topic, side, payload, token, scheduler.name)
            case Reply(token, _, payload):
                self._end_query(scheduler.name, token, payload)
            case ReplyError(token, _, why):
                self._end_query(scheduler.name, token, why)
            case PublishSnapshot(snapshot):
                self.snapshots[scheduler.name] = snapshot
            case LogRecord():
                self.log_records.append((self.now, scheduler.name, action))
            case Finish():
                self.finished[scheduler.name] = action

    def _publish(self, action: Publish, sender: str, emission: int) -> None:
        self.messages += 1
        topic, payload = action.topic, action.payload
        for tap, topics in self._taps:
            if topics is None or topic in topics:
                tap(topic, action.side, payload, self.now)
        receivers = self._receivers_of(topic, action.side)
        if not receivers:
            return
        order, message = (Kind.MESSAGE, sender, emission), MessageArrived(topic, payload)
        for scheduler in receivers:
            if scheduler.name != sender:
                scheduler.put(order, message)

    def _receivers_of(self, topic: Topic, side: Side) -> list[NodeScheduler]:
        """The nodes that receive what is published there, in the order in which they were started."""
        receivers = self._receivers.get((topic, side))
        if receivers is None:
            receivers = [each for each in self._schedulers.values() if each.host.receives(topic, side)]
            self._receivers[topic, side] = receivers
        return receivers

    def _is_heard(self, topic: Topic, side: Side) -> bool:
        return (
            not self._passes_objects
            or any(topics is None or topic in topics for _, topics in self._taps)
            or bool(self._receivers_of(topic, side))
        )

    def _route_query(self, topic: Topic, side: Side, payload: bytes, token: int, sender: str) -> None:
        for scheduler in self._schedulers.values():
            if (topic, side) in scheduler.host.served_topics():
                scheduler.put((Kind.QUERY, sender, token), QueryArrived(topic, payload, token))
                self._served_by[token] = scheduler.name
                return
        self._end_query(OUTSIDE, token, NoReply.NO_ROUTE)

    def _end_query(self, server: str, token: int, answer: bytes | str | NoReply) -> None:
        self._served_by.pop(token, None)
        if token in self._outside:
            self._outside.pop(token).append(answer.value if isinstance(answer, NoReply) else answer)
            return
        name, query = self._queries.pop(token, (OUTSIDE, ""))
        scheduler = self._schedulers.get(name)
        if scheduler is None:
            return  # the node that sent the query is gone, or it was sent to an earlier start of its server
        order = (Kind.REPLY, server, token)
        match answer:
            case bytes():
                scheduler.put(order, ReplyArrived(query, answer))
            case NoReply():
                scheduler.put(order, QueryUnanswered(query, answer, ""))
            case _:
                scheduler.put(order, QueryUnanswered(query, NoReply.REFUSED, answer))


class _Idle:
    """An executor that computes nothing, for a node that is only replayed."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        return Future()


def _journal(identity: dict[str, str], host: Host) -> SimulatedJournal:
    """An empty journal of that host."""
    from services.runtime.drivers.simulated_journal import SimulatedJournal  # slow, and only with journals

    return SimulatedJournal(identity, host.codec)

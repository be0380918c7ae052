"""One node in a process of its own, over Zenoh, on the wall clock: at rate 1 or faster.

The main loop is the only thread that touches the node. Zenoh's callbacks put what came into a queue; operators'
questions about the map are answered by other threads from the latest snapshot, and never wait for the node.
"""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from he3.errors import InvalidInput
from schemas.codec import Refused, decode
from schemas.refusal import Refusal
from schemas.topics import EARTH_CLOCK, MOON_CLOCK, Side, Topic
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError
from services.runtime.clock import FollowedClock
from services.runtime.custody.endpoint import custody_config
from services.runtime.event_log import EventLog
from services.runtime.file_lock import lock_beside
from services.runtime.heartbeat import Heartbeat
from services.runtime.host import Host
from services.runtime.inputs import (
    Input,
    MessageArrived,
    ProcessStarted,
)
from services.runtime.journal import JournalFolder, identity_of
from services.runtime.lockstep.stamp import read_stamp
from services.runtime.log import Log
from services.runtime.node import Finish, LogRecord, MissionTime, Node, PublishSnapshot
from services.runtime.options import Options
from services.runtime.queries.inputs import outcome_input, query_input
from services.runtime.queries.process import QueryProcess
from services.runtime.queries.server import QueryServer, QueryService
from services.runtime.refusals import refusal_of
from services.runtime.scheduler import Executor, InlineExecutor, Kind, NodeScheduler
from services.runtime.transport.session import IncomingQuery, Outcome, Replied, Session, close_all, connect_client

CLOCKS = {Side.MOON: MOON_CLOCK, Side.EARTH: EARTH_CLOCK}
ONLOOKERS = "onlooker"
"""Register of those for whom virtual time never waits."""
IDLE_S = 0.5
"""The longest that the loop sleeps: it looks at the parent and the clock at least as often."""


class OwnedExecutor(Executor, Protocol):
    """An executor with a process of its own to end."""

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Service:
    """What distinguishes one service's process from another's."""

    name: str
    build: Callable[[Options], Node]
    executor: Callable[[], OwnedExecutor] | None = None
    answers: QueryService | None = None
    """Which questions are answered from snapshots, and how."""
    journals: bool = False
    """Whether it goes on from a journal after a restart; who keeps none has nothing to forget."""
    onlooker: bool = False
    """It only listens: virtual time never waits for it."""


class Stop:
    """Set once, by a signal; wakes the loop."""

    def __init__(self) -> None:
        self.event = threading.Event()
        self.inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def __call__(self, *_: Any) -> None:
        self.event.set()
        self.inbox.put(lambda: None)


class Process:
    """A service's process: its sessions, its queue, its clock, its node."""

    def __init__(self, service: Service, options: Options, stop: Stop) -> None:
        self._service = service
        self.options = options
        self.stop = stop
        self.name = service.name
        self.mission = options.scenario.name
        self.clock = FollowedClock()
        self._last: MissionTime = 0
        self.sessions: dict[Side, Session] = {}
        self._tokens: dict[int, IncomingQuery] = {}
        self._resume: list[Action] = []
        self._incarnation = 1
        self._counter = 0
        self.events: EventLog | None = None
        self.log = Log(service.name, self._now_or_none, options.level, options.log_json)
        self._answers = self._answering(service)

    def _answering(self, service: Service) -> QueryServer | QueryProcess | None:
        """Who answers operators, if anybody is to."""
        if service.answers is None:
            return None
        if service.answers.module is None:
            return QueryServer(service.answers, service.name, self.mission, self._now_or_none)
        earth = self.options.scenario.network.earth
        return QueryProcess(service.answers.module, Side.EARTH, earth, self.mission, self.log.warning)

    # --- life ---------------------------------------------------------------------------------------------------

    def run(self) -> int:
        executor: OwnedExecutor | InlineExecutor | None = None
        try:
            executor = self._service.executor() if self._service.executor else InlineExecutor()
            node = self._service.build(self.options)
            self.events = EventLog(self.options.events) if self.options.events else None
            host = Host(node, self.mission, self.events, custody_config(self.options.scenario.link, node.interface))
            self.scheduler = self._seated(host, _Waking(executor, self.stop.inbox))
            if not self._connect(host):
                return 0
            self.heartbeat = Heartbeat(host, self._publish_quietly)
            self._loop()
            return 0
        finally:
            if self.events is not None:
                self.events.close()
            if self._answers is not None:
                self._answers.close()
            close_all(self.sessions.values())
            if executor is not None and not isinstance(executor, InlineExecutor):
                executor.close()

    def _seated(self, host: Host, executor: Executor) -> NodeScheduler:
        """The seat of that host, where its journal says that it was."""
        if self.options.journal is not None:
            expected = f"--journal {self.options.journal}: expected a folder that no other {self.name} uses"
            self._journal_lock = lock_beside(self.options.journal / self.name, expected)  # until this process ends
        if self.options.journal is None or not self._service.journals:
            # Without a journal a start must still differ from an earlier one: the other side remembers what it had.
            self._incarnation = 1 if self.options.lockstep else int(time.time())
            return NodeScheduler(host, executor)
        folder = JournalFolder(self.options.journal, self.name, identity_of(self.options.scenario), host.codec)
        history = folder.history()
        if history.notice:
            self.log.warning(history.notice)
        scheduler = NodeScheduler(host, executor, folder.begin(history))
        began = time.monotonic()
        self._resume = scheduler.replay(history.inputs, history.state)
        self._incarnation = history.starts + 1
        if history.starts:
            self._last = scheduler.last
            self.log.info(
                "restarted from its journal",
                inputs=len(history.inputs),
                torn_bytes=history.torn_bytes,
                seconds=f"{time.monotonic() - began:.3f}",
            )
        return scheduler

    def _connect(self, host: Host) -> bool:
        """Join both networks the node stands on, and learn the time; False when told to stop first."""
        endpoints = {Side.MOON: self.options.scenario.network.moon, Side.EARTH: self.options.scenario.network.earth}
        interface = host.interface
        for side in interface.sides:
            session = self.open(side, endpoints[side])
            if session is None:
                return False
            self.sessions[side] = session
            self._listen(host, side, session)
        if not self.learn_time():
            return False
        if isinstance(self._answers, QueryProcess) and not self._resume:
            # Nobody waits for a process that goes on; for a new one the mission waits, and so may operators.
            self._answers.wait_until_ready(self.stop.event)
        for side, session in self.sessions.items():
            session.declare_alive(interface.name, side)
            if self._service.onlooker:
                session.declare_alive(interface.name, side, ONLOOKERS)
        self.log.info("ready", sides="+".join(side.value for side in interface.sides), pid=os.getpid())
        return True

    def _listen(self, host: Host, side: Side, session: Session) -> None:
        for topic, where in host.received_topics():
            if where is side:
                session.subscribe(self.heard_as(topic), partial(self._came, topic))
        for topic in host.interface.serves:
            if side in topic.sides:
                if self._answers is not None and self._service.answers and topic in self._service.answers.topics:
                    if isinstance(self._answers, QueryServer):
                        self._answers.serve(topic, session)
                else:
                    session.serve(topic, partial(self._asked, topic))

    def heard_as(self, topic: Topic) -> Topic:
        """On which topic's key that topic's messages reach this process."""
        return topic

    def open(self, side: Side, endpoint: str) -> Session | None:
        """A bus on that side, as soon as its router is there; None when told to stop first."""
        return connect_client(side, endpoint, self.mission, self.stop.event, self.log.warning)

    def learn_time(self) -> bool:
        """Ask the time keeper until it answers; a subscription brings every later change. False when told to stop."""
        side, session = next(iter(self.sessions.items()))
        topic = CLOCKS[side]
        session.subscribe(topic, lambda payload, _attachment: self.later(partial(self.set_clock, side, payload)))
        told = False
        while self.clock.state is None and not self.stop.event.is_set():
            session.query(topic, b"", 2.0, lambda outcome: self.later(partial(self._clock_replied, side, outcome)))
            try:
                self.stop.inbox.get(timeout=IDLE_S)()
            except queue.Empty:
                if not told:
                    self.log.warning(f"no time keeper answers on {topic.key(self.mission)}; still trying")
                    told = True
        return not self.stop.event.is_set()

    # --- the loop -----------------------------------------------------------------------------------------------

    def _loop(self) -> None:
        now = self._now()
        self.scheduler.put((Kind.MESSAGE, "", 0), ProcessStarted(self._incarnation))
        self.perform_all(self._resume)
        self._run_seat(now)
        while not self.stop.event.is_set():
            self._run_due()
            with contextlib.suppress(queue.Empty):
                self.stop.inbox.get(timeout=self._patience_s())()
            self._drain()
            self.beat(time.monotonic())

    def beat(self, monotonic_s: float) -> None:
        """Do what is due now and then, whatever the mission does: called at least every `IDLE_S`."""
        self.heartbeat.beat(monotonic_s, self._last)

    def _drain(self) -> None:
        """Take in everything that waits, timers first: what is due is handled at the time it was due."""
        while not self.stop.event.is_set():
            if self.scheduler.waiting:
                self._run_seat(self._now())
            try:
                take_in = self.stop.inbox.get_nowait()
            except queue.Empty:
                return
            self._run_due()
            take_in()

    def _run_due(self) -> None:
        while not self.stop.event.is_set():
            wake = self.scheduler.next_wake(wait=False)
            if wake is None or wake > self._now():
                return
            self._run_seat(max(wake, self._last))

    def _run_seat(self, now: MissionTime) -> None:
        self._last = max(self._last, now)
        self.perform_all(self.scheduler.run(self._last, wait=False))

    def perform_all(self, actions: Iterable[Action]) -> None:
        for action in actions:
            self._perform(action)

    def _patience_s(self) -> float:
        wake = self.scheduler.next_wake(wait=False)
        if wake is None or self.clock.state is None:
            return IDLE_S
        wait_s = self.clock.seconds_until(wake)
        return IDLE_S if wait_s is None else min(IDLE_S, wait_s)

    def _perform(self, action: Action) -> None:
        match action:
            case Publish(topic, side, payload):
                self.sessions[side].publish(topic, payload)
            case PutQuery(topic, side, payload, query, timeout_s):
                on_end = partial(self._answer_came, query)
                self.sessions[side].query(topic, payload, timeout_s, on_end)
            case Reply(token, _, payload):
                self._question_of(token, lambda query: query.reply(payload))
            case ReplyError(token, _, why, code):
                self._question_of(token, lambda query: query.refuse(Refusal(why, code)))
            case PublishSnapshot(snapshot, awaited):
                if self._answers is not None:
                    self._answers.show(snapshot)
                if awaited and isinstance(self._answers, QueryProcess):
                    self._answers.settle()
            case LogRecord():
                self.log.write(action, self._last)
            case Finish(ok, why):
                self.log.info(f"finished: {why}", ok=ok)

    def _question_of(self, token: int, answer: Callable[[IncomingQuery], None]) -> None:
        query = self._tokens.pop(token, None)
        if query is not None:  # else it was asked of an earlier start of this process, and its asker is gone
            answer(query)

    # --- what comes in, in other threads ------------------------------------------------------------------------

    def later(self, take_in: Callable[[], None]) -> None:
        self.stop.inbox.put(take_in)

    def _came(self, topic: Topic, payload: bytes, attachment: bytes) -> None:
        self.later(partial(self._take_message, MessageArrived(topic, payload), attachment))

    def _take_message(self, given: Input, attachment: bytes) -> None:
        stamp = read_stamp(attachment)
        if stamp is not None:  # an onlooker's time in lockstep is that of what it sees
            self._last = max(self._last, stamp.at)
        self._put(Kind.MESSAGE, given)

    def _asked(self, topic: Topic, query: IncomingQuery) -> None:
        self.later(partial(self._take_question, topic, query))

    def _answer_came(self, query: str, outcome: Outcome) -> None:
        self.later(partial(self._put, Kind.QUERY, outcome_input(query, outcome)))

    # --- taking it in, in the loop ------------------------------------------------------------------------------

    def _put(self, kind: Kind, given: Input) -> None:
        self._counter += 1
        self.scheduler.put((kind, "", self._counter), given)

    def _take_question(self, topic: Topic, query: IncomingQuery) -> None:
        self._counter += 1
        token = self._counter
        self._tokens[token] = query
        try:
            self._put(Kind.QUERY, query_input(topic, query, token))
        except InvalidInput as error:
            self._tokens.pop(token).refuse(refusal_of(error))
            self.refused(str(error))

    def _clock_replied(self, side: Side, outcome: Outcome) -> None:
        if isinstance(outcome, Replied):
            self.set_clock(side, outcome.payload)

    def set_clock(self, side: Side, payload: bytes) -> None:
        try:
            _, state = decode(CLOCKS[side], payload, self.mission)
        except Refused as refusal:
            self.refused(str(refusal))
            return
        self.clock.follow(state)

    def refused(self, why: str) -> None:
        """Count and log something from outside that never reached the node."""
        self.log.write(self.scheduler.host.refuse(why))

    # --- time ---------------------------------------------------------------------------------------------------

    def _now(self) -> MissionTime:
        """Mission time; it never runs backwards."""
        return max(self._last, self.clock.now())

    def _now_or_none(self) -> MissionTime | None:
        return None if self.clock.state is None else self._now()

    def _publish_quietly(self, topic: Topic, side: Side, payload: bytes) -> None:
        self.sessions[side].publish(topic, payload)


class _Waking:
    """An executor that wakes the loop when a computation ends."""

    def __init__(self, executor: Executor, inbox: queue.SimpleQueue[Callable[[], None]]) -> None:
        self._executor = executor
        self._inbox = inbox

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        future = self._executor.submit(function, *arguments)
        future.add_done_callback(lambda _: self._inbox.put(lambda: None))
        return future

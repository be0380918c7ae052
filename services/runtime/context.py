"""The context of a driver in a service's process: the node's scheduler, the sessions, the clock, the log.

`services.runtime.process` makes it and hands it to a driver. A driver decides when the node acts; what all drivers have
in common is here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from schemas.codec import TooMany, body_of
from services.runtime.actions import SetAside
from services.runtime.backlog import Backlog
from services.runtime.kept_file import KeptFile
from services.runtime.log_limit import LogLimit
from services.runtime.node import Cause, Finish, Keep, Level, LogRecord, PublishSnapshot
from services.runtime.service_manager import ServiceManager
from services.runtime.set_aside import SetAsideFile

if TYPE_CHECKING:
    from collections.abc import Iterable

    from he3.errors import InvalidInput
    from schemas.codec import Refused
    from schemas.refusal import Refusal
    from schemas.topics import Side, Topic
    from schemas.wire import Header, Wire
    from services.runtime.actions import Action
    from services.runtime.event_log import EventLog
    from services.runtime.heartbeat import Heartbeat
    from services.runtime.inbox import Inbox
    from services.runtime.log import Log
    from services.runtime.options import Options
    from services.runtime.process_clock import ProcessClock
    from services.runtime.queries.process import QueryProcess
    from services.runtime.role_claim import ClaimedRole
    from services.runtime.scheduler import NodeScheduler
    from services.runtime.transport.session import IncomingQuery, Session

IDLE_S = 0.5
"""Longest sleep of a main loop [s of wall time]."""


class Traffic(Protocol):
    """Receives messages and queries for a driver. Called in Zenoh's threads: it may only enqueue them."""

    def received_as(self, topic: Topic) -> Topic:
        """The topic on whose key that topic's messages reach this process."""

    def on_message(self, topic: Topic, payload: bytes, attachment: bytes) -> None: ...

    def on_query(self, topic: Topic, query: IncomingQuery) -> None: ...


class Driver(Protocol):
    """Decides when the node of a process acts."""

    @property
    def traffic(self) -> Traffic: ...

    def begin(self) -> bool:
        """Learn or set mission time; the sessions are open. False if the process was stopped first."""

    def run(self) -> None:
        """Let the node act until the process is told to stop."""


class OpenQueries:
    """The queries that the node has not answered yet, by token."""

    def __init__(self) -> None:
        self._queries: dict[int, IncomingQuery] = {}
        self._tokens = 0

    def next_token(self) -> int:
        self._tokens += 1
        return self._tokens

    def add(self, token: int, query: IncomingQuery) -> None:
        self._queries[token] = query

    def reply(self, token: int, payload: bytes, attachment: bytes | None = None) -> None:
        """Reply to that query with a message, or with its body if the query carried none.

        Nothing is done for a token of an earlier start of this process, whose client is gone.
        """
        query = self._queries.pop(token, None)
        if query is not None:
            query.reply(body_of(payload) if query.payload is None else payload, attachment)

    def refuse(self, token: int, refusal: Refusal) -> None:
        """Refuse that query; nothing for a token of an earlier start of this process."""
        query = self._queries.pop(token, None)
        if query is not None:
            query.refuse(refusal)


@dataclass(slots=True)
class ProcessContext:
    """The parts of one service's process."""

    options: Options
    inbox: Inbox
    sessions: dict[Side, Session]
    clock: ProcessClock
    log: Log
    scheduler: NodeScheduler
    heartbeat: Heartbeat
    events: EventLog | None
    query_process: QueryProcess | None
    incarnation: int = 1
    """Which start of the process this is."""
    resume: list[Action] = field(default_factory=list)
    """Actions that the replay of the journal left to do."""
    open_queries: OpenQueries = field(default_factory=OpenQueries)
    set_aside: SetAsideFile = field(default_factory=lambda: SetAsideFile(None))
    kept: KeptFile = field(default_factory=lambda: KeptFile(None, lambda _: None))
    """What the node keeps for the next start of the process."""
    manager: ServiceManager = field(default_factory=ServiceManager)
    """The service manager that started this process, if one did."""
    backlog: Backlog = field(default_factory=Backlog)
    """Bounds what waits in the inbox, by topic."""
    log_limit: LogLimit = field(default_factory=LogLimit)
    """Bounds the log lines that others cause."""
    role: ClaimedRole | None = None
    """The claim of this process; None for the link, which judges the claims."""

    @property
    def name(self) -> str:
        return self.scheduler.name

    @property
    def mission(self) -> str:
        return self.options.scenario.name

    def beat(self, monotonic_s: float) -> None:
        """Publish a heartbeat if it is due, and tell the service manager and the link that the main loop turns."""
        self.manager.alive()
        self.kept.tend(monotonic_s)
        if self.role is not None:
            self.role.keep(monotonic_s)
        self.heartbeat.beat(monotonic_s, self.clock.latest)
        for topic, count in self.backlog.turned_away():
            why = f"{topic.name}: {count} more messages than this process has room for; it cannot keep up"
            self.refused(topic, TooMany(why), count=count)
        self._write(self.log_limit.due(monotonic_s))

    def perform(self, action: Action) -> None:
        """Carry out an action that concerns no other process of the mission: snapshot, kept value, log line, end."""
        match action:
            case PublishSnapshot(snapshot, awaited):
                if self.query_process is not None:
                    self.query_process.show(snapshot)
                    if awaited:
                        self.query_process.settle()
            case Keep(value):
                self.kept.replace(value, time.monotonic())
            case LogRecord():
                self._write(self.log_limit.admit(action, time.monotonic()))
            case SetAside():
                self._report_defect(action)
            case Finish(ok, why):
                self.log.info(f"finished: {why}", ok=ok)

    def _report_defect(self, action: SetAside) -> None:
        fields = {"defects": action.number, "traceback": " | ".join(action.traceback)}
        text = f"set aside, a defect: {action.what}: {action.error}"
        record = LogRecord(Level.ERROR, text, fields, Cause("set aside", action.place))
        lines = self.log_limit.admit(record, time.monotonic())
        if record in lines and self.set_aside.keep(action, self.clock.latest):
            fields["kept_in"] = str(self.set_aside.path)
        self._write(lines)

    def encode_reply(self, topic: Topic, query: IncomingQuery, header: Header, reply: Wire) -> bytes:
        """The reply to a query that the driver answers itself: a message for a message, else the plain body."""
        payload = self.scheduler.host.encode_reply(topic, header, reply)
        return body_of(payload) if query.payload is None else payload

    def refused(self, topic: Topic, why: Refused | InvalidInput, count: int = 1) -> None:
        """Count and log something from outside that never reached the node. count: messages that it stands for."""
        for record in self.scheduler.host.refuse(topic, why, count=count):
            self.perform(record)

    def close_log(self) -> None:
        """Write the count of the lines that the log has not shown yet."""
        self._write(self.log_limit.rest())

    def _write(self, lines: Iterable[LogRecord]) -> None:
        for line in lines:
            self.log.write(line, self.clock.latest)

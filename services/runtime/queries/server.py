"""Operators' queries answered from an immutable snapshot, in threads of their own, never by the node.

The thread that has a new snapshot calls `QueryServer.show` and continues; queries that are being answered finish with
the snapshot that they began with. How a query is read is in `services.runtime.transport.request`.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from he3.errors import Busy, He3Error, NotReady
from schemas.wire import Header, Wire
from services.runtime.refusals import refusal_of
from services.runtime.transport.request import Query, encode_reply, read_request
from services.runtime.transport.session import JSON, IncomingQuery, Session

if TYPE_CHECKING:
    from schemas.topics import Topic
    from services.mission.mission_time import MissionTime

_Waiting: TypeAlias = "queue.Queue[tuple[Topic, IncomingQuery]]"

MAX_WAITING = 10_000
"""Queries that may wait, quick ones and slow ones; more are refused, so that a flood costs no memory."""


@dataclass(frozen=True, slots=True)
class Encoded:
    """A reply in another format than JSON; its attachment describes it in JSON."""

    payload: bytes
    media_type: str
    about: bytes


def _no_rendering(_topic: Topic, _request: Any, _snapshot: Any) -> Encoded | None:
    return None


class Snapshot(Protocol):
    """The data from which queries are answered; immutable."""

    @property
    def mission_time_ns(self) -> MissionTime:
        """Mission time at which the snapshot was made."""


def _newest(snapshot: Snapshot, _before: Snapshot | None) -> Snapshot:
    return snapshot


@dataclass(frozen=True, slots=True)
class QueryService:
    """Which queries are answered from snapshots, and how: pure functions of request and snapshot."""

    topics: tuple[Topic, ...]
    answer: Callable[[Topic, Any, Any], Wire]
    """(topic, request, snapshot) -> reply; raises He3Error with one line."""
    render: Callable[[Topic, Any, Any], Encoded | None] = _no_rendering
    """(topic, request, snapshot) -> the reply if it is not JSON, else None; raises He3Error."""
    keep: Callable[[Any, Any | None], Snapshot] = _newest
    """(new snapshot, kept state) -> the new kept state, from which queries are answered from now on."""
    threads: int = 2
    slow: tuple[Topic, ...] = ()
    """Queries whose answers take seconds: a thread of their own answers one after the other, so no other waits."""


class QueryServer:
    """The threads that answer a service's queries; they end with the process."""

    def __init__(self, service: QueryService, name: str, mission: str) -> None:
        self._service = service
        self._name = name
        self._mission = mission
        self._snapshot: Snapshot | None = None
        self._waiting: _Waiting = queue.Queue(MAX_WAITING)
        self._slow: _Waiting = queue.Queue(MAX_WAITING)
        lanes = [(f"queries-{number}", self._waiting) for number in range(service.threads)]
        for name, waiting in [*lanes, ("slow-queries", self._slow)] if service.slow else lanes:
            threading.Thread(target=self._work, args=(waiting,), name=name, daemon=True).start()

    def show(self, snapshot: Snapshot) -> Snapshot:
        """Answer from that snapshot from now on; returns the kept snapshots."""
        kept = self._service.keep(snapshot, self._snapshot)
        self._snapshot = kept
        return kept

    def serve(self, topic: Topic, session: Session) -> None:
        """Answer that topic's queries on that session from now on."""
        session.serve(topic, partial(self._enqueue, topic))

    def _enqueue(self, topic: Topic, query: IncomingQuery) -> None:
        waiting = self._slow if topic in self._service.slow else self._waiting
        try:
            waiting.put_nowait((topic, query))
        except queue.Full:
            query.refuse(refusal_of(Busy(f"more than {MAX_WAITING} queries wait; ask again later")))

    def _work(self, waiting: _Waiting) -> None:
        while True:
            topic, query = waiting.get()
            try:
                reply = self.reply(topic, query)
                query.reply(reply.payload, reply.about or None, reply.media_type)
            except He3Error as error:
                query.refuse(refusal_of(error))
            except Exception as error:  # noqa: BLE001 - a defect must not cost the thread; the client is told
                query.refuse(refusal_of(He3Error(f"{topic.name}: defect: {type(error).__name__}: {error}")))

    def reply(self, topic: Topic, query: Query) -> Encoded:
        """The reply to that query; raises He3Error with one line."""
        request = read_request(topic, query, self._mission)
        snapshot = self._snapshot
        if snapshot is None:
            raise NotReady("there is no map yet; ask again in a moment")
        rendered = self._service.render(topic, request, snapshot)
        if rendered is not None:
            return rendered
        reply = self._service.answer(topic, request, snapshot)
        made_at = snapshot.mission_time_ns
        header = Header(mission=self._mission, source=self._name, incarnation=0, sequence=0, made_at=made_at)
        return Encoded(encode_reply(query, header, reply), JSON, b"")

"""Operators' questions: made from selector parameters where a stock client asks, answered from snapshots in threads.

A question that carries a message is answered with a message; one that carries only parameters (``?x=120;y=340``) is
answered with the plain body, as somebody who knows nothing of our envelopes would like it.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from pydantic import ValidationError

from he3.errors import He3Error, InvalidInput
from schemas.codec import Refused, decode, encode, one_line
from schemas.topics import Topic
from schemas.wire import Header, Wire
from services.runtime.node import MissionTime
from services.runtime.transport.session import IncomingQuery, Session

JSON = "application/json"
MAX_WAITING = 10_000
"""Questions that may wait; more are refused, so that a flood costs no memory."""


def request_from_selector(topic: Topic, parameters: dict[str, str]) -> Any:
    """The request that selector parameters make; raises InvalidInput with one line for unknown or bad ones."""
    try:
        # Parameters are text: numbers are read from them, everything else is checked as on the wire.
        return topic.payload.model_validate_strings(parameters)
    except ValidationError as error:
        raise InvalidInput(f"{topic.name}: {one_line(error)}") from None


@dataclass(frozen=True, slots=True)
class Encoded:
    """An answer in a format of its own, with what it shows (JSON) as its attachment."""

    payload: bytes
    media_type: str
    about: bytes


def _nothing_else(_topic: Topic, _request: Any, _snapshot: Any) -> Encoded | None:
    return None


def _as_it_is(shown: Any, _before: Any) -> Any:
    return shown


@dataclass(frozen=True, slots=True)
class QueryService:
    """Answers questions of some topics from the latest snapshot: a pure function, in threads of its own."""

    topics: tuple[Topic, ...]
    answer: Callable[[Topic, Any, Any], Wire]
    """(topic, request, snapshot) -> reply; raises He3Error with one line."""
    render: Callable[[Topic, Any, Any], Encoded | None] = _nothing_else
    """(topic, request, snapshot) -> the answer where it is not to be JSON, else None; raises He3Error."""
    keep: Callable[[Any, Any | None], Any] = _as_it_is
    """(what is shown, what was answered from before) -> what is answered from now on."""
    threads: int = 2
    module: str | None = None
    """Module to run as the query process (see `services.runtime.queries.process`); None: threads of this process."""


class QueryServer:
    """The threads of a snapshot service, for one process."""

    def __init__(
        self,
        service: QueryService,
        name: str,
        mission: str,
        now: Callable[[], MissionTime | None] = lambda: None,
    ) -> None:
        self._service = service
        self._name = name
        self._mission = mission
        self._snapshot: object | None = None
        self._now = now
        self._waiting: queue.Queue[tuple[Topic, IncomingQuery]] = queue.Queue(MAX_WAITING)
        for number in range(service.threads):
            threading.Thread(target=self._work, name=f"questions-{number}", daemon=True).start()

    def show(self, snapshot: object) -> object:
        """Answer from that snapshot from now on; returns what is kept of it and of those before."""
        self._snapshot = self._service.keep(snapshot, self._snapshot)
        return self._snapshot

    def close(self) -> None:
        """Nothing to end: the threads end with the process."""

    def serve(self, topic: Topic, session: Session) -> None:
        """Answer that topic's questions on that bus from now on."""
        session.serve(topic, partial(self._take, topic))

    def _take(self, topic: Topic, query: IncomingQuery) -> None:
        try:
            self._waiting.put_nowait((topic, query))
        except queue.Full:
            query.refuse(f"{topic.name}: more than {MAX_WAITING} questions wait; ask later")

    def _work(self) -> None:
        while True:
            topic, query = self._waiting.get()
            try:
                answer = self.reply(topic, query.payload, query.parameters)
                query.reply(answer.payload, answer.about or None, answer.media_type)
            except (He3Error, Refused) as error:
                query.refuse(str(error))

    def reply(self, topic: Topic, payload: bytes | None, parameters: dict[str, str]) -> Encoded:
        """The answer; raises He3Error or Refused with one line."""
        if payload is None:
            request = request_from_selector(topic, parameters)
        else:
            _, request = decode(topic, payload, self._mission)
        snapshot = self._snapshot
        if snapshot is None:
            raise InvalidInput(f"{topic.name}: there is no map yet; ask again in a moment")
        rendered = self._service.render(topic, request, snapshot)
        if rendered is not None:
            return rendered
        reply = self._service.answer(topic, request, snapshot)
        if payload is None:
            return Encoded(reply.model_dump_json().encode(), JSON, b"")
        now = self._now()
        made_at: MissionTime = getattr(snapshot, "mission_time_ns", 0) if now is None else now
        header = Header(mission=self._mission, source=self._name, incarnation=0, sequence=0, made_at=made_at)
        return Encoded(encode(header, reply), JSON, b"")

"""A Zenoh session on one side of a mission: publish, subscribe, query, serve, liveliness.

Zenoh's callbacks run in its own threads. They only pass on what arrived; nothing may block inside one. A session that
loses its router reconnects by itself.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import zenoh

from schemas.refusal import Refusal, RefusalCode, decode_refusal
from schemas.topics import ALIVE, Side, Topic, liveliness_key
from services.runtime.node import NoReply

CLOSE_WITHIN_S = 1.0
"""Longest wait for a session to close; on a bad link Zenoh itself takes up to 10 s."""

JSON = "application/json"

OnPayload = Callable[[bytes, bytes], None]
"""Called with payload and attachment (empty when there is none)."""

Counts = Callable[[bytes], bool]
"""Whether a reply counts, which one without the right signature does not. Called in Zenoh's threads."""


@dataclass(frozen=True, slots=True)
class Replied:
    """A query ended with a reply."""

    payload: bytes
    attachment: bytes = b""


@dataclass(frozen=True, slots=True)
class NotReplied:
    """A query ended without a reply."""

    why: NoReply
    detail: str = ""
    """Text of the refusal, or the time waited."""
    code: RefusalCode = RefusalCode.INTERNAL
    """Code of the refusal, if the query was refused."""
    attachment: bytes = b""


Outcome = Replied | NotReplied


@dataclass(frozen=True, slots=True)
class IncomingQuery:
    """A query that arrived. Reply, refuse or drop it exactly once, from any thread."""

    query: zenoh.Query

    @property
    def payload(self) -> bytes | None:
        payload = self.query.payload
        return None if payload is None else payload.to_bytes()

    @property
    def attachment(self) -> bytes:
        return _attachment(self.query)

    @property
    def parameters(self) -> dict[str, str]:
        """The selector's parameters: the part after its '?'."""
        parameters: Any = self.query.parameters
        return dict(parameters)

    def reply(self, payload: bytes, attachment: bytes | None = None, media_type: str = JSON) -> None:
        encoding = zenoh.Encoding(media_type)
        self.query.reply(self.query.key_expr, payload, encoding=encoding, attachment=attachment)
        self.drop()

    def refuse(self, refusal: Refusal) -> None:
        self.query.reply_err(refusal.encode(), encoding=zenoh.Encoding.APPLICATION_JSON)
        self.drop()

    def drop(self) -> None:
        """End the query; without an earlier reply it ends without one."""
        self.query.drop()  # type: ignore[no-untyped-call]


class Session:
    """A session on one side of a mission."""

    def __init__(self, session: zenoh.Session, mission: str) -> None:
        self._session = session
        self._mission = mission
        self._declared: list[Any] = []  # Zenoh undeclares what is garbage-collected
        self._kept: dict[Topic, bytes] = {}
        self._publishers: dict[Topic, zenoh.Publisher] = {}

    # --- publish and subscribe ----------------------------------------------------------------------------------

    def publish(self, topic: Topic, payload: bytes, attachment: bytes | None = None, media_type: str = JSON) -> None:
        """Publish to every subscriber; blocks while a slow subscriber's queue is full."""
        self._session.put(
            topic.key(self._mission),
            payload,
            encoding=zenoh.Encoding(media_type),
            congestion_control=zenoh.CongestionControl.BLOCK,
            attachment=attachment,
        )
        self._keep(topic, payload)

    def publish_best_effort(
        self, topic: Topic, payload: bytes, attachment: bytes | None = None, media_type: str = JSON
    ) -> None:
        """Publish without blocking; a subscriber whose queue is full misses the message."""
        self._publisher(topic).put(payload, encoding=zenoh.Encoding(media_type), attachment=attachment)
        self._keep(topic, payload)

    def _keep(self, topic: Topic, payload: bytes) -> None:
        if topic.kept:
            first = topic not in self._kept
            self._kept[topic] = payload
            if first:
                self.serve(topic, lambda query: query.reply(self._kept[topic]))

    def has_subscribers(self, topic: Topic) -> bool:
        """Whether a subscriber to that topic is known."""
        status: Any = self._publisher(topic).matching_status
        return bool(status.matching)

    def _publisher(self, topic: Topic) -> zenoh.Publisher:
        publisher = self._publishers.get(topic)
        if publisher is None:
            # A priority of its own: a client that does not take its replies blocks the queue of the default priority.
            publisher = self._session.declare_publisher(
                topic.key(self._mission),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.DATA_HIGH,
            )
            self._publishers[topic] = publisher
        return publisher

    def subscribe(self, topic: Topic, on_payload: OnPayload) -> Callable[[], None]:
        """Call `on_payload` with each message from now on; returns the function that ends the subscription."""

        def hand_over(sample: zenoh.Sample) -> None:
            if _is_put(sample):
                on_payload(sample.payload.to_bytes(), _attachment(sample))

        subscriber: Any = self._session.declare_subscriber(topic.key(self._mission), hand_over)
        self._declared.append(subscriber)

        def end() -> None:
            self._declared.remove(subscriber)
            subscriber.undeclare()

        return end

    # --- queries ------------------------------------------------------------------------------------------------

    def serve(self, topic: Topic, on_query: Callable[[IncomingQuery], None]) -> None:
        """Call `on_query` with each query of that topic from now on."""
        key = topic.key(self._mission)
        self._declared.append(self._session.declare_queryable(key, lambda query: on_query(IncomingQuery(query))))

    def query(
        self,
        topic: Topic,
        payload: bytes | None,
        timeout_s: float,
        on_end: Callable[[Outcome], None],
        attachment: bytes | None = None,
        parameters: str = "",
        counts: Counts | None = None,
    ) -> None:
        """Send a query; `on_end` is called exactly once.

        parameters: the selector's, for a query that carries no message. counts: every server is asked then, and a reply
        that does not count, or a refusal, which has no signature, is the outcome only if no reply follows that counts.
        """
        ended: list[bool] = []
        doubtful: list[Outcome] = []

        def end(outcome: Outcome) -> None:
            if not ended:  # the first reply counts; a second server may take long to say that it has none
                ended.append(True)
                on_end(outcome)

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                replied = Replied(reply.ok.payload.to_bytes(), _attachment(reply.ok))
                if counts is None or counts(replied.payload):
                    end(replied)
                else:
                    doubtful.append(replied)
                return
            error = reply.err.payload.to_bytes() if reply.err is not None else b""
            if error == b"Timeout":
                end(doubtful[0] if doubtful else NotReplied(NoReply.TIMEOUT, f"within {timeout_s:g} s"))
                return
            refusal = decode_refusal(error)
            stamp = b"" if refusal.stamp is None else refusal.stamp.encode()
            refused = NotReplied(NoReply.REFUSED, refusal.error, refusal.code, stamp)
            if counts is None:
                end(refused)
            else:
                doubtful.append(refused)

        def on_all() -> None:
            end(doubtful[0] if doubtful else NotReplied(NoReply.NO_ROUTE))

        self._session.get(
            topic.key(self._mission) + (f"?{parameters}" if parameters else ""),
            handler=zenoh.handlers.Callback(on_reply, on_all),
            # By default a server that claims to have all answers is asked alone, and of two replies one is dropped.
            target=None if counts is None else zenoh.QueryTarget.ALL,
            consolidation=None if counts is None else zenoh.ConsolidationMode.NONE,
            payload=payload,
            encoding=None if payload is None else zenoh.Encoding.APPLICATION_JSON,
            timeout=timeout_s,
            attachment=attachment,
        )

    # --- liveliness ---------------------------------------------------------------------------------------------

    def declare_alive(self, name: str, side: Side, group: str = ALIVE) -> Callable[[], None]:
        """Declare a liveliness token under that name and group, for as long as this session lives.

        Returns the function that ends it before.
        """
        token: Any = self._session.liveliness().declare_token(liveliness_key(self._mission, side, name, group))
        self._declared.append(token)

        def end() -> None:
            if token in self._declared:
                self._declared.remove(token)
                token.undeclare()

        return end

    def watch_alive(self, side: Side, on_change: Callable[[str, bool], None], group: str = ALIVE) -> None:
        """Call `on_change(name, alive)` for each process of that group that is alive, appears, or disappears."""

        def hand_over(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr).rsplit("/", 1)[-1]
            on_change(name, _is_put(sample))

        key = liveliness_key(self._mission, side, "*", group)
        self._declared.append(self._session.liveliness().declare_subscriber(key, hand_over, history=True))

    # --- the end ------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Close the session; returns within `CLOSE_WITHIN_S`, even when the transport hangs."""
        close_all([self])

    def start_closing(self) -> threading.Thread:
        """The thread in which the session closes."""
        closing = threading.Thread(target=self._close, name="zenoh-close", daemon=True)
        closing.start()
        return closing

    def _close(self) -> None:
        try:
            self._session.close()  # type: ignore[no-untyped-call]
        except zenoh.ZError:
            return  # the transport is gone, and the session with it


def close_all(sessions: Iterable[Session]) -> None:
    """Close these sessions at the same time; returns within `CLOSE_WITHIN_S`, even when a transport hangs."""
    give_up = time.monotonic() + CLOSE_WITHIN_S
    for thread in [session.start_closing() for session in sessions]:
        thread.join(max(0.0, give_up - time.monotonic()))


def _is_put(sample: Any) -> bool:
    return bool(sample.kind == zenoh.SampleKind.PUT)


def _attachment(carrier: Any) -> bytes:
    attachment = carrier.attachment
    return b"" if attachment is None else bytes(attachment.to_bytes())

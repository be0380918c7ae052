"""Zenoh, and nothing else: the only place, beside the link's two routers, where sessions are opened.

Callbacks only hand over; nothing in here waits inside one. A session that loses its router finds it again by itself.
"""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import zenoh

from he3.errors import He3Error, InvalidInput, PeerUnreachable
from schemas.topics import KEY_ROOT, Side, Topic
from schemas.wire import Header, Wire, decode, decode_reply, encode
from services.mission.deployment import deployment
from services.runtime.node import MissionTime, NoReply

CLOSE_WITHIN_S = 1.0
"""Closing a session on a bad link can take 10 s; nobody waits longer than this for it."""

ALIVE = "alive"
"""Register of all processes."""

OnPayload = Callable[[bytes, bytes], None]
"""Called with payload and attachment (empty when there is none)."""


def session_config(side: Side, role: str, endpoint: str) -> zenoh.Config:
    """The shipped configuration of that side and role (`router` or `client`), with that endpoint."""
    path = deployment("zenoh", f"{side.value}-{role}.json5")
    try:
        config = zenoh.Config.from_file(str(path))
        config.insert_json5("listen/endpoints" if role == "router" else "connect/endpoints", json.dumps([endpoint]))
    except zenoh.ZError as error:
        raise InvalidInput(
            f"{path}: expected a Zenoh configuration and an endpoint, got: {_first_line(error)}"
        ) from None
    return config


@dataclass(frozen=True, slots=True)
class IncomingQuery:
    """A query that came in; answer it exactly once, from any thread."""

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
        """What stood behind the '?' of the selector."""
        parameters: Any = self.query.parameters
        return dict(parameters)

    def reply(self, payload: bytes, attachment: bytes | None = None, media_type: str = "application/json") -> None:
        encoding = zenoh.Encoding(media_type)
        self.query.reply(self.query.key_expr, payload, encoding=encoding, attachment=attachment)
        self.query.drop()  # type: ignore[no-untyped-call]

    def leave(self) -> None:
        """Let it end without an answer from here."""
        self.query.drop()  # type: ignore[no-untyped-call]

    def refuse(self, why: str, attachment: bytes | None = None) -> None:
        self.query.reply_err(error_body(why, attachment), encoding=zenoh.Encoding.APPLICATION_JSON)
        self.query.drop()  # type: ignore[no-untyped-call]


class Session:
    """A session on one side of a mission."""

    def __init__(self, session: zenoh.Session, mission: str) -> None:
        self._session = session
        self._mission = mission
        self._held: list[Any] = []
        self._kept: dict[Topic, bytes] = {}
        self._publishers: dict[Topic, zenoh.Publisher] = {}

    def publish(
        self, topic: Topic, payload: bytes, attachment: bytes | None = None, media_type: str = "application/json"
    ) -> None:
        """Send to all who listen, and wait for whoever is slow to take it."""
        self._session.put(
            topic.key(self._mission),
            payload,
            encoding=zenoh.Encoding(media_type),
            congestion_control=zenoh.CongestionControl.BLOCK,
            attachment=attachment,
        )
        self._keep(topic, payload)

    def show(
        self, topic: Topic, payload: bytes, attachment: bytes | None = None, media_type: str = "application/json"
    ) -> None:
        """Send to all who listen and keep up; wait for nobody."""
        self._publisher(topic).put(payload, encoding=zenoh.Encoding(media_type), attachment=attachment)
        self._keep(topic, payload)

    def _keep(self, topic: Topic, payload: bytes) -> None:
        if topic.kept:
            first = topic not in self._kept
            self._kept[topic] = payload
            if first:
                self.serve(topic, lambda query: query.reply(self._kept[topic]))

    def listened(self, topic: Topic) -> bool:
        """Whether anybody is known to subscribe to that topic."""
        status: Any = self._publisher(topic).matching_status
        return bool(status.matching)

    def _publisher(self, topic: Topic) -> zenoh.Publisher:
        publisher = self._publishers.get(topic)
        if publisher is None:
            # A priority of its own: whoever does not take the answers that he asked for blocks the queue of theirs.
            publisher = self._session.declare_publisher(
                topic.key(self._mission),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.DATA_HIGH,
            )
            self._publishers[topic] = publisher
        return publisher

    def subscribe(self, topic: Topic, on_payload: OnPayload) -> Callable[[], None]:
        """Call `on_payload` with what comes from now on, until what is returned is called."""

        def hand_over(sample: zenoh.Sample) -> None:
            if _is_put(sample):
                on_payload(sample.payload.to_bytes(), _attachment(sample))

        subscriber: Any = self._session.declare_subscriber(topic.key(self._mission), hand_over)
        self._held.append(subscriber)

        def end() -> None:
            self._held.remove(subscriber)
            subscriber.undeclare()

        return end

    def serve(self, topic: Topic, on_query: Callable[[IncomingQuery], None]) -> None:
        """Answer questions of that topic, whoever asks."""
        key = topic.key(self._mission)
        self._held.append(self._session.declare_queryable(key, lambda query: on_query(IncomingQuery(query))))

    def ask(
        self,
        topic: Topic,
        payload: bytes | None,
        timeout_s: float,
        on_end: Callable[[bytes | NoReply, str, bytes], None],
        attachment: bytes | None = None,
        parameters: str = "",
    ) -> None:
        """Ask, and call `on_end` exactly once: with the answer, or with why there is none and what was said.

        parameters: what stands behind the '?' of the selector, where the question is not a message.
        """
        ended: list[bool] = []

        def end(answer: bytes | NoReply, said: str, attachment: bytes) -> None:
            if not ended:  # the first answer counts; others who could have answered may be slow to say that they do not
                ended.append(True)
                on_end(answer, said, attachment)

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                end(reply.ok.payload.to_bytes(), "", _attachment(reply.ok))
                return
            said = reply.err.payload.to_bytes() if reply.err is not None else b""
            if said == b"Timeout":
                end(NoReply.TIMEOUT, f"within {timeout_s:g} s", b"")
            else:
                end(NoReply.REFUSED, *_refusal(said))

        self._session.get(
            topic.key(self._mission) + (f"?{parameters}" if parameters else ""),
            handler=zenoh.handlers.Callback(on_reply, lambda: end(NoReply.NO_ROUTE, "", b"")),
            payload=payload,
            encoding=None if payload is None else zenoh.Encoding.APPLICATION_JSON,
            timeout=timeout_s,
            attachment=attachment,
        )

    def announce(self, name: str, side: Side, register: str = ALIVE) -> None:
        """Show this process as alive, in that register, for as long as its session lives."""
        self._held.append(self._session.liveliness().declare_token(alive_key(self._mission, side, name, register)))

    def watch_alive(self, side: Side, on_change: Callable[[str, bool], None], register: str = ALIVE) -> None:
        """Call `on_change(name, alive)` for every process of that register that is alive, appears, or is gone."""

        def hand_over(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr).rsplit("/", 1)[-1]
            on_change(name, _is_put(sample))

        key = alive_key(self._mission, side, "*", register)
        self._held.append(self._session.liveliness().declare_subscriber(key, hand_over, history=True))

    def close(self) -> None:
        """End the session; returns within a second even when the transport hangs."""
        close_all([self])

    def closing(self) -> threading.Thread:
        """The thread in which the session is being ended."""
        closing = threading.Thread(target=self._close, name="zenoh-close", daemon=True)
        closing.start()
        return closing

    def _close(self) -> None:
        try:
            self._session.close()  # type: ignore[no-untyped-call]
        except zenoh.ZError:
            return  # it is going away anyway


def close_all(sessions: Iterable[Session]) -> None:
    """End all of these sessions at the same time; returns within a second even when a transport hangs."""
    give_up = time.monotonic() + CLOSE_WITHIN_S
    for thread in [session.closing() for session in sessions]:
        thread.join(max(0.0, give_up - time.monotonic()))


def alive_key(mission: str, side: Side, name: str, register: str = ALIVE) -> str:
    """Key of the liveliness token of a process; the one key that is not a topic, as it carries no message."""
    return f"{KEY_ROOT}/{mission}/{side.value}/{register}/{name}"


def open_session(side: Side, role: str, endpoint: str) -> zenoh.Session:
    """A session, connected (client) or listening (router); raises PeerUnreachable with one line."""
    config = session_config(side, role, endpoint)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if role == "router":
            raise PeerUnreachable(
                f"cannot listen as the {side.value} router at {endpoint}: {_first_line(error)}"
            ) from None
        raise PeerUnreachable(f"no {side.value} router at {endpoint}") from None


def connect_client(
    side: Side, endpoint: str, mission: str, stop: threading.Event, on_waiting: Callable[[str], None]
) -> Session | None:
    """A bus on that side, as soon as its router is there; `on_waiting` is told once. None when `stop` was set first."""
    told = False
    while not stop.is_set():
        try:
            return Session(open_session(side, "client", endpoint), mission)
        except PeerUnreachable as error:
            if not told:
                on_waiting(f"{error}; still trying")
                told = True
            stop.wait(0.3)
    return None


class Client:
    """An operator's session on Earth: asks, listens, and holds nothing up. Use it in a `with` statement."""

    def __init__(self, endpoint: str, mission: str, name: str = "operator", side: Side = Side.EARTH) -> None:
        self._mission = mission
        self._name = name
        self._session = Session(open_session(side, "client", endpoint), mission)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._session.close()

    def query(self, topic: Topic, request: Wire, timeout_s: float = 10.0) -> Any:
        """The body of the answer; raises PeerUnreachable when nobody answers, or `refusal`."""
        return decode_reply(topic, self._ask(topic, encode(self._header(0), request), timeout_s), self._mission)[1]

    def fetch(self, topic: Topic, parameters: Mapping[str, object], timeout_s: float = 10.0) -> tuple[bytes, bytes]:
        """The answer as it stands, and its attachment, to a question of selector parameters, as any client asks it.

        Raises PeerUnreachable when nobody answers, InvalidInput for parameters that no selector can hold, He3Error with
        a refusal's text.
        """
        text = selector_text(parameters)
        return self._outcome(
            topic, lambda on_end: self._session.ask(topic, None, timeout_s, on_end, None, text), timeout_s
        )

    def latest(self, topic: Topic, timeout_s: float = 10.0) -> tuple[Header, Any]:
        """The last message of a topic that is kept (or a clock); raises PeerUnreachable when nobody has one."""
        return decode(topic, self._ask(topic, b"", timeout_s), self._mission)

    def _ask(self, topic: Topic, payload: bytes, timeout_s: float) -> bytes:
        return self._outcome(topic, lambda on_end: self._session.ask(topic, payload, timeout_s, on_end), timeout_s)[0]

    def _outcome(
        self, topic: Topic, ask: Callable[[Callable[[bytes | NoReply, str, bytes], None]], None], timeout_s: float
    ) -> tuple[bytes, bytes]:
        ended = threading.Event()
        outcome: list[tuple[bytes | NoReply, str, bytes]] = []

        def on_end(answer: bytes | NoReply, detail: str, attachment: bytes) -> None:
            outcome.append((answer, detail, attachment))
            ended.set()

        ask(on_end)
        if not ended.wait(timeout_s + 1.0):
            raise PeerUnreachable(f"{topic.key(self._mission)}: no answer within {timeout_s:g} s")
        answer, detail, attachment = outcome[0]
        if isinstance(answer, bytes):
            return answer, attachment
        if answer is NoReply.REFUSED:
            raise refusal(detail)
        raise PeerUnreachable(f"{topic.key(self._mission)}: {answer.value}{' ' + detail if detail else ''}")

    def subscribe(self, topic: Topic, on_message: Callable[[Header, Any], None]) -> Callable[[], None]:
        """Call `on_message(header, body)`, in another thread, with each message that comes and is well formed.

        Calling what is returned ends that.
        """

        def checked(payload: bytes, _attachment: bytes) -> None:
            try:
                header, body = decode(topic, payload, self._mission)
            except ValueError:
                return  # a stranger's; the services count those, an onlooker passes over them
            on_message(header, body)

        return self._session.subscribe(topic, checked)

    def subscribe_raw(self, topic: Topic, on_payload: Callable[[bytes], None]) -> Callable[[], None]:
        """Call `on_payload`, in another thread, with the bytes of each message that comes; what returns ends that."""
        return self._session.subscribe(topic, lambda payload, _attachment: on_payload(payload))

    def watch_alive(self, side: Side, on_change: Callable[[str, bool], None]) -> None:
        self._session.watch_alive(side, on_change)

    def _header(self, now: MissionTime) -> Header:
        return Header(mission=self._mission, source=self._name, incarnation=0, sequence=0, made_at=now)


def selector_text(parameters: Mapping[str, object]) -> str:
    """Parameters as they stand in a selector; None is left out. Raises InvalidInput for what would end one early."""
    text = {key: str(value) for key, value in parameters.items() if value is not None}
    for key, value in text.items():
        if not value.isprintable() or any(mark in value for mark in ";#?="):
            raise InvalidInput(f"{key}: expected a value without ';', '#', '?' or '=', got {value[:60]!r}")
    return ";".join(f"{key}={value}" for key, value in text.items())


def error_body(why: str, attachment: bytes | None = None) -> bytes:
    """How a refusal looks on the wire; error replies have no attachment of their own, so it goes inside."""
    stamp = {} if attachment is None else {"stamp": attachment.decode()}
    return json.dumps({"error": why, **stamp}).encode()


def refusal(why: str) -> He3Error:
    """What a refused question raises: InvalidInput where the text says what was expected of the asker and what came."""
    return InvalidInput(why) if _OF_WHAT_WAS_ASKED.search(why) else He3Error(why)


_OF_WHAT_WAS_ASKED = re.compile(r"\bexpected .+[,;:] got ")


def _is_put(sample: Any) -> bool:
    return bool(sample.kind == zenoh.SampleKind.PUT)


def _attachment(carrier: Any) -> bytes:
    attachment = carrier.attachment
    return b"" if attachment is None else bytes(attachment.to_bytes())


def _refusal(said: bytes) -> tuple[str, bytes]:
    """What a refusal says, and the stamp in it."""
    try:
        body = json.loads(said)
        return str(body["error"]), str(body.get("stamp", "")).encode()
    except (ValueError, TypeError, KeyError, AttributeError):
        return said.decode(errors="replace")[:200], b""


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0].split(" at /")[0]

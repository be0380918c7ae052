"""A running mission over Foxglove's WebSocket protocol: what a recording has, live, for any number of viewers.

It reads the topics that a viewer may read, and its server takes nothing but subscriptions. The protocol has no login:
every program that reaches the port can read the mission.
"""

from __future__ import annotations

import json
import queue
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from he3.errors import He3Error, InvalidInput
from schemas.codec import encode
from schemas.topics import (
    COMMAND_STATUS,
    EVENT,
    GROUND_STATUS,
    LINK_STATUS,
    MAP_OVERVIEW,
    SAMPLE,
    STATE,
    Topic,
)
from schemas.wire import Envelope, Header, Wire
from services.recorder.foxglove.derivation import CHANNELS, Derivation, Derived
from services.recorder.foxglove.schemas import ENCODING, PACKAGE, descriptors

if TYPE_CHECKING:
    from schemas.ground import GroundStatus
    from services.console.client.mission_client import MissionClient
    from services.console.client.mission_state import MissionState

STREAMED: Final[tuple[Topic, ...]] = (
    MAP_OVERVIEW, GROUND_STATUS, LINK_STATUS, STATE, SAMPLE, EVENT, COMMAND_STATUS,
)  # fmt: skip
"""Our topics that are streamed, and from which Foxglove's messages are made; all may be read by a viewer."""
KEPT: Final = (MAP_OVERVIEW, LINK_STATUS, GROUND_STATUS)
"""Those whose last message can be queried; the ground's has the rover's last state in it."""
MAX_WAITING: Final = 10_000  # messages; beyond it the oldest are dropped, as for any slow reader of a mission
TIME_EVERY_S: Final = 0.1  # wall time between two announcements of mission time
REFRESH_EVERY_S: Final = 1.0
UNPROTECTED: Final = "INSECURE: no login and no TLS; anyone who reaches the port reads the mission"
ADDS_UP: Final = "/samples/markers"
"""The topic whose messages each add a thing: a viewer who comes later gets all of them."""

LOG: Final = "/log"

Item = tuple[Topic, Header, Wire]


def stream(client: MissionClient, bind: str, port: int, say: Callable[[str], None]) -> None:
    """Serve viewers until Ctrl-C; `say` gets a line with the address.

    Raises He3Error where Foxglove's package is missing or the port is taken.
    """
    state = client.state(follow=False)
    server = _Server(client.mission, bind, port)
    try:
        waiting: queue.Queue[Item] = queue.Queue(maxsize=MAX_WAITING)
        ends = [client.listen(topic, _keeper(waiting, topic)) for topic in STREAMED]
        state.follow()
        say(f"mission '{client.mission}' at ws://{bind}:{server.port} (read-only); Ctrl-C stops it")
        try:
            _Stream(client, state, server, waiting).run()
        finally:
            for end in ends:
                end()
    finally:
        server.stop()


def _keeper(waiting: queue.Queue[Item], topic: Topic) -> Callable[[Header, Any], None]:
    def keep(header: Header, body: Any) -> None:
        while True:
            try:
                waiting.put_nowait((topic, header, body))
                return
            except queue.Full:
                with suppress(queue.Empty):
                    waiting.get_nowait()

    return keep


class _Stream:
    """From the mission's messages to the server's channels, in one thread."""

    def __init__(self, client: MissionClient, state: MissionState, server: _Server, waiting: queue.Queue[Item]) -> None:
        self._client = client
        self._state = state
        self._server = server
        self._waiting = waiting
        self._derivation = Derivation()
        self._start_ns = state.time.start_ns
        self._plan_revision = -1
        self._release = client.declare_display()

    def run(self) -> None:
        self._begin()
        told_at = refreshed_at = time.monotonic()
        while True:
            with suppress(queue.Empty):
                self._take(*self._waiting.get(timeout=TIME_EVERY_S))
            now = time.monotonic()
            if now - told_at >= TIME_EVERY_S:
                told_at = now
                self._server.tell_time(self._state.time.now())
            if now - refreshed_at >= REFRESH_EVERY_S:
                refreshed_at = now
                self._refresh()

    def _begin(self) -> None:
        """What is known so far: the last messages, and the ground's account of the samples and the path."""
        for topic in KEPT:
            with suppress(He3Error):
                self._take(topic, *self._client.latest(topic))

    def _refresh(self) -> None:
        """Notice a mission that was started anew at the same endpoint: its viewers begin again."""
        self._state.refresh()
        start_ns = self._state.time.start_ns
        if start_ns != self._start_ns:
            self._start_ns, self._plan_revision, self._derivation = start_ns, -1, Derivation()
            self._server.begin_again()
            self._begin()

    def _take(self, topic: Topic, header: Header, body: Any) -> None:
        now = self._state.time.now() or header.made_at
        self._server.send_ours(topic, encode(header, body), now)
        if topic is GROUND_STATUS:
            self._send(self._of_status(header, body), now)
            if body.is_over:
                self._release()
        self._send(self._derivation.of(topic, header, body), now)

    def _of_status(self, header: Header, status: GroundStatus) -> Iterator[Derived]:
        if status.plan_revision != self._plan_revision:
            # Plans are for the rover alone; the ground tells people the path that is left of one.
            with suppress(He3Error):
                track = self._client.track()
                self._plan_revision = status.plan_revision
                yield from self._derivation.of_track(track, header.made_at)
        if status.rover is not None and status.rover_made_at is not None:
            reported = header.model_copy(update={"incarnation": 0, "made_at": status.rover_made_at})
            yield from self._derivation.of(STATE, reported, status.rover)

    def _send(self, messages: Iterator[Derived], now: int) -> None:
        for message in messages:
            self._server.send_derived(message, now)


class _Server:
    """Foxglove's server with a channel for each topic; it keeps the last message of each for viewers who come later."""

    def __init__(self, mission: str, bind: str, port: int) -> None:
        try:
            import foxglove
            from foxglove import websocket
        except ImportError:
            raise He3Error("he3 foxglove needs foxglove: pip install 'he3-seeker[viewers]'") from None
        foxglove.set_log_level("CRITICAL")  # it calls a viewer that closes its window an error
        self._library = foxglove
        self._context = foxglove.Context()
        self._mission = mission
        self._channels: dict[str, Any] = {}
        self._last: dict[str, tuple[bytes, int]] = {}
        for topic in STREAMED:
            schema = json.dumps(Envelope[topic.payload].model_json_schema()).encode()  # type: ignore[name-defined]
            self._open(topic.key(mission), topic.payload.__name__, "jsonschema", schema, "json")
        for name, kind in CHANNELS.items():
            self._open(name, f"{PACKAGE}.{kind}", ENCODING, descriptors(kind), ENCODING)
        late = self._send_last

        class Listener(websocket.ServerListener):
            def on_subscribe(self, client: Any, channel: Any) -> None:
                late(channel.topic)

        try:
            self._server = foxglove.start_server(
                name=f"he3 {mission}", host=bind, port=port, context=self._context,
                capabilities=[websocket.Capability.Time], server_listener=Listener(),
            )  # fmt: skip
        except (OSError, RuntimeError) as error:
            raise He3Error(f"cannot listen at {bind} port {port}: {error}; expected a free port (--port)") from None

    @property
    def port(self) -> int:
        return int(self._server.port)

    def send_ours(self, topic: Topic, payload: bytes, at: int) -> None:
        """Send one of our messages, received at that mission time [ns]."""
        self._send(topic.key(self._mission), payload, at)

    def send_derived(self, message: Derived, at: int) -> None:
        """Send one of Foxglove's, made of a message that was received at that mission time [ns]."""
        before = self._last.get(message.topic)
        self._send(message.topic, message.payload, at)
        if message.topic == ADDS_UP and before is not None:  # joined, protobuf messages add their lists
            self._last[message.topic] = (before[0] + message.payload, at)

    def tell_time(self, now: int) -> None:
        """Tell the viewers mission time [ns]."""
        self._server.broadcast_time(now)

    def begin_again(self) -> None:
        """Let every viewer forget what it has seen."""
        self._last.clear()
        self._server.clear_session()

    def stop(self) -> None:
        self._server.stop()

    def _open(self, topic: str, name: str, schema_encoding: str, schema: bytes, encoding: str) -> None:
        described = self._library.Schema(name=name, encoding=schema_encoding, data=schema)
        self._channels[topic] = self._library.Channel(
            topic, schema=described, message_encoding=encoding, context=self._context
        )

    def _send(self, topic: str, payload: bytes, at: int) -> None:
        self._last[topic] = (payload, at)
        self._channels[topic].log(payload, log_time=at)

    def _send_last(self, topic: str) -> None:
        """Send the last message of that topic again, as a viewer has just come; called in a thread of the server's.

        The library sends it to every viewer. A line of the log would then be there twice, so it is not repeated.
        """
        last = self._last.get(topic)
        if last is not None and topic != LOG:
            self._channels[topic].log(last[0], log_time=last[1])


def check_loopback(bind: str, insecure: bool) -> str | None:
    """A warning, or None, for an address that may be listened at.

    Raises InvalidInput for one off loopback, unless the user has asked for it.
    """
    import ipaddress

    try:
        local = bind == "localhost" or ipaddress.ip_address(bind).is_loopback
    except ValueError:
        raise InvalidInput(f"--bind: expected an IP address or localhost, got '{bind[:80]}'") from None
    if local:
        return None
    if not insecure:
        raise InvalidInput(
            f"--bind {bind}: expected an address on loopback: Foxglove's protocol has no login "
            "(--insecure serves anyone who reaches the port)"
        )
    return UNPROTECTED

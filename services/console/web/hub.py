"""What the page knows of the mission, kept for everybody who looks, and told to each of them as it comes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from he3.errors import He3Error
from schemas.commands import CommandStatus
from schemas.ground import GroundStatus
from schemas.link import ClockMode, ClockState, LinkStatus
from schemas.telemetry import RoverEvent, RoverState
from schemas.topics import (
    COMMAND_STATUS,
    EARTH_CLOCK,
    EVENT,
    GROUND_STATUS,
    LINK_STATUS,
    STATE,
    Topic,
)
from schemas.wire import Header
from services.console.client.mission_client import MissionClient
from services.console.web.alarms import Alarms, documents
from services.runtime.clock import mission_time, newer
from services.runtime.node import MissionTime

MAX_EVENTS = 300
MAX_POINTS = 1500
"""Of a chart's curve; when there are more, every second one goes."""
MAX_WAITING = 400
"""Messages that a browser may be behind; then it is let go, comes back by itself, and starts afresh."""
LOOK_EVERY_S = 0.5
FLIGHTS_TOLD_S = 0.5
MAX_FLIGHTS = 100
LATEST_EVERY_S = 0.1
"""A status that is said more often is told no more often than this."""


class Viewer:
    """One browser: a bounded queue in the server's loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.queue: asyncio.Queue[str | None] = asyncio.Queue(MAX_WAITING)

    def put(self, text: str) -> None:
        """Hand over a message; called in the server's loop. A browser that is too far behind is let go."""
        try:
            self.queue.put_nowait(text)
        except asyncio.QueueFull:
            while not self.queue.empty():
                self.queue.get_nowait()
            self.queue.put_nowait(None)


class Hub:
    """Listens to the mission for all browsers. Zenoh's threads come in below; nothing of them waits."""

    def __init__(self, mission: MissionClient, authority: bool, state_period_s: float = 60.0) -> None:
        self.mission = mission
        self.authority = authority
        self._lock = threading.Lock()
        self._viewers: set[Viewer] = set()
        self._alarms = Alarms(state_period_s)
        self._events: deque[dict[str, Any]] = deque(maxlen=MAX_EVENTS)
        self._curves: dict[str, list[tuple[float, float]]] = {
            name: [] for name in ("energy_wh", "queue", "mean_std_ppb", "rmse_ppb")
        }
        self._status: GroundStatus | None = None
        self._link: LinkStatus | None = None
        self._clock: ClockState | None = None
        self._commands: dict[str, CommandStatus] = {}
        self._flights: dict[tuple[Any, ...], tuple[float, dict[str, Any]]] = {}
        self._heard: MissionTime = 0
        self._heard_wall = time.monotonic()
        self._told: dict[str, float] = {}
        self._pending: dict[str, str] = {}
        self._ended = threading.Event()

    def begin(self) -> None:
        """Listen from now on, and catch up with what was said before."""
        client = self.mission.client
        keepers: tuple[tuple[Topic, Callable[[Header, Any], None]], ...] = (
            (GROUND_STATUS, self._keep_status),
            (LINK_STATUS, self._keep_link),
            (EARTH_CLOCK, self._keep_clock),
            (STATE, self._keep_state),
            (EVENT, self._keep_event),
            (COMMAND_STATUS, self._keep_command),
        )
        # The clock first: curves are drawn over the time since the mission's start.
        self._catch_up(EARTH_CLOCK, self._keep_clock)
        for topic, keep in keepers[1:]:
            client.subscribe(topic, keep)
        with contextlib.suppress(He3Error):  # it has not begun: then all of it will be heard
            for status in self.mission.commands():
                self._keep_command(None, status)
            for score in self.mission.track().score_history:
                self._point("rmse_ppb", score.mission_time_ns, score.rmse_ppb)
            for revision in self.mission.history().revisions:
                self._point("mean_std_ppb", revision.mission_time_ns, revision.mean_std_ppb)
        client.subscribe(GROUND_STATUS, self._keep_status)
        self._catch_up(GROUND_STATUS, self._keep_status)
        self._catch_up(LINK_STATUS, self._keep_link)
        threading.Thread(target=self._look, name="web-look", daemon=True).start()

    def _catch_up(self, topic: Topic, keep: Callable[[Header, Any], None]) -> None:
        with contextlib.suppress(He3Error):
            keep(*self.mission.client.latest(topic, 2.0))

    def close(self) -> None:
        """Let everybody go."""
        self._ended.set()
        with self._lock:
            for viewer in self._viewers:
                viewer.loop.call_soon_threadsafe(viewer.queue.put_nowait, None)

    # --- who looks --------------------------------------------------------------------------------------------------

    def enter(self, viewer: Viewer) -> None:
        """Tell this browser everything that is known, and from now on all that comes."""
        with self._lock:
            viewer.queue.put_nowait(_message("state", self._document()))
            self._viewers.add(viewer)

    def leave(self, viewer: Viewer) -> None:
        with self._lock:
            self._viewers.discard(viewer)

    def acknowledge(self, alarm_id: str) -> bool:
        """Somebody saw that alarm; whether there was one."""
        with self._lock:
            done = self._alarms.acknowledge(alarm_id)
            if done:
                self._tell("alarms", documents(self._alarms.current))
            return done

    def now(self) -> MissionTime:
        """Mission time, as far as this session knows."""
        clock = self._clock
        if clock is None or clock.mode is ClockMode.LOCKSTEP:
            return self._heard
        return max(self._heard, mission_time(clock, time.time_ns()))

    # --- what comes, in the session's threads -----------------------------------------------------------------------

    def _keep_status(self, header: Header, body: GroundStatus) -> None:
        with self._lock:
            self._hear(header)
            self._status = body
            if body.mean_std_ppb is not None:
                self._point("mean_std_ppb", header.made_at, body.mean_std_ppb)
            if body.score is not None:
                self._point("rmse_ppb", header.made_at, body.score.rmse_ppb)
            self._tell_latest("status", {"at": header.made_at, **body.model_dump(mode="json")})

    def _keep_link(self, header: Header, body: LinkStatus) -> None:
        with self._lock:
            self._hear(header)
            self._link = body
            # A flight may be over before the next telling: what has been seen of late is told again.
            wall = time.monotonic()
            for flight in body.in_flight:
                key = (flight.direction, flight.topic, flight.source, flight.sequence, flight.offered_at)
                if flight.arrives_at is not None:
                    self._flights[key] = (wall, flight.model_dump(mode="json"))
            self._flights = {key: seen for key, seen in self._flights.items() if wall - seen[0] < FLIGHTS_TOLD_S}
            document = body.model_dump(mode="json", exclude={"in_flight", "dropped"})
            document["in_flight"] = [flight for _, flight in self._flights.values()][-MAX_FLIGHTS:]
            self._tell_latest("link", {"at": header.made_at, **document})

    def _keep_clock(self, header: Header, body: ClockState) -> None:
        with self._lock:
            self._hear(header)
            self._clock = newer(self._clock, body)
            self._tell("clock", self._clock_document())

    def _keep_state(self, header: Header, body: RoverState) -> None:
        with self._lock:
            self._hear(header, down=True)
            self._point("energy_wh", header.made_at, body.energy_wh)
            self._point("queue", header.made_at, float(body.queue_depth))
            rover = {"made_at": header.made_at, **body.model_dump(mode="json")}
            self._tell_latest("rover", rover)

    def _keep_event(self, header: Header, body: RoverEvent) -> None:
        with self._lock:
            self._hear(header, down=True)
            if self._events and any(each["key"] == [header.incarnation, header.sequence] for each in self._events):
                return  # said again, as custody does until it is acknowledged
            entry = {"key": [header.incarnation, header.sequence], "received_at": self.now()}
            entry |= body.model_dump(mode="json", exclude={"samples_done"})
            self._events.append(entry)
            self._tell("event", entry)
            if self._alarms.happened(body):
                self._tell("alarms", documents(self._alarms.current))

    def _keep_command(self, header: Header | None, body: CommandStatus) -> None:
        with self._lock:
            if header is not None:
                self._hear(header)
            self._commands[body.command.command_id] = body
            self._tell("command", body.model_dump(mode="json"))

    def _hear(self, header: Header, down: bool = False) -> None:
        # What comes down was made on the Moon a light time ago: it does not tell the time here.
        if not down:
            self._heard = max(self._heard, header.made_at)
        self._heard_wall = time.monotonic()

    def _point(self, curve: str, at: MissionTime, value: float) -> None:
        points = self._curves[curve]
        start = 0 if self._clock is None else self._clock.start_ns
        seconds = (at - start) / 1e9
        if points and (points[-1][0] >= seconds or (len(points) > 1 and points[-1][1] == value == points[-2][1])):
            if points[-1][0] < seconds:
                points[-1] = (seconds, value)
            return
        points.append((seconds, value))
        if len(points) > MAX_POINTS:
            del points[1:-1:2]
        self._tell_latest(f"curve:{curve}", {"name": curve, "points": points[-200:]}, kind="curve")

    # --- telling ----------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        while not self._ended.wait(LATEST_EVERY_S):
            with self._lock:
                wall = time.monotonic()
                for name in [name for name in self._pending if wall - self._told[name] >= LATEST_EVERY_S]:
                    self._told[name] = wall
                    self._send(self._pending.pop(name))
                rate = 1.0 if self._clock is None else self._clock.rate
                if self._alarms.look(self._status, self._link, self.now(), rate):
                    self._tell("alarms", documents(self._alarms.current))
                if wall - self._told.get("beat", 0.0) >= 2.0:
                    self._told["beat"] = wall
                    self._tell("beat", {"silent_s": wall - self._heard_wall, **self._clock_document()})

    def _tell(self, kind: str, document: Any) -> None:
        self._send(_message(kind, document))

    def _tell_latest(self, name: str, document: Any, kind: str | None = None) -> None:
        text = _message(kind or name, document)
        wall = time.monotonic()
        if wall - self._told.get(name, 0.0) < LATEST_EVERY_S:
            self._pending[name] = text
            return
        self._pending.pop(name, None)
        self._told[name] = wall
        self._send(text)

    def _send(self, text: str) -> None:
        for viewer in self._viewers:
            viewer.loop.call_soon_threadsafe(viewer.put, text)

    def _clock_document(self) -> dict[str, Any]:
        clock = self._clock
        return {
            "wall_ns": time.time_ns(),
            "now": self.now(),
            "rate": 0.0 if clock is None or clock.mode is ClockMode.LOCKSTEP else clock.rate,
            "mode": None if clock is None else clock.mode.value,
            "start_ns": None if clock is None else clock.start_ns,
        }

    def _document(self) -> dict[str, Any]:
        return {
            "mission": self.mission.mission,
            "earth": self.mission.earth,
            "authority": self.authority,
            "clock": self._clock_document(),
            "status": None if self._status is None else self._status.model_dump(mode="json"),
            "link": None if self._link is None else self._link.model_dump(mode="json"),
            "commands": [status.model_dump(mode="json") for status in self._commands.values()],
            "events": list(self._events),
            "curves": self._curves,
            "alarms": documents(self._alarms.current),
        }


def _message(kind: str, document: Any) -> str:
    return f"event: {kind}\ndata: {json.dumps(document)}\n\n"

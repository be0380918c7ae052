"""The page's data, kept once for all browsers, and sent to each of them when it changes.

The mission's facts are those of `MissionState`; the hub adds the curves of the charts and the alarms, and limits how
often a browser is updated. Zenoh's threads enter through `_changed`, which never waits.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from typing import TYPE_CHECKING, Any

from he3.errors import He3Error
from schemas.topics import COMMAND_STATUS, EARTH_CLOCK, EVENT, GROUND_STATUS, LINK_STATUS, STATE, Topic
from services.console.client.liveness import Condition, Liveness, liveness
from services.console.web.alarms import Alarms, documents
from services.console.web.curves import Curves

if TYPE_CHECKING:
    from schemas.commands import CommandStatus
    from services.console.client.mission_client import MissionClient
    from services.console.client.mission_state import Happened, MissionState

MAX_VIEWERS = 100
MAX_WAITING = 400
"""Queue length of a browser; beyond it the stream ends, and the browser reconnects and receives everything anew."""
TOLD_EVERY_S = 0.1
"""A status that changes more often is sent no more often than this [s of wall time]."""
BEAT_EVERY_S = 1.0
FLIGHTS_SHOWN_S = 0.5
"""A message in flight is shown for at least this time, because it may arrive before the next status is sent."""
MAX_FLIGHTS = 100


class Viewer:
    """One browser: a bounded queue in the server's loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.queue: asyncio.Queue[str | None] = asyncio.Queue(MAX_WAITING)

    def put(self, text: str | None) -> None:
        """Hand over a message, in the server's loop; the stream of a browser that is too far behind ends."""
        try:
            self.queue.put_nowait(text)
        except asyncio.QueueFull:
            while not self.queue.empty():
                self.queue.get_nowait()
            self.queue.put_nowait(None)


class Hub:
    """The mission's state with curves and alarms, sent to every browser."""

    def __init__(self, mission: MissionClient) -> None:
        self.mission = mission
        self._lock = threading.RLock()
        self._viewers: set[Viewer] = set()
        self._told: dict[str, float] = {}
        self._pending: dict[str, str] = {}
        self._ended = threading.Event()
        self._state: MissionState = mission.state(self._changed, follow=False)
        self._start_afresh()

    def _start_afresh(self) -> None:
        self._alarms = Alarms()
        self._curves = Curves()
        self._flights: dict[tuple[Any, ...], tuple[float, dict[str, Any]]] = {}
        self._events_sent: set[tuple[str, int, int]] = set()
        self._stages_sent: dict[str, int] = {}
        self._has_past = False
        self._condition: Condition | None = None

    def begin(self) -> None:
        """Subscribe, and query the mission's past."""
        self._state.follow()
        self._catch_up()
        threading.Thread(target=self._look, name="web-look", daemon=True).start()

    def _catch_up(self) -> None:
        """Insert the mission's past before the points that the curves already have."""
        self._has_past = True
        with contextlib.suppress(He3Error):  # it has not begun: then all of it will be heard
            scores, revisions = self.mission.track().score_history, self.mission.history().revisions
            past = Curves()
            for score in scores:
                past.add("rmse_ppb", self._seconds(score.mission_time_ns), score.rmse_ppb)
            for revision in revisions:
                past.add("mean_std_ppb", self._seconds(revision.mission_time_ns), revision.mean_std_ppb)
            with self._lock:
                self._curves.prepend(past)
                self._tell("state", self._document())

    def close(self) -> None:
        """End every browser's stream."""
        self._ended.set()
        with self._lock:
            for viewer in self._viewers:
                viewer.loop.call_soon_threadsafe(viewer.put, None)

    @property
    def warning(self) -> str | None:
        """In one line, that processes of the mission are open to everyone; None if none is."""
        names = ", ".join(self._state.insecure)
        return f"INSECURE: {names} without TLS off loopback" if names else None

    # --- browsers ---------------------------------------------------------------------------------------------------

    def enter(self, viewer: Viewer) -> bool:
        """Send this browser all data, and every change from now on; False if there are too many browsers."""
        with self._lock:
            if len(self._viewers) >= MAX_VIEWERS:
                return False
            viewer.queue.put_nowait(_message("state", self._document()))
            self._viewers.add(viewer)
            return True

    def leave(self, viewer: Viewer) -> None:
        with self._lock:
            self._viewers.discard(viewer)

    def acknowledge(self, alarm_id: str) -> bool:
        """Acknowledge an alarm; returns whether there was one to acknowledge."""
        with self._lock:
            done = self._alarms.acknowledge(alarm_id)
            if done:
                self._tell("alarms", documents(self._alarms.current))
            return done

    # --- what changes, in the session's threads ---------------------------------------------------------------------

    def _changed(self, topic: Topic | None) -> None:
        with self._lock:
            if topic is None:
                self._start_afresh()
                self._tell("state", self._document())
            elif topic is GROUND_STATUS:
                self._status_changed()
            elif topic is LINK_STATUS:
                self._tell_latest("link", self._link_document())
            elif topic is EARTH_CLOCK:
                self._tell("clock", self._clock_document())
            elif topic is STATE:
                self._rover_changed()
            elif topic is EVENT:
                self._events_changed()
            elif topic is COMMAND_STATUS:
                self._commands_changed()

    def _status_changed(self) -> None:
        fact = self._state.fact(GROUND_STATUS)
        if fact is None:
            return
        if fact.body.mean_std_ppb is not None:
            self._point("mean_std_ppb", fact.made_at, fact.body.mean_std_ppb)
        if fact.body.score is not None:
            self._point("rmse_ppb", fact.made_at, fact.body.score.rmse_ppb)
        self._tell_latest("status", self._status_document())

    def _rover_changed(self) -> None:
        fact = self._state.fact(STATE)
        if fact is None:
            return
        self._point("energy_wh", fact.made_at, fact.body.energy_wh)
        self._point("queue", fact.made_at, float(fact.body.queue_depth))
        self._tell_latest("rover", self._rover_document())

    def _events_changed(self) -> None:
        for happened in self._state.events:
            if happened.key not in self._events_sent:
                self._events_sent.add(happened.key)
                self._tell("event", _event_document(happened))
                if self._alarms.happened(happened.event):
                    self._tell("alarms", documents(self._alarms.current))
        self._events_sent &= {happened.key for happened in self._state.events}

    def _commands_changed(self) -> None:
        for status in self._state.commands:
            name, stages = status.command.command_id, len(status.stages)
            if self._stages_sent.get(name) != stages:
                self._stages_sent[name] = stages
                self._tell("command", command_document(status))
        if len(self._stages_sent) > len(self._state.commands):
            names = {status.command.command_id for status in self._state.commands}
            self._stages_sent = {name: sent for name, sent in self._stages_sent.items() if name in names}

    def _point(self, curve: str, at: int, value: float) -> None:
        if self._state.time.start_ns is not None and self._curves.add(curve, self._seconds(at), value):
            self._tell_latest(f"curve:{curve}", {"name": curve, "points": self._curves.tail(curve)}, kind="curve")

    def _seconds(self, at: int) -> float:
        return self._state.time.since_start_s(at)

    # --- telling ----------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        while not self._ended.wait(TOLD_EVERY_S):
            self._state.refresh()
            if not self._has_past:
                self._catch_up()
            with self._lock:
                wall = time.monotonic()
                for name in [name for name in self._pending if wall - self._told[name] >= TOLD_EVERY_S]:
                    self._told[name] = wall
                    self._send(self._pending.pop(name))
                clock, state = self._state.time, self._state
                defects, period_s = state.defect_report, state.report_period_s
                if self._alarms.look(state.status, state.link, clock.now(), clock.rate, defects, period_s):
                    self._tell("alarms", documents(self._alarms.current))
                alive = liveness(state)
                if alive.condition is not self._condition or wall - self._told.get("beat", 0.0) >= BEAT_EVERY_S:
                    self._condition = alive.condition
                    self._told["beat"] = wall
                    self._tell("beat", {"liveness": _liveness_document(alive), **self._clock_document()})

    def _tell(self, kind: str, content: Any) -> None:
        self._send(_message(kind, content))

    def _tell_latest(self, name: str, content: Any, kind: str | None = None) -> None:
        text = _message(kind or name, content)
        wall = time.monotonic()
        if wall - self._told.get(name, 0.0) < TOLD_EVERY_S:
            self._pending[name] = text
            return
        self._pending.pop(name, None)
        self._told[name] = wall
        self._send(text)

    def _send(self, text: str) -> None:
        for viewer in self._viewers:
            viewer.loop.call_soon_threadsafe(viewer.put, text)

    # --- documents --------------------------------------------------------------------------------------------------

    def _clock_document(self) -> dict[str, Any]:
        clock = self._state.time
        return {
            "now": clock.now(),
            "rate": clock.rate if clock.state is not None else 0.0,
            "mode": None if clock.state is None else clock.state.mode.value,
            "start_ns": clock.start_ns,
        }

    def _status_document(self) -> dict[str, Any] | None:
        fact = self._state.fact(GROUND_STATUS)
        return None if fact is None else {"at": fact.made_at, **fact.body.model_dump(mode="json")}

    def _link_document(self) -> dict[str, Any] | None:
        fact = self._state.fact(LINK_STATUS)
        if fact is None:
            return None
        wall = time.monotonic()
        for flight in fact.body.in_flight:
            key = (flight.direction, flight.topic, flight.source, flight.sequence, flight.offered_at)
            if flight.arrives_at is not None:
                self._flights[key] = (wall, flight.model_dump(mode="json"))
        self._flights = {key: seen for key, seen in self._flights.items() if wall - seen[0] < FLIGHTS_SHOWN_S}
        shown: dict[str, Any] = fact.body.model_dump(mode="json", exclude={"in_flight", "dropped"})
        shown["in_flight"] = [flight for _, flight in self._flights.values()][-MAX_FLIGHTS:]
        return {"at": fact.made_at, **shown}

    def _rover_document(self) -> dict[str, Any] | None:
        fact = self._state.fact(STATE)
        return None if fact is None else {"made_at": fact.made_at, **fact.body.model_dump(mode="json")}

    def _document(self) -> dict[str, Any]:
        return {
            "mission": self.mission.mission,
            "earth": self.mission.earth,
            "clock": self._clock_document(),
            "status": self._status_document(),
            "rover": self._rover_document(),
            "link": self._link_document(),
            "commands": [command_document(status) for status in self._state.commands],
            "events": [_event_document(happened) for happened in self._state.events],
            "curves": self._curves.document(),
            "alarms": documents(self._alarms.current),
            "liveness": _liveness_document(liveness(self._state)),
        }


def _event_document(happened: Happened) -> dict[str, Any]:
    return {
        "received_at": happened.received_at,
        **happened.event.model_dump(mode="json", exclude={"samples_done"}),
    }


def _liveness_document(alive: Liveness) -> dict[str, str]:
    return {"condition": alive.condition.value, "text": alive.text}


def command_document(status: CommandStatus) -> dict[str, Any]:
    """The command with its stages, its sender's name, and the stage that ended it."""
    return {
        **status.model_dump(mode="json"),
        "by": status.command.by,
        "end": None if status.end is None else status.end.stage.value,
    }


def _message(kind: str, content: Any) -> str:
    return f"event: {kind}\ndata: {json.dumps(content)}\n\n"

"""The page's data, kept once for all browsers, and sent to each of them when it changes.

The mission's facts are those of `MissionState`; the hub adds the curves of the charts and the alarms. Zenoh's threads
enter through `_changed`, which only notes what is new. One thread sends it, a few times a second: of a status that
changes often only the last one, and of that only the fields that are others than before.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Protocol

from he3.errors import He3Error, InvalidInput
from schemas.topics import (
    COMMAND_STATUS,
    EARTH_CLOCK,
    EVENT,
    GROUND_STATUS,
    INTERESTS,
    LINK_STATUS,
    LOG_ENTRY,
    STATE,
    Topic,
)
from services.console.client.alarms import Alarms, documents
from services.console.client.contacts import contacts_ahead
from services.console.client.liveness import Condition, Liveness, liveness
from services.console.web.curves import NAMES, Curves
from services.console.web.last_map import LastMap
from services.console.web.rehearsals import Rehearsals
from services.console.web.stacks import PageStacks
from services.mission.mission_time import SECOND, MissionTime, seconds

if TYPE_CHECKING:
    from schemas.commands import CommandStatus
    from schemas.link import LinkEvent
    from schemas.mission_log import AlarmKind
    from services.console.client.mission_client import MissionClient
    from services.console.client.mission_state import Happened, MissionState
    from services.console.web.rehearsals import Rehearse

MAX_VIEWERS = 100
MAX_WAITING = 400
"""Queue length of a browser; beyond it the stream ends, and the browser reconnects and receives everything anew."""
LOOK_EVERY_S = 0.1
"""Wall time between two looks at what is new: events, commands and alarms are sent with the next one [s]."""
TOLD_EVERY_S = {"status": 0.5, "rover": 0.5, "link": 0.5, "curves": 2.0}
"""What changes often is sent no more often than this [s of wall time]."""
BEAT_EVERY_S = 1.0
FLIGHTS_SHOWN_S = 0.5
"""A message in flight is shown for at least this time, because it may arrive before the next status is sent."""
MAX_FLIGHTS = 100
MAX_LINK_EVENTS = 500
"""Newest changes of the link, and of contact, that a browser gets."""


class Recording(Protocol):
    """A recorded mission whose present time can be set."""

    @property
    def begin_ns(self) -> MissionTime: ...

    @property
    def end_ns(self) -> MissionTime: ...

    @property
    def now_ns(self) -> MissionTime: ...

    @property
    def pace(self) -> float: ...

    @property
    def notes(self) -> tuple[str, ...]: ...

    def held(self) -> AbstractContextManager[None]: ...

    def jump(self, at: MissionTime) -> None: ...

    def set_pace(self, pace: float) -> None: ...

    def on_time(self, look: Callable[[], None]) -> None: ...


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

    def __init__(
        self, mission: MissionClient, recording: Recording | None = None, rehearse: Rehearse | None = None
    ) -> None:
        """recording: the mission, if it is a recorded one with a time that can be set; then there is no `rehearse`."""
        self.mission = mission
        self.recording = recording
        first = 1 + secrets.randbelow(2**48)  # a page that outlives its server takes no other for what it knows
        self.stacks = PageStacks.of(mission, self._stack_changed, first)
        self.rehearsals = Rehearsals(mission, rehearse, first)
        self.last_map = LastMap(mission)
        self._lock = threading.RLock()
        self._viewers: set[Viewer] = set()
        self._ended = threading.Event()
        self._state: MissionState = mission.state(self._changed, follow=False)
        self._start_afresh()

    def _start_afresh(self) -> None:
        self._alarms = Alarms()
        self._curves = Curves()
        self._flights: dict[tuple[Any, ...], tuple[float, dict[str, Any]]] = {}
        self._new: list[tuple[str, Any]] = []
        self._dirty: set[str] = set()
        self._told_at: dict[str, float] = {}
        self._told: dict[str, dict[str, Any]] = {}
        self._curves_told: dict[str, float] = {}
        self._events_sent: set[tuple[Any, ...]] = set()
        self._entries_sent: set[int] = set()
        self._modes_sent = 0
        self._link_events: dict[tuple[int, str], LinkEvent] = {}
        self._stages_sent: dict[str, int] = {}
        self._has_past = self.recording is not None
        self._condition: Condition | None = None
        self._whole = True  # everything is sent with the next look

    def begin(self) -> None:
        """Subscribe, and query the mission's past."""
        if self.recording is not None:
            self.recording.on_time(self._time_passes)
        else:
            self.last_map.follow()
        self._state.follow()
        if not self._has_past:
            self._catch_up()
        threading.Thread(target=self._keep_looking, name="web-look", daemon=True).start()

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
                self._whole = True

    def close(self) -> None:
        """End every browser's stream, and the stack and the rehearsal under way."""
        self._ended.set()
        self.stacks.close()
        self.rehearsals.close()
        with self._lock:
            for viewer in self._viewers:
                viewer.loop.call_soon_threadsafe(viewer.put, None)

    @property
    def warning(self) -> str | None:
        """In one line, that processes of the mission are open to everyone; None if none is."""
        names = ", ".join(self._state.insecure)
        return f"INSECURE: {names} without TLS off loopback" if names else None

    def play(self, at_s: float | None, pace: float | None) -> dict[str, Any]:
        """Set the time of the recording [s since its beginning], and its pace; every browser then shows that time.

        Returns the time and the pace. Raises InvalidInput for what the recording does not have.
        """
        if self.recording is None:
            raise InvalidInput("expected a recording, got a running mission, whose time cannot be set")
        with self.recording.held(), self._lock:
            if pace is not None:
                self.recording.set_pace(pace)
            if at_s is not None:
                self.recording.jump(self.recording.begin_ns + seconds(at_s))
                self._whole = True
            self._look()
            return self._recording_document(self.recording)

    # --- browsers ---------------------------------------------------------------------------------------------------

    def enter(self, viewer: Viewer) -> bool:
        """Send this browser all data, and every change from now on; False if there are too many browsers."""
        with self._lock:
            if len(self._viewers) >= MAX_VIEWERS:
                return False
            self._look()  # what is new is in the document: this browser is not to hear it twice
            viewer.queue.put_nowait(_message("state", self._document()))
            self._viewers.add(viewer)
            return True

    def leave(self, viewer: Viewer) -> None:
        with self._lock:
            self._viewers.discard(viewer)

    def is_raised(self, kind: AlarmKind) -> bool:
        """Whether there is an alarm of that kind that a person may acknowledge or shelve."""
        with self._lock:
            return any(alarm.kind is kind for alarm in self._alarms.current)

    # --- what changes, in the session's threads ---------------------------------------------------------------------

    def _changed(self, topic: Topic | None) -> None:
        with self._lock:
            if topic is None:
                self._start_afresh()
                self.last_map.forget()
                self.last_map.follow()
            elif topic is GROUND_STATUS:
                self._status_changed()
            elif topic is LINK_STATUS:
                self._link_changed()
            elif topic is EARTH_CLOCK:
                self._dirty.add("clock")
            elif topic is STATE:
                self._rover_changed()
            elif topic is EVENT:
                self._events_changed()
            elif topic is LOG_ENTRY:
                self._entries_changed()
            elif topic is INTERESTS:
                self._dirty.add("interests")
            elif topic is COMMAND_STATUS:
                self._dirty.add("commands")

    def _status_changed(self) -> None:
        fact = self._state.fact(GROUND_STATUS)
        if fact is None:
            return
        if fact.body.mean_std_ppb is not None:
            self._point("mean_std_ppb", fact.made_at, fact.body.mean_std_ppb)
        if fact.body.score is not None:
            self._point("rmse_ppb", fact.made_at, fact.body.score.rmse_ppb)
        self._dirty |= {"status", "rover"}

    def _rover_changed(self) -> None:
        fact = self._state.fact(STATE)
        if fact is None:
            return
        self._point("energy_wh", fact.made_at, fact.body.energy_wh)
        self._point("queue", fact.made_at, float(fact.body.queue_depth))
        self._dirty.add("rover")
        modes = self._state.modes
        self._new += [("mode", change.model_dump(mode="json")) for change in modes[self._modes_sent :]]
        self._modes_sent = len(modes)

    def _events_changed(self) -> None:
        for happened in self._state.events:
            if happened.key not in self._events_sent:
                self._events_sent.add(happened.key)
                self._new.append(("event", _event_document(happened)))
                if self._alarms.happened(happened.event):
                    self._dirty.add("alarms")
        self._events_sent &= {happened.key for happened in self._state.events}

    def _entries_changed(self) -> None:
        for entry in self._state.entries:
            if entry.number not in self._entries_sent:
                self._entries_sent.add(entry.number)
                self._new.append(("entry", entry.model_dump(mode="json")))
                if self._alarms.logged(entry):
                    self._dirty.add("alarms")

    def _link_changed(self) -> None:
        link = self._state.link
        if link is None:
            return
        for event in link.events:
            self._link_events.setdefault((event.at, event.what), event)
        self._dirty |= {"link", "contacts"}

    def _stack_changed(self) -> None:
        with self._lock:
            self._dirty.add("stack")

    def _commands_changed(self) -> None:
        for status in self._state.commands:
            name, stages = status.command.command_id, len(status.stages)
            if self._stages_sent.get(name) != stages:
                self._stages_sent[name] = stages
                self._new.append(("command", command_document(status)))
        if len(self._stages_sent) > len(self._state.commands):
            names = {status.command.command_id for status in self._state.commands}
            self._stages_sent = {name: sent for name, sent in self._stages_sent.items() if name in names}

    def _point(self, curve: str, at: int, value: float) -> None:
        if self._state.time.start_ns is not None and self._curves.add(curve, self._seconds(at), value):
            self._dirty.add("curves")

    def _seconds(self, at: int) -> float:
        return self._state.time.since_start_s(at)

    # --- telling ----------------------------------------------------------------------------------------------------

    def _keep_looking(self) -> None:
        while not self._ended.wait(LOOK_EVERY_S):
            self._state.refresh()
            if self.recording is None:
                self.last_map.look(self._state.status)
            if not self._has_past:
                self._catch_up()
            with self._lock:
                self._look()

    def _time_passes(self) -> None:
        with self._lock:
            clock, state = self._state.time, self._state
            defects, period_s = state.defect_report, state.report_period_s
            if self._alarms.look(state.status, state.link, clock.now(), clock.recent_rate, defects, period_s):
                self._dirty.add("alarms")

    def _look(self) -> None:
        """Send what is new, in one piece."""
        self._time_passes()
        wall = time.monotonic()
        alive = liveness(self._state)
        beats = alive.condition is not self._condition or wall - self._told_at.get("beat", 0.0) >= BEAT_EVERY_S
        if beats:
            self._condition, self._told_at["beat"] = alive.condition, wall
        if self._whole:
            self._send(_message("state", self._document()))
            self._forget_what_is_new(wall)
            return
        if "commands" in self._dirty:
            self._commands_changed()
        parts = [_message(kind, content) for kind, content in self._new]
        self._new.clear()
        parts += [part for name in sorted(self._dirty) if (part := self._part(name, wall)) is not None]
        if beats:
            parts.append(_message("beat", {"liveness": self._liveness_document(alive), **self._clock_document()}))
        if parts:
            self._send("".join(parts))

    def _part(self, name: str, wall: float) -> str | None:
        """The message on what has changed; None if that was told a moment ago, and the next look tells it."""
        every_s = TOLD_EVERY_S.get(name, 0.0)
        if wall - self._told_at.get(name, -every_s) < every_s:
            return None
        self._told_at[name] = wall
        self._dirty.discard(name)
        match name:
            case "clock":
                return _message("clock", self._clock_document())
            case "alarms":
                return _message("alarms", self._alarms_document())
            case "curves":
                return "".join(_message("curve", each) for each in self._new_points())
            case "interests":
                fact = self._state.fact(INTERESTS)
                return None if fact is None else _message("interests", fact.body.model_dump(mode="json"))
            case "stack":
                return _message("stack", {"stack": self.stacks.document()})
            case "commands":
                return None  # they are among what is new
        document = self._documents()[name]() or {}
        before = self._told.get(name, {})
        self._told[name] = document
        changed = {key: value for key, value in document.items() if key not in before or before[key] != value}
        changed |= dict.fromkeys(before.keys() - document.keys())
        return _message(name, changed) if changed else None

    def _new_points(self) -> Iterator[dict[str, Any]]:
        """Of each curve that has grown the points since the last one but one that was sent: the last one may move."""
        for name in NAMES:
            points = self._curves.since(name, self._curves_told.get(name, -1.0))
            if points:
                self._curves_told[name] = points[max(0, len(points) - 2)][0]
                yield {"name": name, "points": points}

    def _forget_what_is_new(self, wall: float) -> None:
        """All of it has been sent."""
        self._whole = False
        self._commands_changed()
        self._new.clear()
        self._dirty.clear()
        for name, document in self._documents().items():
            self._told[name] = document() or {}
            self._told_at[name] = wall
        for name in NAMES:
            points = self._curves.tail(name)
            self._curves_told[name] = points[max(0, len(points) - 2)][0] if points else -1.0

    def _send(self, text: str) -> None:
        for viewer in self._viewers:
            viewer.loop.call_soon_threadsafe(viewer.put, text)

    # --- documents --------------------------------------------------------------------------------------------------

    def _clock_document(self) -> dict[str, Any]:
        clock = self._state.time
        return {
            "now": clock.now(),
            "rate": clock.pace,
            "mode": None if clock.state is None else clock.state.mode.value,
            "start_ns": clock.start_ns,
        }

    def _documents(self) -> dict[str, Callable[[], dict[str, Any] | None]]:
        """The documents of which only the fields that have changed are sent."""
        return {
            "status": self._status_document,
            "rover": self._rover_document,
            "link": self._link_document,
            "contacts": self._contacts_document,
        }

    def _liveness_document(self, alive: Liveness) -> dict[str, str]:
        text = alive.text if self.recording is None else f"recording; then {alive.text}"
        return {"condition": alive.condition.value, "text": text}

    def _recording_document(self, recording: Recording) -> dict[str, Any]:
        begin = recording.begin_ns
        return {
            "at_s": (recording.now_ns - begin) / SECOND,
            "length_s": (recording.end_ns - begin) / SECOND,
            "begin_ns": begin,
            "pace": recording.pace,
            "notes": list(recording.notes),
        }

    def _status_document(self) -> dict[str, Any] | None:
        fact = self._state.fact(GROUND_STATUS)
        if fact is None:
            return None
        return {"at": fact.made_at, **fact.body.model_dump(mode="json", exclude={"rover", "rover_made_at"})}

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
        shown: dict[str, Any] = fact.body.model_dump(
            mode="json", exclude={"in_flight", "dropped", "commands_arrived", "events"}
        )
        shown["in_flight"] = [flight for _, flight in self._flights.values()][-MAX_FLIGHTS:]
        return {"at": fact.made_at, **shown}

    def _contacts_document(self) -> dict[str, Any] | None:
        """What changed on the link, and the contacts to come; None while the mission's beginning is not known."""
        link, start_ns = self._state.link, self._state.time.start_ns
        if link is None or start_ns is None:
            return None
        return {
            "events": [event.model_dump(mode="json") for event in self._link_events.values()][-MAX_LINK_EVENTS:],
            "ahead": contacts_ahead(link, start_ns, self._state.time.now()),
        }

    def _alarms_document(self) -> dict[str, Any]:
        return {"current": documents(self._alarms.current), "history": documents(self._alarms.history)}

    def _rover_document(self) -> dict[str, Any] | None:
        fact, status = self._state.fact(STATE), self._state.status
        if fact is not None:
            return {"made_at": fact.made_at, **fact.body.model_dump(mode="json")}
        if status is None or status.rover is None:
            return None
        return {"made_at": status.rover_made_at, **status.rover.model_dump(mode="json")}

    def _document(self) -> dict[str, Any]:
        return {
            "mission": self.mission.mission,
            "earth": self.mission.earth,
            "clock": self._clock_document(),
            "recording": None if self.recording is None else self._recording_document(self.recording),
            "status": self._status_document(),
            "rover": self._rover_document(),
            "link": self._link_document(),
            "commands": [command_document(status) for status in self._state.commands],
            "events": [_event_document(happened) for happened in self._state.events],
            "curves": self._curves.document(),
            "entries": [entry.model_dump(mode="json") for entry in self._state.entries],
            "modes": [change.model_dump(mode="json") for change in self._state.modes],
            "contacts": self._contacts_document(),
            "alarms": self._alarms_document(),
            "liveness": self._liveness_document(liveness(self._state)),
            "stack": self.stacks.document(),
        }


def _event_document(happened: Happened) -> dict[str, Any]:
    return {
        "received_at": happened.received_at,
        **happened.event.model_dump(mode="json", exclude={"samples_done"}),
    }


def command_document(status: CommandStatus) -> dict[str, Any]:
    """The command with its stages, its sender's name, and the stage that ended it."""
    return {
        **status.model_dump(mode="json"),
        "by": status.command.by,
        "end": None if status.end is None else status.end.stage.value,
    }


def _message(kind: str, content: Any) -> str:
    return f"event: {kind}\ndata: {json.dumps(content, separators=(',', ':'))}\n\n"

"""The newest facts of a mission, kept for a display: status, link, clock, rover, commands, events, heartbeats.

Messages may be overtaken, repeated, or come from a process that is gone. A fact replaces an older one of its topic only
if it is newer (`supersedes`). A mission that is started anew at the same endpoint has another link process and an
earlier mission time; all facts are then dropped.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from he3.errors import He3Error
from schemas.commands import CommandStatus, NoParameters
from schemas.mission_log import MAX_ENTRIES, MAX_MODES, ModeChange, mode_change
from schemas.topics import (
    COMMAND_STATUS,
    EARTH_CLOCK,
    EARTH_PRESENCE,
    EVENT,
    GROUND_STATUS,
    INTERESTS,
    LINK_STATUS,
    LIST_COMMANDS,
    LOG_ENTRY,
    SHOW_LOG,
    STATE,
    Crosses,
    Topic,
)
from services.console.client.clock import MissionClock, time_shown
from services.console.client.staleness import PROCESS_SILENT_S, SILENT_S, STATE_PERIOD_S
from services.mission.mission_time import SECOND, MissionTime, seconds

if TYPE_CHECKING:
    from schemas.ground import GroundStatus, Presence
    from schemas.link import ClockState, LinkStatus
    from schemas.mission_log import LogEntry, MissionLog
    from schemas.telemetry import RoverEvent, RoverMode, RoverState
    from schemas.wire import Header
    from services.runtime.transport.client import Client

ANSWER_WITHIN_S = 10.0
"""Longest wall time for the answer of a live process; queries to an ended one end at once."""
MAX_EVENTS = 1000
REPORT_GAPS, MIN_REPORT_GAPS = 9, 2
"""Intervals between reports of the rover's state from which their period is told, and the fewest that tell it."""
MAX_COMMANDS = 300  # the newest, as the ground lists them
KEPT: tuple[Topic, ...] = (EARTH_CLOCK, GROUND_STATUS, LINK_STATUS)
"""Topics whose last message can be queried."""
FOLLOWED: tuple[Topic, ...] = (*KEPT, EARTH_PRESENCE, STATE, EVENT, COMMAND_STATUS, INTERESTS, LOG_ENTRY)
STATUS_AGAIN_S = 3.0
"""Wall time without the ground's status after which it is queried, because the last one may have been lost."""
TIMEKEEPER, GROUND = "link", "ground"
"""Names of processes. The first keeps mission time; its process id distinguishes one run of a mission from the next."""
SET_BACK_S = 1.0
"""Wall time by which mission time must lie behind earlier messages to count as another mission's."""


@dataclass(frozen=True, slots=True)
class Fact:
    """The newest message of a topic."""

    header: Header
    body: Any

    @property
    def made_at(self) -> MissionTime:
        return self.header.made_at


@dataclass(frozen=True, slots=True)
class Happened:
    """An event of the rover, and when it reached this session."""

    event: RoverEvent
    received_at: MissionTime

    @property
    def key(self) -> tuple[str, MissionTime, str | None, str]:
        """What tells it from every other event of the mission; the same for every repetition."""
        return self.event.kind.value, self.event.at, self.event.sample_id, self.event.detail


def supersedes(header: Header, last: Header) -> bool:
    """Whether a message is newer than the last of its topic.

    Within one start of a process mission time decides, then the sequence; a later start counts more, as does a message
    of an earlier start that was made later (the wall clock that numbers the starts may have been set back).
    """
    if header.incarnation == last.incarnation:
        return (header.made_at, header.sequence) >= (last.made_at, last.sequence)
    return header.incarnation > last.incarnation or header.made_at > last.made_at


class MissionState:
    """The newest facts of a running mission, kept up to date by the session's threads.

    on_change: called, in those threads and without a lock, with the topic whose newest fact has changed; None: all of
    them, as the mission was started anew.
    """

    def __init__(
        self,
        session: Client,
        on_change: Callable[[Topic | None], None] | None = None,
        start_ns: MissionTime | None = None,
    ) -> None:
        self._session = session
        self._on_change = on_change
        self._start_ns = start_ns
        self._lock = threading.Lock()
        self.changed = threading.Event()
        """Set with every change; a reader that waits for it clears it."""
        self._heard_wall = self._status_wall = time.monotonic()
        self._process: tuple[str, int, int] | None = None
        self._other_timekeeper = False
        self._forget()

    def _forget(self) -> None:
        self.time = self._clock_of(self._start_ns)
        self._facts: dict[Topic, Fact] = {}
        self._events: deque[Happened] = deque(maxlen=MAX_EVENTS)
        self._entries: dict[int, LogEntry] = {}
        self._modes: list[ModeChange] = []
        self._commands: dict[str, CommandStatus] = {}
        self._presence: dict[str, tuple[float, Presence]] = {}
        self._report_gaps_s: deque[float] = deque(maxlen=REPORT_GAPS)

    def _clock_of(self, start_ns: MissionTime | None) -> MissionClock:
        """Mission time, as this state tells it."""
        return MissionClock(start_ns)

    def follow(self, timeout_s: float = ANSWER_WITHIN_S) -> None:
        """Subscribe, and query the last messages; a process that does not answer is left out.

        timeout_s: wall time for each question.
        """
        with suppress(He3Error):  # the clock first: other facts are placed on the time since the mission's beginning
            self._take(EARTH_CLOCK, *self._session.latest(EARTH_CLOCK, timeout_s))
        self._subscribe()
        self.catch_up(timeout_s)

    def _subscribe(self) -> None:
        for topic in FOLLOWED:
            self._session.subscribe(topic, self._keeper(topic))

    def catch_up(self, timeout_s: float = ANSWER_WITHIN_S) -> None:
        """Query the newest facts."""
        for topic in KEPT:
            with suppress(He3Error):
                self._take(topic, *self._session.latest(topic, timeout_s))
        with suppress(He3Error):
            for status in self._session.query(LIST_COMMANDS, NoParameters(), timeout_s).commands:
                self._take(COMMAND_STATUS, None, status)
        with suppress(He3Error):
            self._take_log(self._session.query(SHOW_LOG, NoParameters(), timeout_s))

    def refresh(self) -> None:
        """If another process keeps time, check whether the mission was started anew; then drop all facts and query.

        A status of the ground that is missing is queried. Call it periodically from a thread that may block.
        """
        self._ask_for_status()
        if not self._other_timekeeper:
            return
        try:
            header, clock = self._session.latest(EARTH_CLOCK, 2.0)
        except He3Error:
            return  # it is still starting; the next call asks again
        self._other_timekeeper = False
        if time_shown(header, clock) < self.time.now() - seconds(SET_BACK_S * max(1.0, self.time.rate)):
            self._start_afresh()
        self.catch_up()

    def _ask_for_status(self) -> None:
        """Query the ground's status if none came for long: on a thin line one may be lost; the last is not repeated."""
        wall, silent_s = time.monotonic(), self.process_silent_s(GROUND)
        if silent_s is None or silent_s > PROCESS_SILENT_S or wall - self._status_wall < STATUS_AGAIN_S:
            return
        if self.status is None or not self.status.is_over:
            self._status_wall = wall
            with suppress(He3Error):
                self._take(GROUND_STATUS, *self._session.latest(GROUND_STATUS, 1.0))

    def _start_afresh(self) -> None:
        """Drop all facts, and say so."""
        with self._lock:
            self._forget()
        self.changed.set()
        if self._on_change is not None:
            self._on_change(None)

    # --- what is known ----------------------------------------------------------------------------------------------

    def fact(self, topic: Topic) -> Fact | None:
        """The newest message of that topic, one of ``FOLLOWED``; None while there is none."""
        assert topic in FOLLOWED, f"expected a topic among FOLLOWED, got {topic.name}"
        return self._facts.get(topic)

    @property
    def status(self) -> GroundStatus | None:
        status: GroundStatus | None = self._body(GROUND_STATUS)
        return status

    @property
    def link(self) -> LinkStatus | None:
        link: LinkStatus | None = self._body(LINK_STATUS)
        return link

    @property
    def clock(self) -> ClockState | None:
        return self.time.state

    @property
    def rover(self) -> RoverState | None:
        rover: RoverState | None = self._body(STATE)
        return rover

    @property
    def commands(self) -> tuple[CommandStatus, ...]:
        """All commands with their stages, oldest first."""
        with self._lock:
            return tuple(sorted(self._commands.values(), key=lambda each: each.stages[0].at if each.stages else 0))

    @property
    def events(self) -> tuple[Happened, ...]:
        """The last events of the rover, oldest first, each once."""
        with self._lock:
            return tuple(self._events)

    @property
    def entries(self) -> tuple[LogEntry, ...]:
        """The entries of the ground's log, oldest first."""
        with self._lock:
            return tuple(self._entries[number] for number in sorted(self._entries))

    @property
    def modes(self) -> tuple[ModeChange, ...]:
        """The changes of the rover's mode, oldest first."""
        with self._lock:
            return tuple(self._modes)

    @property
    def status_time_s(self) -> float:
        """Mission time since the beginning [s] at which the ground's last status was made."""
        fact = self._facts.get(GROUND_STATUS)
        return 0.0 if fact is None else self.time.since_start_s(fact.made_at)

    @property
    def silent_s(self) -> float:
        """Wall time since the last message of any kind [s]."""
        return time.monotonic() - self._heard_wall

    def process_silent_s(self, name: str) -> float | None:
        """Wall time since the last heartbeat of that process on Earth [s]; None if none was ever heard."""
        heard = self._presence.get(name)
        return None if heard is None else time.monotonic() - heard[0]

    @property
    def report_period_s(self) -> float:
        """Mission time between two reports of the rover's state [s], as heard.

        The median: lost reports make some intervals longer, a change of the rover's mode makes two of one.
        """
        with self._lock:
            gaps = sorted(self._report_gaps_s)
        return gaps[len(gaps) // 2] if len(gaps) >= MIN_REPORT_GAPS else STATE_PERIOD_S

    @property
    def rover_age_s(self) -> float | None:
        """Mission time since the newest state of the rover was made [s]; None while there is none."""
        made_at = [fact.made_at for fact in (self._facts.get(STATE),) if fact is not None]
        if self.status is not None and self.status.rover_made_at is not None:
            made_at.append(self.status.rover_made_at)
        return self.time.age_s(max(made_at)) if made_at else None

    @property
    def insecure(self) -> tuple[str, ...]:
        """Names of the processes that use an endpoint off loopback without TLS."""
        return tuple(sorted(name for name, (_, presence) in self._presence.items() if presence.insecure))

    @property
    def defects(self) -> dict[str, int]:
        """How many messages each process has set aside because it failed upon them; without those that have none."""
        return {name: presence.defects for name, (_, presence) in self._presence.items() if presence.defects}

    @property
    def defect_report(self) -> str:
        """One line on the messages that processes have set aside; empty if there are none."""
        counts = ", ".join(f"{name} {count}" for name, count in sorted(self.defects.items()))
        return f"messages set aside upon which a process failed (see its log): {counts}" if counts else ""

    @property
    def is_silent(self) -> bool:
        """Whether no message has arrived for longer than the heartbeat period allows."""
        return self.silent_s > SILENT_S

    @property
    def knows_nothing(self) -> bool:
        """Whether no message or answer has arrived at all."""
        return not self._facts and not self._presence

    def _body(self, topic: Topic) -> Any:
        fact = self._facts.get(topic)
        return None if fact is None else fact.body

    # --- what comes, in the session's threads -----------------------------------------------------------------------

    def _keeper(self, topic: Topic) -> Callable[[Header, Any], None]:
        return lambda header, body: self._take(topic, header, body)

    def _take(self, topic: Topic, header: Header | None, body: Any) -> None:
        """Keep a new fact; header: None for an entry of the list of commands."""
        with self._lock:
            self._heard_wall = time.monotonic()
            if topic is GROUND_STATUS:
                self._status_wall = self._heard_wall
            if (
                header is not None and topic.crosses is not Crosses.DOWN
            ):  # those were made on the Moon, a light time ago
                self.time.hear(header.made_at)
            new = self._is_kept(topic, header, body)
        self.changed.set()
        if new and self._on_change is not None:
            self._on_change(topic)

    def _is_kept(self, topic: Topic, header: Header | None, body: Any) -> bool:
        if topic is COMMAND_STATUS:
            name = body.command.command_id
            known = self._commands.get(name)
            if known is not None and len(known.stages) > len(body.stages):
                return False  # stages are only ever added
            self._commands[name] = body
            if len(self._commands) > MAX_COMMANDS:
                ended = (each for each, status in self._commands.items() if status.end is not None)
                del self._commands[next(ended, next(iter(self._commands)))]
            return True
        assert header is not None, "only the list of commands comes without headers"
        if topic is EARTH_PRESENCE:
            if body.name != header.source:
                return False
            self._presence[body.name] = (time.monotonic(), body)
            if body.name == TIMEKEEPER:
                process = (body.host, body.pid, body.incarnation)
                self._other_timekeeper |= self._process not in (None, process)
                self._process = process
            return True
        if topic is EVENT:
            happened = Happened(body, self.time.now())
            if any(each.key == happened.key for each in self._events):
                return False  # repeated, as custody does until it is acknowledged
            self._events.append(happened)
            return True
        if topic is LOG_ENTRY:
            new = body.number not in self._entries
            self._entries[body.number] = body
            if len(self._entries) > MAX_ENTRIES:
                del self._entries[min(self._entries)]
            return new
        last = self._facts.get(topic)
        if last is not None and not supersedes(header, last.header):
            return False
        self._facts[topic] = Fact(header, body)
        if topic is STATE:
            reported_at = None if last is None else last.made_at
            self._note_mode(body.mode, reported_at, header.made_at, self.time.now())
        if (
            topic is STATE
            and last is not None
            and header.incarnation == last.header.incarnation
            and header.made_at > last.made_at  # not the same report once more
        ):
            self._report_gaps_s.append((header.made_at - last.made_at) / SECOND)
        if topic is EARTH_CLOCK:
            self.time.follow(body)
        return True

    def _note_mode(
        self, mode: RoverMode, reported_at: MissionTime | None, made_at: MissionTime, now: MissionTime
    ) -> None:
        change = mode_change(self._modes[-1] if self._modes else None, reported_at, mode, made_at, now)
        if change is not None:
            self._modes.append(change)
            del self._modes[:-MAX_MODES]

    def _take_log(self, log: MissionLog) -> None:
        """Put what the ground has logged before what this session has heard."""
        with self._lock:
            known = {each.key for each in self._events}
            logged = [Happened(heard.event, heard.received_at) for heard in log.events]
            earlier = [each for each in logged if each.key not in known]
            self._events = deque([*earlier, *self._events], maxlen=MAX_EVENTS)
            newest = log.modes[-1].made_at if log.modes else 0
            self._modes = [*log.modes, *(change for change in self._modes if change.made_at > newest)]
            self._entries = {**{entry.number: entry for entry in log.entries}, **self._entries}
        self.changed.set()
        if self._on_change is not None:
            for topic in (EVENT, LOG_ENTRY):
                self._on_change(topic)

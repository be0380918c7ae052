"""A session with a recorded mission: what `services.runtime.transport.client.Client` is to a running one.

It answers the queries of a reader from what was heard by the present time of the recording, and delivers messages as
that time goes by. Everything that would change a mission is refused: a recording cannot be commanded.
"""

from __future__ import annotations

import secrets
import threading
import time
from typing import TYPE_CHECKING, Any, Final

from he3.errors import InvalidInput, NotAllowed, NotFound, NotReady
from schemas.commands import CommandList
from schemas.ground import InterestList
from schemas.link import ClockMode, ClockState
from schemas.mission_log import MAX_ENTRIES, MAX_EVENTS, MAX_MODES, HeardEvent, MissionLog, ModeChange, mode_change
from schemas.plans import PlanReview
from schemas.topics import (
    ALIVE,
    COMMAND_STATUS,
    EARTH_CLOCK,
    EVENT,
    INTERESTS,
    LINK_SHOW,
    LINK_STATUS,
    LIST_COMMANDS,
    LIST_INTERESTS,
    LOG_ENTRY,
    MAP_FEED,
    SHOW_LOG,
    SHOW_PLAN,
    STATE,
    Side,
    Topic,
)
from schemas.wire import Header
from services.console.client.mission_state import MAX_COMMANDS, supersedes
from services.ground.map.service import MAP_TOPICS
from services.mission.mission_time import SECOND, MissionTime
from services.runtime.machine_time import this_machine
from services.runtime.queries.server import Encoded
from services.runtime.transport.client import Client
from services.runtime.transport.request import request_from_selector

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from schemas.commands import CommandStatus
    from schemas.wire import Wire
    from services.console.replay.maps import RecordedMaps
    from services.console.replay.tape import Heard, Tape

MAX_PACE: Final = 100_000.0
"""Mission seconds per wall second at which a recording is played, at most."""
LOOK_EVERY_NS: Final = 10 * SECOND
"""Mission time after which a listener of time is called again, where messages are further apart."""
EPOCH_BITS: Final = 52
MOST_LOOKS: Final = 20_000
"""So many times in a whole recording, at most."""

Listener = tuple["Topic", "Callable[[Header, Any], None]"]


class PlayedTime:
    """The present time of a recording: it goes at any pace, stands still, or is set; it ends with the recording."""

    def __init__(self, begin: MissionTime, end: MissionTime, wall_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.begin, self.end = begin, max(begin, end)
        self._wall_ns = wall_ns
        self._pace = 0.0
        self._anchor = wall_ns(), begin
        self._changes = 0
        self.epoch = 1 + secrets.randbits(EPOCH_BITS)
        """Identifies this clock among those that a process may follow."""

    @property
    def pace(self) -> float:
        """Mission seconds per wall second; 0 while it stands still, and at the end."""
        return self._pace if self.now() < self.end else 0.0

    @property
    def revision(self) -> int:
        """Grows with every change of the pace, and when the end is reached."""
        return 2 * self._changes + (self.now() >= self.end)

    def now(self) -> MissionTime:
        """The present time [ns]."""
        wall, at = self._anchor
        return min(self.end, at + round((self._wall_ns() - wall) * self._pace))

    def set(self, at: MissionTime | None = None, pace: float | None = None) -> None:
        """Continue at that time, or at the present one, at that pace, or at the present one."""
        if pace is not None and not 0 <= pace <= MAX_PACE:
            raise InvalidInput(f"pace: expected 0 to {MAX_PACE:g} mission seconds a second, got {pace:g}")
        if at is not None and not self.begin <= at <= self.end:
            span_s = (self.end - self.begin) / SECOND
            raise InvalidInput(
                f"at: expected a time within the recording, 0 to {span_s:.0f} s after its beginning, got "
                f"{(at - self.begin) / SECOND:.0f} s"
            )
        now = self.now() if at is None else at
        self._changes += 1
        self._pace = self._pace if pace is None else pace
        self._anchor = self._wall_ns(), now


class RecordedSession(Client):
    """A session over a recording. Its methods may be called from any thread."""

    def __init__(self, tape: Tape, maps: RecordedMaps, at: PlayedTime) -> None:
        self._tape = tape
        self._maps = maps
        self.time = at
        self.lock = threading.RLock()
        """Held while messages are delivered; take it before any lock that a listener takes."""
        self._listeners: list[Listener] = []
        self._looks: list[Callable[[], None]] = []
        self._delivered = 0
        self._instant = threading.local()
        self._looked_at: MissionTime = at.begin
        self._look_every = max(LOOK_EVERY_NS, (at.end - at.begin) // MOST_LOOKS)

    def close(self) -> None:
        """Nothing is open."""

    # --- time -------------------------------------------------------------------------------------------------------

    def now(self) -> MissionTime:
        """The present time [ns]; for a listener, the time at which the message was received."""
        instant: MissionTime | None = getattr(self._instant, "at", None)
        return self.time.now() if instant is None else instant

    def on_time(self, look: Callable[[], None]) -> None:
        """Call `look` as time goes by, at least once in `LOOK_EVERY_NS` and before each message."""
        self._looks.append(look)

    def play(self) -> None:
        """Deliver what was received by the present time."""
        with self.lock:
            now = self.time.now()
            count = self._tape.heard_by(now)
            if count > self._delivered:
                self._deliver(count)

    def begin_again(self) -> None:
        """Deliver the messages from the first one on with the next `play`."""
        with self.lock:
            self._delivered, self._looked_at = 0, self.time.begin

    def _deliver(self, count: int) -> None:
        try:
            for heard in self._tape.messages[self._delivered : count]:
                while heard.at - self._looked_at > self._look_every:
                    self._look_at(self._looked_at + self._look_every)
                self._look_at(heard.at)
                for topic, listener in list(self._listeners):
                    if topic is heard.topic:
                        listener(heard.header, heard.body)
                for look in self._looks:
                    look()
        finally:
            self._delivered, self._instant.at = count, None

    def _look_at(self, at: MissionTime) -> None:
        self._instant.at = at
        if at > self._looked_at:
            self._looked_at = at
            for look in self._looks:
                look()

    # --- what a client asks -----------------------------------------------------------------------------------------

    def query(self, topic: Topic, request: Wire, timeout_s: float = 0.0) -> Any:
        """The body of the reply; raises NotAllowed for a query that changes a mission, He3Error for a refusal."""
        if topic in MAP_TOPICS:
            found = self.map_answer(topic, request)
            if isinstance(found, Encoded):
                raise InvalidInput(f"{topic.name}: expected the format json, got another")
            return found
        if topic is LIST_COMMANDS:
            return CommandList(commands=self._commands())
        if topic is LIST_INTERESTS:
            return self._interests()
        if topic is SHOW_LOG:
            return self._log()
        if topic is SHOW_PLAN:
            return PlanReview()  # plans that were not approved are not recorded
        if topic is LINK_SHOW:
            return self.latest(LINK_STATUS)[1]
        raise NotAllowed("expected a running mission, got a recording, which only tells what was")

    def map_answer(self, topic: Topic, request: Wire) -> Wire | Encoded:
        """The reply to a query of the map, in the format that it asks for; raises He3Error."""
        return self._maps.answer(topic, request, self.now())

    def fetch(self, topic: Topic, parameters: Mapping[str, object], timeout_s: float = 0.0) -> tuple[bytes, bytes]:
        """The reply to a query by selector parameters, and its attachment; raises He3Error."""
        if topic not in MAP_TOPICS:
            raise NotAllowed("expected a query of the map, as this is a recording")
        text = {key: str(value) for key, value in parameters.items() if value is not None}
        found = self.map_answer(topic, request_from_selector(topic, text))
        if isinstance(found, Encoded):
            return found.payload, found.about
        return found.model_dump_json().encode(), b""

    def latest(self, topic: Topic, timeout_s: float = 0.0) -> tuple[Header, Any]:
        """Header and body of the newest message of that topic; raises NotReady while there is none."""
        now = self.now()
        if topic is EARTH_CLOCK:
            return self._clock(now)
        last = self._last(topic, now)
        if last is None:
            raise NotReady(f"{topic.name}: nothing was received by this time of the recording")
        return last.header, last.body

    def subscribe(self, topic: Topic, on_message: Callable[[Header, Any], None]) -> Callable[[], None]:
        """Call `on_message(header, body)` with each message as time goes by; returns the function that ends it."""
        entry = (topic, on_message)
        with self.lock:
            self._listeners.append(entry)

        def end() -> None:
            with self.lock:
                self._listeners.remove(entry)

        return end

    def subscribe_raw(self, topic: Topic, on_payload: Callable[[bytes], None]) -> Callable[[], None]:
        """Raise NotFound: the map's feed is not recorded."""
        raise NotFound(f"{MAP_FEED.name}: expected a running mission, got a recording, which has none")

    def watch_alive(self, side: Side, on_change: Callable[[str, bool], None], group: str = ALIVE) -> None:
        """No process is alive."""

    def declare_display(self) -> Callable[[], None]:
        """A recording does not end; there is nothing to declare."""
        return lambda: None

    # --- what was known ---------------------------------------------------------------------------------------------

    def _clock(self, now: MissionTime) -> tuple[Header, ClockState]:
        pace = self.time.pace
        machine = this_machine()
        clock = ClockState(
            mode=ClockMode.WALL, epoch=self.time.epoch, revision=self.time.revision, rate=pace,
            anchor_wall_ns=machine.wall_ns(), anchor_mission_ns=now, start_ns=self._tape.start_ns,
            boot_id=machine.boot_id, anchor_monotonic_ns=machine.monotonic_ns(),
        )  # fmt: skip
        header = Header(mission=self._tape.mission, source="link", incarnation=0, sequence=0, made_at=now)
        return header, clock

    def _last(self, topic: Topic, now: MissionTime) -> Heard | None:
        newest: Heard | None = None
        for heard in self._tape.of(topic, now):
            if newest is None or supersedes(heard.header, newest.header):
                newest = heard
        return newest

    def _commands(self) -> tuple[CommandStatus, ...]:
        known: dict[str, CommandStatus] = {}
        for heard in self._tape.of(COMMAND_STATUS, self.now()):
            name = heard.body.command.command_id
            if name not in known or len(known[name].stages) <= len(heard.body.stages):
                known[name] = heard.body
        return tuple(known.values())[-MAX_COMMANDS:]

    def _log(self) -> MissionLog:
        """The ground's log: its entries, and the rover's events and changes of mode in the order of reception."""
        now = self.now()
        entries = {heard.body.number: heard.body for heard in self._tape.of(LOG_ENTRY, now)}
        events = {
            (heard.header.incarnation, heard.header.sequence): HeardEvent(event=heard.body, received_at=heard.at)
            for heard in reversed(self._tape.of(EVENT, now))  # of repetitions the first one counts
        }
        modes: list[ModeChange] = []
        reported_at: MissionTime | None = None
        for heard in self._tape.of(STATE, now):
            last, made_at = modes[-1] if modes else None, heard.header.made_at
            if change := mode_change(last, reported_at, heard.body.mode, made_at, heard.at):
                modes.append(change)
            reported_at = max(made_at, reported_at or 0)
        return MissionLog(
            entries=tuple(entries[number] for number in sorted(entries))[-MAX_ENTRIES:],
            events=tuple(reversed(events.values()))[-MAX_EVENTS:],
            modes=tuple(modes[-MAX_MODES:]),
        )

    def _interests(self) -> InterestList:
        """The areas of interest; until the first change, those of the scenario."""
        last = self._last(INTERESTS, self.now())
        if last is not None:
            listed: InterestList = last.body
            return listed
        return InterestList(areas=self._tape.evidence.interests_at_first())

"""The link's process: both routers, and the time keeper of the mission.

Mission time is decided here, since the link alone is seen from both sides: it starts when those have come who were
asked to be waited for, and runs at the rate that an operator sets.
"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

from he3.errors import InvalidInput
from schemas.codec import encode
from schemas.link import ClockState
from schemas.topics import CLOCK_SET, Side
from schemas.wire import Header
from services.link.kept_clock import keep, kept_clock, this_machine
from services.runtime.clock import at_rate, started
from services.runtime.drivers.wall_clock import CLOCKS, Process, Service, Stop
from services.runtime.options import Options
from services.runtime.queries.request import read_request
from services.runtime.refusals import refusal_of
from services.runtime.transport.session import IncomingQuery, Session, open_session

CLOCK_FILE = "clock.json"
ANNOUNCE_EVERY_S = 5.0
"""Wall time between two announcements of the time while it is not changed."""


class LinkProcess(Process):
    """A process that owns the two routers and the clock."""

    def __init__(self, service: Service, options: Options, stop: Stop) -> None:
        super().__init__(service, options, stop)
        self._missing = set(options.wait_for)
        self._clock_sequence = 0
        self._announced_s = 0.0
        self._machine = this_machine()
        self._kept = True

    def open(self, side: Side, endpoint: str) -> Session | None:
        """The router of that side."""
        return Session(open_session(side, "router", endpoint), self.mission)

    def learn_time(self) -> bool:
        """Start the clock, or go on with the one that an earlier start of this process left."""
        scenario = self.options.scenario
        remembered = self._remembered()
        if remembered is not None:
            self.clock.follow(remembered)
            self._missing.clear()
        else:
            rate = 0.0 if self._missing else scenario.rate
            self.clock.follow(started(scenario.start_ns, rate, time.time_ns()))
        for side, session in self.sessions.items():
            session.serve(CLOCKS[side], partial(self._tell_time, side))
            if self._missing:
                session.watch_alive(side, lambda name, alive: self.later(partial(self._seen, name, alive)))
        self.sessions[Side.EARTH].serve(CLOCK_SET, lambda query: self.later(partial(self._set_rate, query)))
        self._announce_time()
        if self._missing:
            self.log.info("mission time waits", for_=", ".join(sorted(self._missing)))
        return True

    def _seen(self, name: str, alive: bool) -> None:
        if alive and name in self._missing:
            self._missing.discard(name)
            if not self._missing:
                self._change_rate(self.options.scenario.rate)
                self.log.info("mission time runs", rate=self.options.scenario.rate)

    def _set_rate(self, query: IncomingQuery) -> None:
        try:
            change = read_request(CLOCK_SET, query, self.mission)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            self.refused(str(error))
            return
        self._missing.clear()
        self._change_rate(change.rate)
        query.reply(self._time_message())

    def _change_rate(self, rate: float) -> None:
        now = self.clock.anchored_now()
        self.clock.follow(at_rate(now, rate, now.anchor_wall_ns))
        self._announce_time()

    def beat(self, monotonic_s: float) -> None:
        """Announce the time now and then: to processes whose machine was suspended, and for a restart of this one."""
        super().beat(monotonic_s)
        if monotonic_s - self._announced_s >= ANNOUNCE_EVERY_S:
            self._announce_time()

    def _announce_time(self) -> None:
        self._announced_s = time.monotonic()
        self._remember()
        for side, session in self.sessions.items():
            session.publish(CLOCKS[side], self._time_message())

    def _tell_time(self, _side: Side, query: IncomingQuery) -> None:
        query.reply(self._time_message())

    def _time_message(self) -> bytes:
        clock = self.clock.anchored_now()
        self._clock_sequence += 1
        header = Header(
            mission=self.mission,
            source=self.name,
            incarnation=0,
            sequence=self._clock_sequence,
            made_at=clock.anchor_mission_ns,
        )
        return encode(header, clock)

    # --- what survives a restart --------------------------------------------------------------------------------

    def _clock_path(self) -> Path | None:
        return None if self.options.journal is None else self.options.journal / CLOCK_FILE

    def _remembered(self) -> ClockState | None:
        path = self._clock_path()
        if path is None or not path.exists():
            return None
        try:
            return kept_clock(path, self._machine)
        except ValueError:
            self.log.warning(f"{path}: expected a clock, got something else; starting mission time anew")
            return None

    def _remember(self) -> None:
        path = self._clock_path()
        if path is None:
            return
        try:
            keep(path, self.clock.anchored_now(), self._machine)
            self._kept = True
        except OSError as error:
            if self._kept:  # said once: it is tried again with each announcement
                self.log.warning(f"{path}: cannot keep the clock for a restart: {error.strerror}")
            self._kept = False

"""Joining a mission that runs: an operator's session on Earth, and what it hears."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from he3.errors import PeerUnreachable
from schemas.ground import GroundStatus, Presence
from schemas.link import ClockMode, ClockState, LinkStatus
from schemas.topics import EARTH_CLOCK, EARTH_PRESENCE, GROUND_STATUS, LINK_STATUS
from schemas.wire import Header
from services.console.client.run_file import find
from services.console.report.progress import Moment, moment_of
from services.runtime.clock import mission_time, newer
from services.runtime.node import SECOND
from services.runtime.transport.client import Client

CONNECT_WITHIN_S = 20.0
"""How long a service that has just been started may take to open its router."""


def join(mission: str | None, earth: str | None) -> Client:
    """A session with the mission that is meant; raises PeerUnreachable or InvalidInput with one line."""
    endpoint, name = find(mission, earth)
    return Client(endpoint, name)


def join_when_up(endpoint: str, mission: str, check: Callable[[], None]) -> Client:
    """A session with a mission whose router is being started; `check` raises when it never will be."""
    deadline = time.monotonic() + CONNECT_WITHIN_S
    while True:
        check()
        try:
            return Client(endpoint, mission)
        except PeerUnreachable:
            if time.monotonic() > deadline:
                raise
        time.sleep(0.05)


def wait_for_ground(client: Client, check: Callable[[], None]) -> None:
    """Return when the ground station answers; `check` raises when it never will."""
    while True:
        check()
        try:
            client.latest(GROUND_STATUS, timeout_s=1.0)
            return
        except PeerUnreachable:
            time.sleep(0.05)


class Watcher:
    """What a running mission says of itself, kept up to date by the session's threads."""

    def __init__(self, client: Client, start_ns: int | None = None) -> None:
        self._client = client
        self._start_ns = start_ns
        self._lock = threading.Lock()
        self.changed = threading.Event()
        """Set with every news; whoever waits for it clears it."""
        self.status: GroundStatus | None = None
        self.link: LinkStatus | None = None
        self.clock: ClockState | None = None
        self.alive: dict[str, tuple[float, Presence]] = {}
        """Wall time [s, monotonic] and content of each process's last heartbeat on Earth."""
        self._heard_ns = 0
        for topic, keep in (
            (GROUND_STATUS, self._keep_status),
            (LINK_STATUS, self._keep_link),
            (EARTH_CLOCK, self._keep_clock),
            (EARTH_PRESENCE, self._keep_presence),
        ):
            client.subscribe(topic, keep)

    def catch_up(self, timeout_s: float = 2.0) -> None:
        """Ask for what was said before this session began; whoever does not answer is left out."""
        for topic, keep in (
            (EARTH_CLOCK, self._keep_clock),
            (GROUND_STATUS, self._keep_status),
            (LINK_STATUS, self._keep_link),
        ):
            try:
                header, body = self._client.latest(topic, timeout_s)
            except PeerUnreachable:
                continue
            keep(header, body)

    @property
    def mission_time_s(self) -> float | None:
        """Seconds since the mission began; None while nobody has told the time."""
        clock = self.clock
        start = self._start_ns if clock is None else clock.start_ns
        if start is None:
            return None
        now = self._heard_ns
        if clock is not None and clock.mode is ClockMode.WALL:
            now = max(now, mission_time(clock, time.time_ns()))
        return max(0.0, (now - start) / SECOND)

    @property
    def status_time_s(self) -> float:
        """Seconds since the mission began when the ground's last status was made."""
        start = self._start_ns if self.clock is None else self.clock.start_ns
        return 0.0 if start is None else max(0.0, (self._status_ns - start) / SECOND)

    def moment(self) -> Moment:
        """The mission as it is now, as far as this session has heard."""
        link = self.link
        return moment_of(self.status, self.mission_time_s or 0.0, 0 if link is None else in_flight(link))

    # --- from the session's threads -----------------------------------------------------------------------------

    _status_ns = 0

    def _keep_status(self, header: Header, body: Any) -> None:
        with self._lock:
            if header.made_at >= self._status_ns:
                self.status, self._status_ns = body, header.made_at
        self._heard(header)

    def _keep_link(self, header: Header, body: Any) -> None:
        self.link = body
        self._heard(header)

    def _keep_clock(self, header: Header, body: Any) -> None:
        self.clock = newer(self.clock, body)
        self._heard(header)

    def _keep_presence(self, header: Header, body: Any) -> None:
        self.alive[body.name] = (time.monotonic(), body)
        self._heard(header)

    def _heard(self, header: Header) -> None:
        self._heard_ns = max(self._heard_ns, header.made_at)
        self.changed.set()


def in_flight(link: LinkStatus) -> int:
    """Messages between the two sides, those included that wait to leave."""
    return link.up.in_flight + link.down.in_flight + link.up.waiting + link.down.waiting

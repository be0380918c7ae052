"""The heartbeat of a process. A liveliness token shows that its transport is alive, the heartbeat that it works."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from schemas.codec import encode
from schemas.ground import Presence
from schemas.topics import EARTH_PRESENCE, MOON_PRESENCE, Side, Topic
from schemas.wire import Header

if TYPE_CHECKING:
    from services.runtime.host import Host

PERIOD_S = 1.0
"""Wall time between two heartbeats [s]."""

TOPICS = {Side.MOON: MOON_PRESENCE, Side.EARTH: EARTH_PRESENCE}


def software_version() -> str:
    """Version of the installed system."""
    try:
        return version("he3-seeker")
    except PackageNotFoundError:
        return "unknown"


class Heartbeat:
    """Publishes a `Presence` message of the process on each of its sides, every second."""

    def __init__(self, host: Host, publish: Callable[[Topic, Side, bytes], None], insecure: bool = False) -> None:
        """insecure: whether the process uses an endpoint off loopback without TLS."""
        self._host = host
        self._publish = publish
        self._insecure = insecure
        self._version = software_version()
        self._beats = 0
        self._next = 0.0

    def beat(self, monotonic_s: float, now: int) -> None:
        """Publish if two seconds have passed; `now` is the mission time of the message."""
        if monotonic_s < self._next:
            return
        self._next = monotonic_s + PERIOD_S
        interface = self._host.interface
        for side in interface.sides:
            body = Presence(
                name=interface.name,
                side=side.value,
                incarnation=self._host.incarnation,
                software=self._version,
                pid=os.getpid(),
                host=platform.node()[:100],
                refused=self._host.refused,
                events=self._host.events,
                defects=self._host.defects,
                insecure=self._insecure,
            )
            header = Header(
                mission=self._host.mission,
                source=interface.name,
                incarnation=self._host.incarnation,
                sequence=self._beats,
                made_at=now,
            )
            self._publish(TOPICS[side], side, encode(header, body))
        self._beats += 1

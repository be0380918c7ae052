"""A mission's messages as they arrive: an iterator of news, callbacks, and the processes that are alive."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from schemas.topics import COMMAND_STATUS, EVENT, GROUND_STATUS, LINK_STATUS, SAMPLE, STATE, Side, Topic
from services.mission.processes import vital_on

if TYPE_CHECKING:
    from schemas.wire import Header, Wire
    from services.mission.mission_time import MissionTime
    from services.runtime.transport.client import Client

NEWS: tuple[Topic, ...] = (GROUND_STATUS, SAMPLE, EVENT, STATE, COMMAND_STATUS, LINK_STATUS)
MAX_HELD = 10_000
"""Queue length of a slow reader of `live`; beyond it the oldest news are dropped."""
ALIVE_WITHIN_S = 0.3
"""Wall time that the list of living processes may take to arrive."""


@dataclass(frozen=True, slots=True)
class News:
    """A message: its topic, who made it, when [ns of mission time], and its body."""

    topic: str
    source: str
    made_at: MissionTime
    body: Wire


class LiveNews:
    """The part of `MissionClient` that receives published messages."""

    _session: Client

    def live(self, *topics: Topic, timeout_s: float | None = None) -> Iterator[News]:
        """Messages from now on, as they arrive; ends after `timeout_s` of wall time, or never if that is None.

        topics: what to subscribe to (default: `NEWS`). A slow reader misses the oldest news and delays no other client.
        """
        heard: queue.Queue[News] = queue.Queue(maxsize=MAX_HELD)

        def keep(name: str, header: Header, body: Wire) -> None:
            while True:
                try:
                    heard.put_nowait(News(name, header.source, header.made_at, body))
                    return
                except queue.Full:
                    heard.get_nowait()

        ends = [self._session.subscribe(topic, partial(keep, topic.name)) for topic in topics or NEWS]
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        try:
            while deadline is None or time.monotonic() < deadline:
                try:
                    yield heard.get(timeout=0.2)
                except queue.Empty:
                    continue
        finally:
            for end in ends:
                end()

    def listen(self, topic: Topic, on_message: Callable[[Header, Any], None]) -> Callable[[], None]:
        """Subscribe: `on_message(header, body)` runs in another thread. Returns the function that ends it."""
        return self._session.subscribe(topic, on_message)

    def latest(self, topic: Topic) -> tuple[Header, Any]:
        """Header and body of the last message of a topic whose sender keeps it; raises PeerUnreachable if none does."""
        return self._session.latest(topic)

    def alive_on_earth(self) -> tuple[str, ...]:
        """Names of the processes that are alive on the Earth side, in alphabetical order."""
        alive: dict[str, bool] = {}
        self._session.watch_alive(Side.EARTH, alive.__setitem__)
        deadline = time.monotonic() + ALIVE_WITHIN_S
        while not vital_on(Side.EARTH) <= alive.keys() and time.monotonic() < deadline:
            time.sleep(0.01)
        return tuple(sorted(name for name, here in alive.items() if here))

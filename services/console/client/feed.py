"""The map's feed: every change of the map, put together from key frames and deltas."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from he3.errors import He3Error, InvalidInput
from schemas.topics import MAP_FEED
from services.ground.map.feed import FeedMap, FeedReader

if TYPE_CHECKING:
    from services.runtime.transport.client import Client


class MapFeed:
    """The part of `MissionClient` that follows the map."""

    _session: Client

    def maps(self, timeout_s: float | None = None, ended: Callable[[], bool] = lambda: False) -> Iterator[FeedMap]:
        """The map with every change, from the feed: equal to the ground's to the byte.

        Ends after `timeout_s` of wall time, or when `ended`, which is called several times a second, returns true.
        """
        reader = FeedReader()
        frames: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        end = self._session.subscribe_raw(MAP_FEED, frames.put)
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        try:
            while not ended() and (deadline is None or time.monotonic() < deadline):
                if reader.needs_key:
                    self._ask_for_key(frames)
                try:
                    changed = reader.take(frames.get(timeout=0.2))
                except (queue.Empty, InvalidInput):
                    continue  # no frame, a foreign or a damaged one: a key frame follows
                if changed and reader.map is not None:
                    yield reader.map
        finally:
            end()

    def _ask_for_key(self, frames: queue.SimpleQueue[bytes]) -> None:
        try:
            frames.put(self._session.fetch(MAP_FEED, {})[0])
        except He3Error:
            time.sleep(0.2)  # there is no map yet, or the ground does not answer; frames that arrive meanwhile are kept

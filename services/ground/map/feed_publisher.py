"""Publishes the feed of the map from a thread of its own, as long as a subscriber listens."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any, Final

from schemas.refusal import Refusal, RefusalCode
from schemas.topics import MAP_FEED
from services.ground.map.feed import FeedMap, FeedWriter

if TYPE_CHECKING:
    from services.ground.map.snapshot import MapSnapshot
    from services.runtime.transport.session import IncomingQuery, Session

BEAT_S: Final = 2.0  # between two beats
END_S: Final = 0.2  # how long `end` waits for a frame that is being published
WANTED_S: Final = 600.0  # frames are published for this long after a query for a key frame, with or without subscribers


def feed_of(snapshot: MapSnapshot) -> FeedMap:
    """The part of a snapshot that goes into the feed."""
    return FeedMap(
        snapshot.mean_ppb,
        snapshot.std_ppb,
        snapshot.traversable,
        snapshot.grid.resolution_m,
        snapshot.revision,
        len(snapshot.samples),
        snapshot.mission_time_ns,
    )


class FeedPublisher:
    """Publishes the newest map only: a map that is replaced before its turn is skipped."""

    def __init__(self) -> None:
        self._writer = FeedWriter(epoch=time.time_ns() // 1_000_000)
        self._lock = threading.Lock()
        self._changed = threading.Condition()
        self._newest: Any = None
        self._asked_at = -WANTED_S
        self._ended = False
        self._thread: threading.Thread | None = None

    def begin(self, session: Session) -> None:
        session.serve(MAP_FEED, lambda query: threading.Thread(target=self._answer, args=(query,)).start())
        self._thread = threading.Thread(target=self._work, args=(session,), name="feed", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop publishing after the present frame."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(END_S)

    def show(self, snapshot: Any) -> None:
        with self._changed:
            self._newest = snapshot
            self._changed.notify_all()

    def _answer(self, query: IncomingQuery) -> None:
        self._asked_at = time.monotonic()
        with self._lock:
            frame = self._writer.key()
        if frame is None:
            query.refuse(Refusal("there is no map yet; ask again in a moment", RefusalCode.NOT_READY))
        else:
            query.reply(frame, media_type="application/octet-stream")

    def _work(self, session: Session) -> None:
        shown = None
        while True:
            with self._changed:
                if self._newest is shown and not self._ended:
                    self._changed.wait(BEAT_S)
                if self._ended:
                    return
                newest = self._newest
            wanted = session.has_subscribers(MAP_FEED) or time.monotonic() - self._asked_at < WANTED_S
            with self._lock:
                if newest is shown:
                    frame = self._writer.beat() if wanted else None
                else:
                    frame = self._writer.take(feed_of(newest), wanted)
            shown = newest
            if frame is not None:
                session.publish_best_effort(MAP_FEED, frame, media_type="application/octet-stream")

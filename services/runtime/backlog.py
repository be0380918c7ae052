"""The messages of each topic that wait for the main loop: bounded, so that a flood takes neither memory nor hours.

Zenoh hands over messages as fast as they come. A process that is slower would queue them without limit, and would come
to a genuine message only after all junk before it. So what exceeds the bound of its topic is turned away and counted as
refused. Nothing under custody is lost by that: its sender repeats it. Other topics are not affected.
"""

from __future__ import annotations

import threading
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Final

from he3.errors import Busy
from services.runtime.refusals import refusal_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from schemas.topics import Topic
    from services.runtime.inbox import Inbox
    from services.runtime.transport.session import IncomingQuery

MAX_MESSAGES: Final = 50_000
"""Of one topic: a few seconds of work. A link that releases its whole queue after a black-out sends 10,000."""
MAX_BYTES: Final = 64 * 1024 * 1024
"""Of one topic, as in the link's own queue."""


class Backlog:
    """Counts what waits, by topic. Use it from any thread."""

    def __init__(self, max_messages: int = MAX_MESSAGES, max_bytes: int = MAX_BYTES) -> None:
        self._max_messages = max_messages
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._messages: Counter[Topic] = Counter()
        self._bytes: Counter[Topic] = Counter()
        self._turned_away: Counter[Topic] = Counter()

    def enter(self, topic: Topic, size: int) -> bool:
        """Whether there is room for a message of that topic and size [bytes]. It then waits, or is turned away."""
        with self._lock:
            if self._messages[topic] >= self._max_messages or self._bytes[topic] + size > self._max_bytes:
                self._turned_away[topic] += 1
                return False
            self._messages[topic] += 1
            self._bytes[topic] += size
            return True

    def leave(self, topic: Topic, size: int) -> None:
        """A message that had entered is being handled."""
        with self._lock:
            self._messages[topic] -= 1
            self._bytes[topic] -= size

    def receiving(self, inbox: Inbox, topic: Topic, take_in: Callable[[bytes], None]) -> Callable[[bytes, bytes], None]:
        """For a subscription: `take_in` is called in the main loop with each payload for which there is room."""

        def handle(payload: bytes) -> None:
            self.leave(topic, len(payload))
            take_in(payload)

        def on_payload(payload: bytes, _attachment: bytes) -> None:
            if self.enter(topic, len(payload)):
                inbox.put(partial(handle, payload))

        return on_payload

    def answering(
        self, inbox: Inbox, topic: Topic, take_in: Callable[[IncomingQuery], None]
    ) -> Callable[[IncomingQuery], None]:
        """For a queryable: `take_in` is called in the main loop with each query; for want of room one is refused."""

        def handle(query: IncomingQuery) -> None:
            self.leave(topic, 0)
            take_in(query)

        def on_query(query: IncomingQuery) -> None:
            if self.enter(topic, 0):
                inbox.put(partial(handle, query))
            else:
                query.refuse(refusal_of(Busy(f"{topic.name}: too many queries wait; ask again later")))

        return on_query

    def turned_away(self) -> list[tuple[Topic, int]]:
        """How many messages of which topics were turned away since the last call."""
        if not self._turned_away:
            return []
        with self._lock:
            counted, self._turned_away = self._turned_away, Counter()
        return list(counted.items())

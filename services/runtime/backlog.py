"""The messages of each topic that wait for the main loop: bounded, so that a flood takes neither memory nor hours.

Zenoh hands over messages as fast as they come. A process that is slower would queue them without limit, and would come
to a genuine message only after all junk before it. So what exceeds the bound of its topic is turned away and counted as
refused. Nothing under custody is lost by that: its sender repeats it. Other topics are not affected.
"""

from __future__ import annotations

import threading
from collections import Counter
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from schemas.topics import Topic

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

    def turned_away(self) -> list[tuple[Topic, int]]:
        """How many messages of which topics were turned away since the last call."""
        if not self._turned_away:
            return []
        with self._lock:
            counted, self._turned_away = self._turned_away, Counter()
        return list(counted.items())

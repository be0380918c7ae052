"""Queries to the instruments: one at a time, repeated while there is no reply. A reply to a withdrawn query is
recognised by the query's name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from schemas.telemetry import EventKind
from services.mission.mission_time import MissionTime, seconds
from services.runtime.node import Effect, SendQuery, SetTimer

if TYPE_CHECKING:
    from schemas.topics import Topic
    from schemas.wire import Wire
    from services.rover.reporter import Reporter
    from services.runtime.node import SavedState

RETRY: Final = "retry"
"""Timer: ask the silent instrument again."""


class Instruments:
    """The pending query, if any, and the instruments that are known to be silent."""

    def __init__(self, retry_s: float, reporter: Reporter, effects: list[Effect]) -> None:
        self._retry_s = retry_s
        self._reporter = reporter
        self._effects = effects
        self._sent = 0
        self._pending: str | None = None
        self._silent: set[str] = set()

    @property
    def waiting(self) -> bool:
        """Whether a query is pending."""
        return self._pending is not None

    def ask(self, topic: Topic, request: Wire) -> None:
        """Sends the query. Replies to earlier queries no longer count."""
        self._sent += 1
        self._pending = f"{topic.name.rsplit('/', 1)[-1]}-{self._sent}"
        self._effects.append(SendQuery(topic, request, self._pending))

    def expects(self, query: str) -> bool:
        """Whether that name is the pending query's."""
        return query == self._pending

    def answered(self, topic: Topic) -> None:
        """Closes the pending query: the instrument has replied."""
        self._pending = None
        self._silent.discard(topic.name)

    def withdraw(self) -> None:
        """Drops the pending query, if any; it is not repeated."""
        if self._pending is not None:
            self._pending = None
            self._effects.append(SetTimer(RETRY, None))

    def failed(self, topic: Topic, now: MissionTime, why: str) -> None:
        """Schedules the query again; the first failure after a reply is reported."""
        if topic.name not in self._silent:
            self._silent.add(topic.name)
            self._reporter.report_event(EventKind.INSTRUMENT_SILENT, now, f"{topic.name}: {why}")
        self._effects.append(SetTimer(RETRY, now + seconds(self._retry_s)))

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {"sent": self._sent, "pending": self._pending, "silent": set(self._silent)}

    def restore(self, state: SavedState) -> None:
        """Restore the instruments from this state."""
        self._sent, self._pending, self._silent = state["sent"], state["pending"], state["silent"]

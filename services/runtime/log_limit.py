"""Which of the log lines that others cause are written: the first few of each cause, then one count a minute.

Each message that a service refuses gives a log line. So a hostile or broken sender could fill the disk, and bury the
lines of others. A cause is a kind and a source: a flood of one cause takes no line from another.

The limit is a bound on lines, not on what is counted: each line is either written whole or counted in one summary.
Time is an argument [s of wall time, monotonic].
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Final

from services.runtime.node import Cause, Level, LogRecord

FIRST: Final = 5
"""Lines of a cause that are written whole."""
SUMMARY_EVERY_S: Final = 60.0
"""Shortest time between two summaries, and so the age of what they count, at most."""
FORGOTTEN_AFTER_S: Final = 3600.0
"""A cause that was quiet for so long counts as new: its next lines are written whole."""
MAX_CAUSES: Final = 64
"""Causes that are told apart. Senders beyond them share one place a kind: a name in a message is not proven."""
NAMED: Final = 3
"""Causes that a summary names, those with most lines."""
OTHERS: Final = "others"

_ORDER: Final = tuple(Level)


@dataclass(slots=True)
class _Seen:
    """The lines of one cause."""

    last_s: float
    written: int = 0
    held: int = 0
    """Lines since the last summary that were not written."""


class LogLimit:
    """Bounds the log lines that others cause. It has no clock and writes nothing."""

    def __init__(self) -> None:
        self._seen: dict[Cause, _Seen] = {}
        self._held_since_s: float | None = None
        self._swept_s = -inf
        self._last: LogRecord | None = None
        self._level = Level.DEBUG

    def admit(self, record: LogRecord, now_s: float) -> list[LogRecord]:
        """The lines to write now that this record has come: itself, a summary, or none."""
        if record.cause is None:
            return [record]
        seen = self._place(record.cause, now_s)
        seen.last_s = now_s
        if seen.written < FIRST:
            seen.written += 1
            return [record]
        seen.held += 1
        self._last = record
        self._level = max(self._level, record.level, key=_ORDER.index)
        if self._held_since_s is None:
            self._held_since_s = now_s
        return self.due(now_s)

    def due(self, now_s: float) -> list[LogRecord]:
        """The summary, if it is time for one."""
        if self._held_since_s is None or now_s - self._held_since_s < SUMMARY_EVERY_S:
            return []
        return self.rest()

    def rest(self) -> list[LogRecord]:
        """The summary of all lines that no summary has counted yet; empty if there are none."""
        if self._last is None:
            return []
        held = sorted(
            ((seen.held, cause) for cause, seen in self._seen.items() if seen.held), key=lambda pair: -pair[0]
        )
        count = sum(number for number, _ in held)
        named = ", ".join(f"{number} of '{cause.source}' ({cause.kind})" for number, cause in held[:NAMED])
        others = "" if len(held) <= NAMED else f", and {count - sum(number for number, _ in held[:NAMED])} of others"
        text = f"{count} more lines were not written: {named}{others}; the last: {self._last.text}"
        summary = LogRecord(self._level, text, {"not_shown": count, **self._last.fields})
        for seen in self._seen.values():
            seen.held = 0
        self._last, self._held_since_s, self._level = None, None, Level.DEBUG
        return [summary]

    def _place(self, cause: Cause, now_s: float) -> _Seen:
        """Where the lines of that cause are counted."""
        seen = self._seen.get(cause)
        if seen is None and len(self._seen) >= MAX_CAUSES:
            self._forget_quiet(now_s)
            if len(self._seen) >= MAX_CAUSES:
                cause = Cause(cause.kind, OTHERS)
                seen = self._seen.get(cause)
        if seen is None:
            seen = self._seen[cause] = _Seen(now_s)
        elif _quiet(seen, now_s) and not seen.held:
            seen.written = 0
        return seen

    def _forget_quiet(self, now_s: float) -> None:
        """Make room in the table, at most once a minute: a flood of invented senders asks for it with each message."""
        if now_s - self._swept_s >= SUMMARY_EVERY_S:
            self._swept_s = now_s
            self._seen = {known: each for known, each in self._seen.items() if each.held or not _quiet(each, now_s)}


def _quiet(seen: _Seen, now_s: float) -> bool:
    return now_s - seen.last_s > FORGOTTEN_AFTER_S

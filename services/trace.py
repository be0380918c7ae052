"""The event log: a line for each event that a node handled, the same in every driver that keeps virtual time."""

from __future__ import annotations

from pathlib import Path

from he3.errors import InvalidInput
from services.node import MissionTime


class EventLog:
    """Writes 'mission time [ns], node, what' as lines of a file; buffered, complete once closed."""

    def __init__(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("w", encoding="utf-8")
        except OSError as error:
            raise InvalidInput(f"{path}: cannot write the event log: {error.strerror}") from None

    def __call__(self, now: MissionTime, name: str, what: str) -> None:
        self._file.write(f"{now}\t{name}\t{what}\n")

    def close(self) -> None:
        self._file.close()

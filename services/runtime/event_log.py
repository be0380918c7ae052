"""The event log: one line for each event that a node handles, the same in every driver that keeps virtual time."""

from __future__ import annotations

from collections.abc import Iterable
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from services.runtime.files.output import open_output

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime


class EventLog:
    """Writes lines of mission time [ns], node and event to a file; buffered, complete once closed."""

    def __init__(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = TextIOWrapper(open_output(path), encoding="utf-8")
        except OSError as error:
            raise InvalidInput(f"{path}: cannot write the event log: {error.strerror}") from None
        self.active = True
        """Whether events are written. Queries for the report, after the end of the mission, are not part of the log."""

    def __call__(self, now: MissionTime, name: str, what: str) -> None:
        if self.active:
            self._file.write(f"{now}\t{name}\t{what}\n")

    def close(self) -> None:
        """Write what is buffered; nothing is written afterwards."""
        self.active = False
        self._file.close()


def merge_event_logs(parts: Iterable[Path], into: Path) -> int:
    """Write the lines of all parts to `into`, ordered by time, node and order of handling; returns their number.

    The order is the same for one log of many nodes and for many logs of one node each, so equal missions have equal
    merged logs, to the byte. Raises InvalidInput for a line that is not an event.
    """
    entries: list[tuple[int, str, str]] = []
    for part in parts:
        try:
            with part.open(encoding="utf-8", newline="\n") as lines:
                entries.extend(_entry(line, part) for line in lines)
        except OSError as error:
            raise InvalidInput(f"{part}: cannot read the event log: {error.strerror}") from None
    entries.sort(key=lambda entry: entry[:2])  # stable: events of one node and time stay in the order of handling
    try:
        into.parent.mkdir(parents=True, exist_ok=True)
        with TextIOWrapper(open_output(into), encoding="utf-8", newline="\n") as merged:
            merged.writelines(line for _, _, line in entries)
    except OSError as error:
        raise InvalidInput(f"{into}: cannot write the event log: {error.strerror}") from None
    return len(entries)


def _entry(line: str, where: Path) -> tuple[int, str, str]:
    time, _, rest = line.partition("\t")
    node, tab, _ = rest.partition("\t")
    if not tab or not time.isdigit() or not line.endswith("\n"):
        raise InvalidInput(f"{where}: expected lines of time, node and event, got {line[:60]!r}")
    return int(time), node, line

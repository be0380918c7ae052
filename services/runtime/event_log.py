"""The event log: one line for each event that a node handles, the same in every driver that keeps virtual time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING

from he3.errors import He3Error, InvalidInput
from services.runtime.files.output import failed, open_output

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime


class EventLog:
    """Writes lines of mission time [ns], node and event to a file; buffered, complete once closed.

    A node handles an event whether or not its line can be written, so writing never raises: `problem` tells why the log
    ends early.
    """

    def __init__(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = TextIOWrapper(open_output(path), encoding="utf-8")
        except OSError as error:
            raise failed(f"{path}: cannot write the event log", error) from None
        self._path = path
        self.problem: str | None = None
        """One line on why the log lacks events, which is certain once it is closed; None if it has them all."""
        self.active = True
        """Whether events are written. Queries for the report, after the end of the mission, are not part of the log."""

    def __call__(self, now: MissionTime, name: str, what: str) -> None:
        if not self.active or self.problem is not None:
            return
        try:
            self._file.write(f"{now}\t{name}\t{what}\n")
        except OSError as error:
            self._failed(error)

    def close(self) -> None:
        """Write what is buffered; nothing is written afterwards."""
        self.active = False
        try:
            self._file.close()
        except OSError as error:
            self._failed(error)

    def _failed(self, error: OSError) -> None:
        if self.problem is None:
            self.problem = f"{self._path}: the event log ends early: {error.strerror}"


@contextmanager
def open_event_log(path: Path) -> Iterator[EventLog]:
    """The event log, closed at the end; raises He3Error then if it lacks events."""
    log = EventLog(path)
    try:
        yield log
    finally:
        log.close()
    if log.problem is not None:
        raise He3Error(log.problem)


def merge_event_logs(parts: Iterable[Path], into: Path) -> int:
    """Write the lines of all parts to `into`, ordered by time, node and order of handling; returns their number.

    The order is the same for one log of many nodes and for many logs of one node each, so equal missions have equal
    merged logs, to the byte. Raises InvalidInput for a line that is not an event, He3Error for a file that
    cannot be read or written.
    """
    entries: list[tuple[int, str, str]] = []
    for part in parts:
        try:
            with part.open(encoding="utf-8", newline="\n") as lines:
                entries.extend(_entry(line, part) for line in lines)
        except OSError as error:
            raise failed(f"{part}: cannot read the event log", error) from None
    entries.sort(key=lambda entry: entry[:2])  # stable: events of one node and time stay in the order of handling
    try:
        into.parent.mkdir(parents=True, exist_ok=True)
        with TextIOWrapper(open_output(into), encoding="utf-8", newline="\n") as merged:
            merged.writelines(line for _, _, line in entries)
    except OSError as error:
        raise failed(f"{into}: cannot write the event log", error) from None
    return len(entries)


def lacks_of_merged(parts: Iterable[Path], into: Path, lacks: Sequence[str]) -> list[str]:
    """One line on each reason why `into` is not the merged log of these parts; empty if it is.

    lacks: reasons that are known, on which nothing is merged: a log that ends early looks like that of another mission.
    """
    if lacks:
        return [*lacks]
    try:
        merge_event_logs(parts, into)
    except He3Error as error:
        return [str(error)]
    return []


def _entry(line: str, where: Path) -> tuple[int, str, str]:
    time, _, rest = line.partition("\t")
    node, tab, _ = rest.partition("\t")
    if not tab or not time.isdigit() or not line.endswith("\n"):
        raise InvalidInput(f"{where}: expected lines of time, node and event, got {line[:60]!r}")
    return int(time), node, line

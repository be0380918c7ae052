"""Where the recorder's messages go: into the file of a recording, for as long as the file takes them.

A full disk does not end a recording. Up to `MAX_PENDING_BYTES` wait in memory; messages beyond that are not recorded,
and are counted. When there is room again the recording continues, and the file itself says how many messages it lacks.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final, Self

from services.recorder.writer import RecordingWriter

if TYPE_CHECKING:
    from schemas.topics import Topic
    from services.mission.mission_time import MissionTime
    from services.recorder.files import RecordingFile
    from services.recorder.foxglove.derivation import Derived

MAX_PENDING_BYTES: Final = 16 * 1024 * 1024  # of memory, for what the file does not take at present


class RecordingSink:
    """Writes messages to a recording's file. Use it in a `with` statement: it completes the file."""

    def __init__(
        self,
        file: RecordingFile,
        mission: str,
        least_flush_s: float = 0.0,
        *,
        clock: Callable[[], float] = time.monotonic,
        max_pending_bytes: int = MAX_PENDING_BYTES,
        about: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        """least_flush_s: shortest wall time between two flushes [s]. about: metadata records, as `RecordingWriter`."""
        self._file = file
        self._writer = RecordingWriter(file, mission, least_flush_s, clock, about)
        self._max_pending_bytes = max_pending_bytes
        self._omitted = 0  # messages that were not taken, for want of room
        self._gap: tuple[int, MissionTime, MissionTime] | None = None  # those that the file does not mention yet
        self._recorded = 0
        self._ends: deque[tuple[int, int]] = deque()  # position in the file, and messages before it

    @property
    def failure(self) -> str | None:
        """One line on why messages cannot be written at present, with the file; None if they can."""
        cause = self._file.failure
        return None if cause is None else f"{self._file.path}: {cause}"

    @property
    def lost(self) -> bool:
        """Whether the file was deleted, so that nothing of the mission is recorded, whatever follows."""
        return self._file.deleted

    @property
    def omitted(self) -> int:
        """Messages that were not taken because too much waited for the file."""
        return self._omitted

    @property
    def problem(self) -> str | None:
        """After `close`: one line on what is not recorded, with file and cause; None if every message is recorded."""
        cause = self._file.failure
        total = self._writer.messages + self._omitted
        if cause is None:
            cause, missing = "there was no room for some time", self._omitted
            if not missing:
                return None
        else:
            missing = total if self._file.deleted else total - self._recorded
        what = f"{missing} of {total} messages are not recorded" if missing else "the summary is missing"
        return f"{self._file.path}: {cause}: {what}"

    def write(
        self, topic: Topic, payload: bytes, received_at: MissionTime, made_at: MissionTime, sequence: int
    ) -> None:
        """Append one message; it is omitted, and counted, if too much waits for the file already."""
        if self._file.failure is not None and self._file.pending_bytes >= self._max_pending_bytes:
            self._omitted += 1
            count, first, _ = self._gap or (0, received_at, received_at)
            self._gap = (count + 1, first, received_at)
            return
        self._mention_gap()
        self._writer.write(topic, payload, received_at, made_at, sequence)
        self._follow()

    def write_derived(self, message: Derived, received_at: MissionTime) -> None:
        """Append a message in a schema of Foxglove's; while the file takes nothing, it is left out, and not counted."""
        if self._file.failure is None:
            self._writer.write_derived(message, received_at)
            self._follow()

    def flush(self) -> None:
        """Hand all messages to the operating system, at most once per `least_flush_s`."""
        self._writer.flush()
        self._follow()

    def close(self) -> None:
        """Complete the file with its index and summary, as far as there is room, and close it."""
        self._mention_gap()
        self._writer.close()
        self._file.close()
        self._follow()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _mention_gap(self) -> None:
        if self._gap is not None:
            self._writer.write_gap(*self._gap)
            self._gap = None

    def _follow(self) -> None:
        """Update the number of messages that the operating system has taken."""
        if not self._ends or self._ends[-1][1] < self._writer.stored:
            self._ends.append((self._file.tell(), self._writer.stored))
        while self._ends and self._ends[0][0] <= self._file.written_bytes:
            self._recorded = self._ends.popleft()[1]

"""The file of a recording: an earlier recording is kept beside it, and messages survive a disk that is full for a time.

Bytes that the system refuses to write wait in memory and are tried again with each flush, so the file continues exactly
where it stopped once there is room.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Protocol, Self

from he3.errors import He3Error
from services.runtime.files.lock import FileLock, lock_beside
from services.runtime.files.output import open_output

BUFFER_BYTES = 65_536
"""Buffered bytes at which the file is written without a flush."""


class RawFile(Protocol):
    """An unbuffered binary file."""

    def write(self, data: bytearray, /) -> int | None: ...

    def close(self) -> None: ...


class RecordingFile:
    """A binary file whose `write` never fails. Use it in a `with` statement."""

    def __init__(self, path: Path, raw: RawFile, lock: FileLock | None = None) -> None:
        """lock: released when the file is closed."""
        self.path = path
        self._lock = lock
        self.failure: str | None = None
        """Why the system refuses to write; None if it does not."""
        self._raw = raw
        self._pending = bytearray()
        self._written = 0

    @property
    def written_bytes(self) -> int:
        """Bytes from the beginning of the file that the operating system has taken."""
        return self._written

    @property
    def pending_bytes(self) -> int:
        """Bytes that wait to be written."""
        return len(self._pending)

    def tell(self) -> int:
        """The position of the next byte, waiting bytes included."""
        return self._written + len(self._pending)

    def write(self, data: bytes) -> int:
        """Append the data."""
        self._pending += data
        if self.failure is None and len(self._pending) >= BUFFER_BYTES:
            self.flush()
        return len(data)

    def flush(self) -> None:
        """Write what waits; where the system refuses, `failure` says why and the rest keeps waiting."""
        try:
            while self._pending:
                taken = self._raw.write(self._pending) or 0
                self._written += taken
                del self._pending[:taken]
            self.failure = None
        except OSError as error:
            self.failure = error.strerror or type(error).__name__

    def close(self) -> None:
        """Write what waits, if that is possible now, and close the file."""
        self.flush()
        try:
            self._raw.close()
        except OSError as error:  # some file systems tell only now that there was no room
            self.failure = error.strerror or type(error).__name__
        if self._lock is not None:
            self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_recording(path: Path) -> RecordingFile:
    """An empty file of that name, its folder made; an earlier recording is kept beside it as mission-1.mcap, -2, ...

    Raises He3Error if it cannot be made, InvalidInput if another process writes that recording.
    """
    lock = lock_beside(path, f"{path}: expected a recording that no other process writes")
    try:
        if path.is_file() and path.stat().st_size > 0:
            path.rename(free_name(path))
        return RecordingFile(path, open_output(path, buffering=0), lock)
    except OSError as error:
        lock.release()
        raise He3Error(f"{path}: cannot write the recording: {error.strerror}") from None


def free_name(path: Path) -> Path:
    """A name beside that one which no file has: with -1, -2, ..."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(1))
    return next(name for name in names if not name.exists())

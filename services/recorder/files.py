"""The file of a recording: an earlier recording is kept beside it, and messages survive a disk that is full for a time.

Bytes that the system refuses to write wait in memory and are tried again with each flush, so the file continues exactly
where it stopped once there is room. A file that is deleted meanwhile is lost with all that it held; `failure` says so.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Protocol, Self

from services.runtime.files.lock import FileLock, lock_beside
from services.runtime.files.output import failed, open_output

BUFFER_BYTES = 65_536
"""Buffered bytes at which the file is written without a flush."""


DELETED = "the recording was deleted while it was written"
"""What `failure` says of a file that has no name any more."""


class RawFile(Protocol):
    """An unbuffered binary file."""

    def write(self, data: bytearray, /) -> int | None: ...

    def close(self) -> None: ...


class RecordingFile:
    """A binary file whose `write` never fails. Use it in a `with` statement."""

    def __init__(
        self, path: Path, raw: RawFile, lock: FileLock | None = None, is_there: Callable[[], bool] = lambda: True
    ) -> None:
        """lock: released when the file is closed. is_there: whether the file has a name still, so that it is found."""
        self.path = path
        self._lock = lock
        self.failure: str | None = None
        """Why the system refuses to write; None if it does not."""
        self.deleted = False
        """Whether the file was deleted while it was written; then no program can open it."""
        self._is_there = is_there
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
        if self.deleted:  # neither memory nor disk is filled for a file that no program can open
            self._written += len(data)
            return len(data)
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
            self._look_for_name()
        except OSError as error:
            self.failure = error.strerror or type(error).__name__

    def _look_for_name(self) -> None:
        if self.deleted or not self._is_there():
            self.deleted, self.failure = True, DELETED

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

    Raises InvalidInput if another process writes that recording, and as `failed` if it cannot be made.
    """
    lock = lock_beside(path, f"{path}: expected a recording that no other process writes")
    try:
        if path.is_file() and path.stat().st_size > 0:
            path.rename(free_name(path))
        raw = open_output(path, buffering=0)
        if not os.fstat(raw.fileno()).st_nlink:
            return RecordingFile(path, raw, lock)  # /dev/stdout leads to a file that never had a name
        return RecordingFile(path, raw, lock, lambda: os.fstat(raw.fileno()).st_nlink > 0)
    except OSError as error:
        lock.release()
        raise failed(f"{path}: cannot write the recording", error) from None


def free_name(path: Path) -> Path:
    """A name beside that one which no file has: with -1, -2, ..."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(1))
    return next(name for name in names if not name.exists())

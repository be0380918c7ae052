"""A lock on files that one process at a time may write: a folder of outputs, a recording, a journal.

The lock is an advisory `flock(2)` on a hidden file beside them, which names its owner. The system releases it with the
process, however that ends: a lock file that a killed process left keeps out no other process.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from he3.errors import InvalidInput
from services.runtime.files.output import failed, require_own


class FileLock:
    """Held from its making until `release`, or until this process ends. Use it in a `with` statement if it can end."""

    def __init__(self, path: Path, expected: str) -> None:
        """path: the lock file. expected: the beginning of the error message, such as "expected a folder that ...".

        Raises InvalidInput, naming the owner, if another process holds the lock, and as `failed` if it cannot be made.
        """
        self._path = path
        self._descriptor = _locked(path, expected)
        if self._descriptor is not None:
            # A full disk is no reason to go without the lock: only its name is missing then.
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, 0)
                owner = f"pid {os.getpid()} since {datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC\n"
                os.pwrite(self._descriptor, owner.encode(), 0)

    def release(self) -> None:
        """Remove the lock file and let others have the lock."""
        if self._descriptor is not None:
            with contextlib.suppress(OSError):
                self._path.unlink()
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def lock_beside(path: Path, expected: str) -> FileLock:
    """The lock on one file, which need not exist; its folder is made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise failed(f"{path.parent}: cannot make the folder", error) from None
    return FileLock(path.with_name(f".{path.name}.lock"), expected)


def _locked(path: Path, expected: str) -> int | None:
    """The open and locked file; None where the file system has no locks."""
    while True:
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise failed(f"{path}: cannot make the lock file", error) from None
        try:
            require_own(os.fstat(descriptor), path)
        except OSError as error:
            os.close(descriptor)
            raise failed(f"{path}: cannot use the lock file", error) from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(descriptor, path):
                return descriptor
            os.close(descriptor)  # its owner removed it between the two calls
        except BlockingIOError:
            owner = _owner(descriptor)
            os.close(descriptor)
            raise InvalidInput(f"{expected}, got one in use by {owner}") from None
        except OSError:
            os.close(descriptor)
            return None


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _owner(descriptor: int) -> str:
    said = re.fullmatch(rb"pid (\d+) since ([\d :-]+ UTC)\n", os.pread(descriptor, 100, 0))
    return "another process" if said is None else f"process {int(said[1])} since {said[2].decode()}"

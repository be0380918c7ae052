"""The file in which a process keeps what its node needs again at the next start, where it needs no journal for that."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from services.runtime.files.output import replace_output

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from schemas.wire import Wire

TRIES_AGAIN_S: Final = 5.0
"""Wall time after which a write that failed is tried again."""


def kept_file(folder: Path, name: str) -> Path:
    """The file of that service in the folder of the journals."""
    return folder / f"{name}.json"


class KeptFile:
    """Holds the latest value that a node has kept; it is replaced in one step, and on the disk when that returns."""

    def __init__(self, path: Path | None, warn: Callable[[str], None]) -> None:
        """path: None: nothing is kept."""
        self._path = path
        self._warn = warn
        self._unwritten: Wire | None = None
        self._tried_at_s = 0.0

    def replace(self, value: Wire, monotonic_s: float) -> None:
        """Keep this in place of an earlier value; if that fails, a warning says so, and `tend` tries again."""
        if self._path is None:
            return
        failed_before = self._unwritten is not None
        self._unwritten, self._tried_at_s = value, monotonic_s
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            replace_output(self._path, value.model_dump_json().encode())
        except OSError as error:
            if not failed_before:
                self._warn(f"{self._path}: cannot keep for a restart what was set: {error.strerror}; it is tried again")
            return
        self._unwritten = None
        if failed_before:
            self._warn(f"{self._path}: what was set is kept for a restart again")

    def tend(self, monotonic_s: float) -> None:
        """Try again what could not be written."""
        if self._unwritten is not None and monotonic_s - self._tried_at_s >= TRIES_AGAIN_S:
            self.replace(self._unwritten, monotonic_s)

"""The file of a recording: opened without harm to the one that stands there already."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import IO

from he3.errors import He3Error


def open_recording(path: Path) -> IO[bytes]:
    """An empty file of that name, its folder made; an earlier recording is kept beside it as mission-1.mcap, -2, ...

    Raises He3Error when that cannot be done.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_file() and path.stat().st_size > 0:
            path.rename(_free_name(path))
        return path.open("wb")
    except OSError as error:
        raise He3Error(f"{path}: cannot write the recording: {error.strerror}") from None


def _free_name(path: Path) -> Path:
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(1))
    return next(name for name in names if not name.exists())

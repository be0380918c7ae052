"""The folder that `--data` names: judged before anything is computed, in one line that says what it lacks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from he3.errors import InvalidInput

_NAMED: Final = 2  # files that the line names; of more it says the number


def expect_folder(data: Path | None, page: str) -> Path:
    """The folder; raises InvalidInput if there is none. page: of the docs, which says what belongs there."""
    if data is None:
        raise _refusal(page, "none")
    if not data.is_dir():
        raise _refusal(page, f"{data}, which is {'a file' if data.exists() else 'not there'}")
    return data


def expect_rasters(data: Path | None, page: str, files: Sequence[str]) -> Path:
    """The folder, with all these files in it, named relative to it; raises InvalidInput."""
    folder = expect_folder(data, page)
    missing = [name for name in dict.fromkeys(files) if not (folder / name).is_file()]
    if missing:
        more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
        raise _refusal(page, f"{folder}, which lacks {', '.join(missing[:_NAMED])}{more}")
    return folder


def no_raster(data: Path, page: str, expected: str) -> InvalidInput:
    """The error for a folder in which none of the rasters is that a benchmark knows."""
    return _refusal(page, f"{data}, which has none: neither {expected}")


def _refusal(page: str, came: str) -> InvalidInput:
    return InvalidInput(f"expected --data DIR with the rasters ({page}), got {came}")

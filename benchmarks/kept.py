"""The file of what a benchmark finds: rows as they come, so that a run that was ended goes on from there, or all
at once.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from he3.errors import He3Error, InvalidInput
from services.runtime.files.output import replace_output

Row = dict[str, Any]


def read(path: Path | None, *lists: str) -> dict[str, Any]:
    """The document of that file with these lists of rows; empty ones without a file.

    Raises InvalidInput for a file of anything else, and for a link or a device, which `write` would replace.
    """
    if path is None or not (path.exists() or path.is_symlink()):
        return {name: [] for name in lists}
    if path.is_symlink() or not path.is_file():
        raise InvalidInput(
            f"{path}: expected a plain file, to which rows are added as they come; got a link or a device"
        )
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InvalidInput(f"{path}: expected a file of this benchmark, got no JSON: {error}") from None
    for name in lists:
        rows = document.get(name) if isinstance(document, dict) else None
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise InvalidInput(f"{path}: expected a file of this benchmark, got one without rows in '{name}'")
    return dict(document)


def expect_fields(path: Path | None, document: dict[str, Any], sums: Mapping[str, str]) -> None:
    """Note in the document which values its fields have, by a checksum for each name.

    Raises InvalidInput if the document has rows of a field with other values: a raster was changed meanwhile.
    """
    noted = document.setdefault("fields", {})
    if not isinstance(noted, dict):
        raise InvalidInput(f"{path}: expected a file of this benchmark, got one whose 'fields' are no table")
    for name, checksum in sums.items():
        if noted.setdefault(name, checksum) != checksum:
            raise InvalidInput(f"{path}: expected results of {name} as it is now, got those of other values; name "
                               "another file")  # fmt: skip


def write(path: Path | None, document: dict[str, Any]) -> None:
    """Write that file in one step, so that a run that is killed meanwhile leaves the earlier rows; None: nothing.

    Raises He3Error if it cannot be written, as on a full disk.
    """
    if path is None:
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_output(path, (json.dumps(document, indent=1) + "\n").encode())
    except OSError as error:
        raise He3Error(
            f"{path}: expected a file that can be written, got {error.strerror}; it has the earlier rows"
        ) from None


def write_whole(path: Path | str | None, document: Any) -> None:
    """Write what was found to that file, which may be a device or a link, over what it has; None: nothing.

    Raises He3Error, which names the file, if it cannot be written, as on a full disk.
    """
    if path is None:
        return
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise He3Error(f"{path}: expected a file that can be written, got {error.strerror}") from None

"""Exit codes of what cannot be written: bad input where a restart meets it again, a failure where it may pass."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from he3.errors import He3Error, InvalidInput
from services.console.report.outputs import make_folder
from services.recorder.files import open_recording
from services.runtime.event_log import EventLog
from services.runtime.files.lock import lock_beside
from services.runtime.trust.audit import AuditLog
from services.runtime.trust.private_files import make_private_folder, write_private

WRITERS: dict[str, Callable[[Path], Any]] = {
    "lock": lambda folder: lock_beside(folder / "x", "expected a file of its own"),
    "lock in a folder to make": lambda folder: lock_beside(folder / "made" / "x", "expected a file of its own"),
    "recording": lambda folder: open_recording(folder / "mission.mcap"),
    "audit log": lambda folder: AuditLog(folder / "link.jsonl", lambda: datetime.now(UTC)),
    "event log": lambda folder: EventLog(folder / "events.log"),
    "folder of outputs": lambda folder: make_folder(folder / "out"),
    "folder of keys": lambda folder: make_private_folder(folder / "keys"),
    "key": lambda folder: write_private(folder / "key.pem", b"key"),
}


@pytest.mark.parametrize(("number", "bad_input"), [(errno.EACCES, True), (errno.EROFS, True), (errno.ENOSPC, False)])
@pytest.mark.parametrize("writer", WRITERS)
def test_a_place_without_permission_is_bad_input_and_a_full_disk_is_a_failure(
    writer: str, number: int, bad_input: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "open", refused)
    monkeypatch.setattr(os, "mkdir", refused)
    with pytest.raises(He3Error, match=os.strerror(number)) as found:
        WRITERS[writer](tmp_path)
    assert isinstance(found.value, InvalidInput) is bad_input

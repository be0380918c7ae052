"""What the audit log says of a change: each value that it sets, whole, or the digest of what is too long for a line."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from schemas.commands import CommandKind, Telecommand
from schemas.link import LinkChange, LinkConditions, Window
from schemas.topics import CLOCK_SET, COMMAND, LINK_SET, Topic
from schemas.wire import Wire
from services.mission.link_presets import PRESETS, preset
from services.runtime.audit_trail import AuditTrail
from services.runtime.trust.audit import MAX_LINE_BYTES, AuditLog, file_lines, rows, verify

AT = datetime(2026, 11, 26, tzinfo=UTC)


def written(path: Path, topic: Topic, *changes: Wire) -> list[dict[str, Any]]:
    """The lines of an audit log in which these changes are written down; its chain is whole."""
    log = AuditLog(path / "link.jsonl", lambda: AT)
    trail = AuditTrail(log, pytest.fail)
    for change in changes:
        trail.changed(topic, None, change, True, 0)
    log.close()
    lines = list(file_lines(log.path))
    assert verify(lines).fault is None
    assert max(map(len, lines)) < MAX_LINE_BYTES
    return list(rows(lines))[1:]


class FullDisk:
    """The file of an audit log on a disk that is full until room is made: it takes a part of a line."""

    def __init__(self, file: Any) -> None:
        self.file = file
        self.full = True

    def write(self, content: bytes) -> int:
        if self.full and len(content) < 40:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self.file.write(content[:30] if self.full else content)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)


def test_after_a_full_disk_the_audit_log_goes_on_whole_and_says_how_many_lines_are_missing(tmp_path: Path) -> None:
    log, reports = AuditLog(tmp_path / "link.jsonl", lambda: AT), []
    disk: Any = FullDisk(log._file)
    trail = AuditTrail(log, reports.append)
    trail.changed(LINK_SET, None, LinkChange(loss=0.1), True, 0)
    log._file = disk
    for _ in range(3):
        trail.changed(LINK_SET, None, LinkChange(loss=0.2), True, 0)
    disk.full = False
    for _ in range(2):
        trail.changed(LINK_SET, None, LinkChange(loss=0.3), True, 0)
    log.close()
    lines = list(file_lines(log.path))
    assert verify(lines).fault is None
    assert [(row["what"], row.get("missed")) for row in list(rows(lines))[1:]] == [
        ('{"loss":0.1}', None), ('{"loss":0.3}', 3), ('{"loss":0.3}', None),
    ]  # fmt: skip
    assert ["No space left on device" in reports[0], "3 lines before it are missing" in reports[1]] == [True, True]
    assert len(reports) == 2


def test_an_audit_log_that_is_deleted_while_it_is_written_is_reported_once(tmp_path: Path) -> None:
    log, reports = AuditLog(tmp_path / "link.jsonl", lambda: AT), []
    trail = AuditTrail(log, reports.append)
    log.path.unlink()
    for _ in range(3):
        trail.changed(LINK_SET, None, LinkChange(loss=0.2), True, 0)
    log.close()
    assert [line.partition(";")[0] for line in reports] == [f"{log.path}: it was deleted while this process wrote it"]


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_written_down_with_each_value_that_it_sets_be_it_a_default(tmp_path: Path, name: str) -> None:
    (line,) = written(tmp_path, LINK_SET, LinkChange(conditions=preset(name), by="anna"))
    assert json.loads(line["what"]) == {"conditions": preset(name).model_dump(mode="json")}
    assert line["by"] == "anna"


@pytest.mark.parametrize(
    ("topic", "change", "what"),
    [
        (LINK_SET, LinkChange(loss=0.0), {"loss": 0.0}),
        (LINK_SET, LinkChange(contact=False), {"contact": False}),
        (LINK_SET, LinkChange(contact_as_scheduled=True), {"contact_as_scheduled": True}),
        (CLOCK_SET, CLOCK_SET.payload(rate=0.0), {"rate": 0.0}),
    ],
)
def test_only_what_a_change_sets_is_written_down_zero_and_false_included(
    tmp_path: Path, topic: Topic, change: Wire, what: dict[str, Any]
) -> None:
    (line,) = written(tmp_path, topic, change)
    assert json.loads(line["what"]) == what


def windows(count: int) -> LinkChange:
    each = tuple(Window(opens_s=10.0 * number, closes_s=10.0 * number + 5.0) for number in range(count))
    return LinkChange(conditions=LinkConditions(windows=each))


def test_what_is_too_long_for_a_line_has_its_beginning_its_length_and_its_digest(tmp_path: Path) -> None:
    whole, cut = written(tmp_path, LINK_SET, windows(100), windows(1000))
    assert len(json.loads(whole["what"])["conditions"]["windows"]) == 100
    text = json.dumps({"conditions": windows(1000).conditions.model_dump(mode="json")}, separators=(",", ":"))
    digest = hashlib.sha256(text.encode()).hexdigest()
    assert cut["what"] == f"{text[:400]}... ({len(text)} characters, SHA-256 {digest})"


def test_a_command_is_written_down_with_its_whole_order(tmp_path: Path) -> None:
    corners = tuple((float(number), 2.0 * number * number) for number in range(60))
    command = Telecommand(command_id="c1", kind=CommandKind.SET_KEEP_OUT, area_id="a" * 40, polygon_m=corners)
    (line,) = written(tmp_path, COMMAND, command)
    assert json.loads(line["order"]) == command.order.model_dump(mode="json")

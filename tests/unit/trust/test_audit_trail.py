"""What the audit log says of a change: each value that it sets, whole, or the digest of what is too long for a line."""

from __future__ import annotations

import hashlib
import json
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

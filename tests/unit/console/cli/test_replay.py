"""``he3 replay``: the intact messages of a damaged recording are printed, and missing ones are reported."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from schemas.codec import encode
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT
from schemas.wire import Header
from services.console.__main__ import main
from services.recorder.writer import RecordingWriter

MESSAGES = 12


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "mission.mcap"
    with path.open("wb") as stream, RecordingWriter(stream, "m") as writer:
        for number in range(MESSAGES):
            header = Header(mission="m", source="rover", incarnation=1, sequence=number, made_at=number)
            body = RoverEvent(kind=EventKind.PARKED, at=number, x_m=0.0, y_m=0.0, round=number)
            writer.write(EVENT, encode(header, body), number, number, number)
            if number % 3 == 2:
                writer.flush()
    return path


def test_a_whole_recording_is_replayed_without_a_complaint(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(recording), "--topic", "tm/event"]) == 0
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == MESSAGES
    assert err == ""


def test_of_a_cut_recording_one_topic_is_printed_as_far_as_it_is_whole_and_the_rest_is_said(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = recording.read_bytes()
    recording.write_bytes(whole[: len(whole) // 3])
    assert main(["replay", str(recording), "--topic", "tm/event"]) == 1
    out, err = capsys.readouterr()
    assert 0 < len(out.splitlines()) < MESSAGES
    cut, unknown = err.splitlines()
    assert cut.startswith(f"he3: {recording}: byte")
    assert "the file ends early" in cut
    assert unknown.endswith("how many messages are missing is not known: the summary of the file is lost")


def test_of_a_damaged_recording_the_summary_says_how_much_is_missing_and_where(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = bytearray(recording.read_bytes())
    at = damaged.index(b"\x04\x00\x00\x00zstd") + 30
    damaged[at] ^= 0xFF
    recording.write_bytes(damaged)
    assert main(["replay", str(recording), "--json"]) == 1
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert not document["complete"]
    assert document["messages"] == MESSAGES - 3
    where, missing = document["problems"]
    assert "between the beginning and 1970-01-01T00:00:00Z: a damaged chunk" in where
    assert missing == f"tm/event: {MESSAGES - 3} of {MESSAGES} messages are read"
    assert [line.removeprefix(f"he3: {recording}: ") for line in err.splitlines()] == [where, missing]

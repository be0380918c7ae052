"""A recording that is deleted while it is written: the log says so once, and the end of the mission once more."""

from __future__ import annotations

from pathlib import Path

import pytest

from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT
from schemas.wire import Header
from services.recorder.files import open_recording
from services.recorder.node import RecorderNode
from services.recorder.reader import Recording
from services.recorder.sink import RecordingSink
from services.runtime.node import Event, LogRecord, Received, Started, TimerFired

FLUSH = TimerFired("flush")


def message(number: int) -> Received:
    header = Header(mission="m", source="rover", incarnation=1, sequence=number, made_at=number)
    return Received(EVENT, header, RoverEvent(kind=EventKind.PARKED, at=number, x_m=0.0, y_m=0.0, round=number))


def lines(node: RecorderNode, *events: Event) -> list[str]:
    effects = [effect for now, event in enumerate(events) for effect in node.handle(event, now)]
    return [effect.text for effect in effects if isinstance(effect, LogRecord)]


def test_a_recording_that_is_deleted_while_it_is_written_is_reported_once_and_counts_every_message(
    tmp_path: Path,
) -> None:
    path = tmp_path / "mission.mcap"
    with RecordingSink(open_recording(path), "m") as sink:
        node = RecorderNode(sink, flush_s=1.0)
        assert lines(node, Started(1), message(0), FLUSH)[1:] == []
        path.unlink()
        assert lines(node, message(1), FLUSH, message(2), FLUSH, message(3)) == [
            f"{path}: the recording was deleted while it was written; the mission goes on without it"
        ]
    assert sink.problem == f"{path}: the recording was deleted while it was written: 4 of 4 messages are not recorded"
    assert not path.exists()


def test_a_recording_that_is_deleted_after_its_last_message_is_a_problem_of_the_mission(tmp_path: Path) -> None:
    path = tmp_path / "mission.mcap"
    with RecordingSink(open_recording(path), "m") as sink:
        lines(RecorderNode(sink, flush_s=1.0), Started(1), message(0), FLUSH)
        path.unlink()
    assert sink.problem == f"{path}: the recording was deleted while it was written: 1 of 1 messages are not recorded"


def test_a_deleted_recording_in_whose_place_another_file_lies_is_no_less_lost(tmp_path: Path) -> None:
    path = tmp_path / "mission.mcap"
    with RecordingSink(open_recording(path), "m") as sink:
        lines(RecorderNode(sink, flush_s=1.0), Started(1), message(0), FLUSH)
        path.unlink()
        path.write_bytes(b"somebody else's")
    assert sink.problem is not None
    assert path.read_bytes() == b"somebody else's"


def test_a_recording_that_is_moved_while_it_is_written_goes_on_under_its_other_name(tmp_path: Path) -> None:
    path, other = tmp_path / "mission.mcap", tmp_path / "kept.mcap"
    with RecordingSink(open_recording(path), "m") as sink:
        node = RecorderNode(sink, flush_s=1.0)
        lines(node, Started(1), message(0), FLUSH)
        path.rename(other)
        lines(node, message(1), FLUSH)
    assert sink.problem is None
    assert [each.header.sequence for each in Recording(other).messages()] == [0, 1]


def test_a_deleted_recording_takes_neither_memory_nor_room_on_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "mission.mcap"
    with open_recording(path) as file:
        file.write(b"x" * 1000)
        file.flush()
        path.unlink()
        file.flush()
        position = file.tell()
        file.write(b"y" * 1_000_000)
        assert file.pending_bytes == 0
        assert file.tell() == position + 1_000_000


@pytest.mark.parametrize("name", ["/dev/null", "/dev/stdout"])
def test_a_device_and_an_output_without_a_name_are_not_taken_for_deleted_files(name: str) -> None:
    with RecordingSink(open_recording(Path(name)), "m") as sink:
        lines(RecorderNode(sink, flush_s=1.0), Started(1), message(0), FLUSH)
    assert sink.problem is None

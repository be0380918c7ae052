"""A full disk: the recorder reports it once, continues, and records again when there is room."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from schemas.codec import encode
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT
from schemas.wire import Header
from services.recorder.files import RecordingFile
from services.recorder.node import RecorderNode
from services.recorder.reader import Recording
from services.recorder.sink import RecordingSink
from services.runtime.node import Effect, LogRecord, Received, SetTimer, Started, TimerFired


class Disk:
    """A raw file on a disk with room for a number of bytes; it accepts part of a write, as a real disk does."""

    def __init__(self, path: Path, room: int = 10**9) -> None:
        self.path = path
        self.room = room
        self.content = bytearray()

    def write(self, data: bytearray, /) -> int:
        if self.room == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = min(self.room, len(data))
        self.content += data[:taken]
        self.room -= taken
        return taken

    def close(self) -> None:
        self.path.write_bytes(self.content)


def sink_on(disk: Disk, max_pending_bytes: int = 10**9) -> RecordingSink:
    return RecordingSink(RecordingFile(disk.path, disk), "m", max_pending_bytes=max_pending_bytes)


def put(sink: RecordingSink, number: int) -> None:
    header = Header(mission="m", source="rover", incarnation=1, sequence=number, made_at=number)
    body = RoverEvent(kind=EventKind.PARKED, at=number, x_m=0.0, y_m=0.0, round=number)
    sink.write(EVENT, encode(header, body), number, number, number)


def numbers(recording: Recording) -> list[int]:
    return [message.header.sequence for message in recording.messages()]


def test_what_waits_in_memory_is_written_when_there_is_room_and_nothing_is_lost(tmp_path: Path) -> None:
    disk = Disk(tmp_path / "mission.mcap", room=500)
    with sink_on(disk) as sink:
        for number in range(20):
            put(sink, number)
            sink.flush()
        assert sink.failure == f"{disk.path}: No space left on device"
        disk.room = 10**9
        sink.flush()
        assert sink.failure is None
        put(sink, 20)
    assert sink.problem is None
    recording = Recording(disk.path)
    assert numbers(recording) == list(range(21))
    assert recording.whole


def test_a_disk_that_stays_full_costs_the_messages_that_did_not_fit_and_their_number_is_said(tmp_path: Path) -> None:
    disk = Disk(tmp_path / "mission.mcap", room=3000)
    with sink_on(disk) as sink:
        for number in range(40):
            put(sink, number)
            sink.flush()
    recording = Recording(disk.path)
    read = numbers(recording)
    assert 0 < len(read) < 40
    assert read == list(range(len(read)))
    assert sink.problem == (f"{disk.path}: No space left on device: {40 - len(read)} of 40 messages are not recorded")
    assert not recording.whole


def test_a_recording_of_which_only_the_summary_does_not_fit_says_so(tmp_path: Path) -> None:
    disk = Disk(tmp_path / "mission.mcap")
    with sink_on(disk) as sink:
        put(sink, 0)
        sink.flush()
        disk.room = 0
    assert sink.problem == f"{disk.path}: No space left on device: the summary is missing"
    assert numbers(Recording(disk.path)) == [0]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 2000)), max_size=12), st.integers(0, 3000))
def test_after_any_shortages_every_message_is_in_the_recording_or_counted_as_missing(
    tmp_path: Path, shortages: list[tuple[int, int]], max_pending_bytes: int
) -> None:
    disk = Disk(tmp_path / "mission.mcap", room=0)
    sink, heard = sink_on(disk, max_pending_bytes), 0
    for count, room in shortages:
        for _ in range(count):
            put(sink, heard)
            heard += 1
            sink.flush()
        disk.room += room
    disk.room = 10**9
    sink.close()
    recording = Recording(disk.path)
    read = numbers(recording)
    assert read == sorted(set(read))
    assert len(read) + sink.omitted == heard
    assert recording.whole == (sink.omitted == 0)
    mentioned = [int(line.split()[0]) for line in recording.omissions]
    assert sum(mentioned) == sink.omitted
    assert (sink.problem is None) == (sink.omitted == 0)


def test_the_recorder_reports_once_that_it_cannot_write_tries_again_and_reports_that_it_can(tmp_path: Path) -> None:
    disk = Disk(tmp_path / "mission.mcap", room=0)
    sink = sink_on(disk)
    node = RecorderNode(sink, flush_s=1.0)
    header = Header(mission="m", source="rover", incarnation=1, sequence=0, made_at=0)
    message = Received(EVENT, header, RoverEvent(kind=EventKind.PARKED, at=0, x_m=0.0, y_m=0.0, round=1))

    def records(effects: list[Effect]) -> list[str]:
        return [effect.text for effect in effects if isinstance(effect, LogRecord)]

    first = list(node.handle(Started(1), 0))
    assert records(first)[1:] == [
        f"{disk.path}: No space left on device; messages wait in memory, and writing is tried again"
    ]
    assert [effect for effect in first if isinstance(effect, SetTimer)] == [SetTimer("flush", 1_000_000_000)]
    assert list(node.handle(message, 1)) == []
    assert list(node.handle(TimerFired("flush"), 1_000_000_000)) == [SetTimer("flush", 2_000_000_000)]
    disk.room = 10**9
    last = list(node.handle(TimerFired("flush"), 2_000_000_000))
    assert records(last) == ["the recording continues"]
    assert not any(isinstance(effect, SetTimer) for effect in last)
    sink.close()
    assert numbers(Recording(disk.path)) == [0]

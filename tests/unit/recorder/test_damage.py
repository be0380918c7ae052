"""Damaged recordings: every message of a chunk that is whole is read, and no damage is silent.

What can be read at least is computed from the undamaged file: the messages of all chunks whose bytes are unchanged.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from he3.errors import InvalidInput
from schemas.codec import encode
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState
from schemas.topics import EVENT, STATE, Topic
from schemas.wire import Header, Wire
from services.recorder.reader import Recorded, Recording
from services.recorder.writer import RecordingWriter

MISSION = "m"
MESSAGES = 24


@dataclass(frozen=True)
class Original:
    """An undamaged recording, and where each chunk lies in it."""

    data: bytes
    chunks: tuple[tuple[int, int, tuple[bytes, ...]], ...]
    """First byte, end, and payloads of the messages of each chunk."""
    summary_at: int

    def whole_payloads(self, damaged: bytes) -> list[bytes]:
        """The messages of all chunks that the damaged file holds unchanged, at their places."""
        return [
            payload
            for start, end, payloads in self.chunks
            if damaged[start:end] == self.data[start:end]
            for payload in payloads
        ]

    @property
    def payloads(self) -> list[bytes]:
        return self.whole_payloads(self.data)


def message(number: int) -> tuple[Topic, Header, Wire]:
    header = Header(mission=MISSION, source="rover", incarnation=1, sequence=number, made_at=1000 + number)
    if number % 3:
        return EVENT, header, RoverEvent(kind=EventKind.PARKED, at=number, x_m=0.0, y_m=0.0, round=number)
    state = RoverState(
        mode=RoverMode.DRIVING, x_m=float(number), y_m=2.0, heading_deg=0.0, energy_wh=10.0, capacity_wh=20.0,
        driven_m=float(number), drilled_m=0.0, round=1, plan_revision=1, rounds_on_board=0, samples_done=0,
        queue_depth=0,
    )  # fmt: skip
    return STATE, header, state


@cache
def original() -> Original:
    stream = io.BytesIO()
    with RecordingWriter(stream, MISSION) as writer:
        for number in range(MESSAGES):
            topic, header, body = message(number)
            writer.write(topic, encode(header, body), 2000 + number, 1000 + number, number)
            if number % 4 == 3:
                writer.flush()
    data = stream.getvalue()
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    contents = [
        tuple(record.data for record in breakup_chunk(chunk) if isinstance(record, Message))
        for chunk in StreamReader(io.BytesIO(data), emit_chunks=True).records
        if isinstance(chunk, Chunk)
    ]
    ranges = [
        (index.chunk_start_offset, index.chunk_start_offset + index.chunk_length) for index in summary.chunk_indexes
    ]
    chunks = tuple((*part, payloads) for part, payloads in zip(ranges, contents, strict=True))
    assert len(chunks) == MESSAGES // 4
    summary_at = int.from_bytes(data[-28:-20], "little")
    return Original(data, chunks, summary_at)


def read(path: Path, data: bytes) -> tuple[list[Recorded], Recording | None]:
    """The messages read from a file of these bytes, and the recording; no recording if the file is refused."""
    path.write_bytes(data)
    recording = Recording(path)
    try:
        return list(recording.messages()), recording
    except InvalidInput:
        return [], None


def check(path: Path, damaged: bytes) -> list[str]:
    """Reads the damaged file, checks that nothing whole is lost and nothing is made up; returns its problems."""
    messages, recording = read(path, damaged)
    got = [message.payload for message in messages]
    least = original().whole_payloads(damaged)
    rest = iter(original().payloads)
    assert all(payload in rest for payload in got), "expected messages of the original, in its order"
    assert [payload for payload in got if payload in set(least)] == least
    if recording is None:
        assert not least
        return ["refused"]
    assert not recording.whole
    return recording.problems()


every_damage = settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])


@every_damage
@given(st.data())
def test_a_file_cut_at_any_byte_gives_every_message_of_its_whole_chunks_and_says_that_it_is_cut(
    tmp_path: Path, data: st.DataObject
) -> None:
    whole = original().data
    cut = data.draw(st.integers(0, len(whole) - 1))
    problems = check(tmp_path / "cut.mcap", whole[:cut])
    assert problems == ["refused"] or any("ends early" in line or "summary" in line for line in problems)


@every_damage
@given(st.data())
def test_any_changed_byte_costs_at_most_its_own_chunk_and_is_reported(tmp_path: Path, data: st.DataObject) -> None:
    damaged = bytearray(original().data)
    at = data.draw(st.integers(0, len(damaged) - 1))
    damaged[at] ^= data.draw(st.integers(1, 255))
    messages, recording = read(tmp_path / "flipped.mcap", bytes(damaged))
    assert recording is not None
    assert len(messages) >= MESSAGES - 4
    check(tmp_path / "flipped.mcap", bytes(damaged))


@every_damage
@given(st.data())
def test_any_damage_in_several_places_costs_at_most_the_chunks_that_it_touches(
    tmp_path: Path, data: st.DataObject
) -> None:
    damaged = bytearray(original().data)
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(damaged) - 1))
        junk = data.draw(st.binary(min_size=1, max_size=400))
        damaged[start : start + len(junk)] = junk[: len(damaged) - start]
    if bytes(damaged) != original().data:
        # If the chunk that introduces a channel, its second record and the summary are lost, so are the messages.
        summary_whole = bytes(damaged[original().summary_at :]) == original().data[original().summary_at :]
        if summary_whole:
            check(tmp_path / "damaged.mcap", bytes(damaged))
        else:
            _, recording = read(tmp_path / "damaged.mcap", bytes(damaged))
            assert recording is None or not recording.whole


@pytest.mark.parametrize("chunk", range(MESSAGES // 4))
@pytest.mark.parametrize("filler", [b"\x00", b"\xff", b"\x06"])
def test_a_chunk_overwritten_costs_its_messages_alone_and_they_are_counted(
    tmp_path: Path, chunk: int, filler: bytes
) -> None:
    start, end, payloads = original().chunks[chunk]
    damaged = original().data[:start] + filler * (end - start) + original().data[end:]
    messages, recording = read(tmp_path / "hole.mcap", damaged)
    assert recording is not None
    assert [m.payload for m in messages] == [p for p in original().payloads if p not in payloads]
    missing = sum((recording.recorded - recording.messages_by_topic).values()) if recording.recorded else None
    assert missing == len(payloads)
    (gap,) = recording.gaps
    assert gap.fault.start == start
    assert gap.after == (None if chunk == 0 else 2000 + 4 * chunk - 1)
    assert gap.before == (None if chunk == MESSAGES // 4 - 1 else 2000 + 4 * (chunk + 1))


def test_a_recording_without_its_summary_gives_every_message_and_says_that_the_summary_is_lost(tmp_path: Path) -> None:
    whole = original()
    messages, recording = read(tmp_path / "open.mcap", whole.data[: whole.summary_at])
    assert recording is not None
    assert [m.payload for m in messages] == whole.payloads
    assert any("the summary is damaged or cut off; it holds no messages" in line for line in recording.problems())
    assert recording.recorded is None


def test_a_cut_recording_whose_first_chunk_is_damaged_gives_the_messages_of_the_others(tmp_path: Path) -> None:
    """The topic of a channel is written beside the chunk that introduces the channel, too."""
    start, end, payloads = original().chunks[0]
    damaged = bytearray(original().data[: original().chunks[-1][1]])
    damaged[(start + end) // 2] ^= 0xFF
    messages, recording = read(tmp_path / "both.mcap", bytes(damaged))
    assert recording is not None
    assert [m.payload for m in messages] == [p for p in original().payloads if p not in payloads]


def test_a_chunk_whose_frame_is_damaged_is_read_and_the_damage_reported(tmp_path: Path) -> None:
    start = original().chunks[2][0]
    for offset in range(9):
        damaged = bytearray(original().data)
        damaged[start + offset] ^= 0x41
        messages, recording = read(tmp_path / "frame.mcap", bytes(damaged))
        assert recording is not None
        assert [m.payload for m in messages] == original().payloads
        assert "a chunk whose frame is damaged; its messages are whole" in recording.problems()[0]


def test_messages_that_this_version_refuses_are_left_out_and_counted(tmp_path: Path) -> None:
    stream = io.BytesIO()
    with RecordingWriter(stream, MISSION) as writer:
        for number in range(6):
            topic, header, body = message(number)
            payload = encode(header.model_copy(update={"mission": "other"}) if number in (1, 5) else header, body)
            writer.write(topic, payload, 2000 + number, 1000 + number, number)
    messages, recording = read(tmp_path / "other.mcap", stream.getvalue())
    assert recording is not None
    assert [m.header.sequence for m in messages] == [0, 2, 3, 4]
    assert recording.problems() == [
        "tm/event: 2 left out, the first because: he3/m/tm/event: expected mission 'm', got 'other'",
        "tm/event: 2 of 4 messages are read",
    ]


def test_a_recording_named_for_another_mission_than_its_messages_is_read_and_that_is_said(tmp_path: Path) -> None:
    damaged = original().data.replace(
        b"\x07\x00\x00\x00mission\x01\x00\x00\x00m", b"\x07\x00\x00\x00mission\x01\x00\x00\x00n", 1
    )
    assert damaged != original().data
    messages, recording = read(tmp_path / "named.mcap", damaged)
    assert recording is not None
    assert [m.payload for m in messages] == original().payloads
    assert "the recording is named 'n', its messages are of 'm'" in recording.problems()

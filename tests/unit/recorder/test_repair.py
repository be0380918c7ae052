"""Repair: a recording without its end becomes a complete file with every whole record, and other programs open it."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from he3.errors import InvalidInput
from schemas.codec import encode
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT
from schemas.wire import Header
from services.recorder.files import open_recording
from services.recorder.reader import Recorded, Recording
from services.recorder.repair import Repair, repair
from services.recorder.writer import RecordingWriter
from tests.processes import he3_here

MISSION = "m"
MESSAGES = 24


def recorded(close: bool = True) -> bytes:
    """A recording of 24 events in chunks of 4; without `close`, as a recorder that is killed leaves it."""
    stream = io.BytesIO()
    writer = RecordingWriter(stream, MISSION, about={"scenario": {"json": "{}"}})
    for number in range(MESSAGES):
        header = Header(mission=MISSION, source="rover", incarnation=1, sequence=number, made_at=1000 + number)
        body = RoverEvent(kind=EventKind.PARKED, at=number, x_m=0.0, y_m=0.0, round=number)
        writer.write(EVENT, encode(header, body), 2000 + number, 1000 + number, number)
        if number % 4 == 3:
            writer.flush(now=True)
    if close:
        writer.close()
    return stream.getvalue()


def messages(path: Path) -> list[Recorded]:
    return list(Recording(path).messages())


def as_others_read_it(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    """Topic, times, sequence and payload of each message, read with the MCAP library; it refuses a file that is not
    complete."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        found = [(c.topic, m.log_time, m.publish_time, m.sequence, m.data) for _, c, m in reader.iter_messages()]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(found)
    return found


def saved(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "mission.mcap"
    path.write_bytes(data)
    return path


def test_a_recording_that_was_not_closed_is_completed_with_all_its_messages(tmp_path: Path) -> None:
    path = saved(tmp_path, recorded(close=False))
    before = messages(path)
    assert len(before) == MESSAGES
    done = repair(path)
    assert done.messages == MESSAGES
    assert len(done.repaired) == 1
    assert "the file ends early" in done.repaired[0]
    assert (done.lost, done.kept) == ((), None)
    recording = Recording(path)
    assert list(recording.messages()) == before
    assert recording.whole
    assert recording.repairs == list(done.repaired)
    assert recording.about == {"scenario": {"json": "{}"}}
    assert as_others_read_it(path) == [
        (f"he3/{MISSION}/tm/event", 2000 + n, 1000 + n, n, before[n].payload) for n in range(MESSAGES)
    ]
    assert list(tmp_path.iterdir()) == [path]


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_recording_cut_at_any_byte_keeps_its_messages_and_others_open_it(tmp_path: Path, data: st.DataObject) -> None:
    whole = recorded()
    path = saved(tmp_path, whole[: data.draw(st.integers(300, len(whole) - 1))])
    before = messages(path)
    assert repair(path).messages == len(before)
    assert messages(path) == before
    assert len(as_others_read_it(path)) == len(before)
    assert Recording(path).problems() == []


def test_a_complete_recording_is_left_as_it_is(tmp_path: Path) -> None:
    path = saved(tmp_path, recorded())
    before = path.stat()
    assert repair(path) == Repair(path, MESSAGES)
    assert path.read_bytes() == recorded()
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def test_a_recording_is_repaired_once(tmp_path: Path) -> None:
    path = saved(tmp_path, recorded(close=False))
    repair(path)
    after = path.read_bytes()
    assert repair(path) == Repair(path, MESSAGES)
    assert path.read_bytes() == after


@pytest.mark.parametrize("close", [True, False])
def test_damage_in_the_middle_is_said_in_the_repaired_file_and_the_file_as_it_was_is_kept(
    tmp_path: Path, close: bool
) -> None:
    """The first chunk, which introduces the channel, is damaged: its four messages are lost, no others are."""
    damaged = bytearray(recorded(close))
    damaged[damaged.index(b"\x28\xb5\x2f\xfd") + 50] ^= 0xFF
    path = saved(tmp_path, bytes(damaged))
    done = repair(path)
    assert done.messages == MESSAGES - 4
    assert "a damaged chunk" in done.lost[0]
    assert done.lost[1:] == (("tm/event: 20 of 24 messages are read",) if close else ())
    assert done.kept == tmp_path / "mission-damaged-1.mcap"
    assert done.kept.read_bytes() == damaged
    recording = Recording(path)
    assert [message.header.sequence for message in recording.messages()] == list(range(4, MESSAGES))
    assert recording.problems() == list(done.lost)
    assert len(as_others_read_it(path)) == MESSAGES - 4


def test_messages_of_other_programs_and_attachments_are_kept(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=100)
    writer.start("he3-seeker", "somebody")
    writer.add_metadata("mission", {"mission": MISSION, "schema_version": "1"})
    schema = writer.register_schema("Temperature", "jsonschema", b"{}")
    for topic in ("/cabin", "/hull"):
        channel = writer.register_channel(topic, "json", schema)
        for number in range(5):
            writer.add_message(channel, number, b'{"kelvin": 250.0}', number, number)
    writer.add_attachment(1, 2, "note.txt", "text/plain", b"looked at in the morning")
    writer.flush()  # type: ignore[no-untyped-call]
    path = saved(tmp_path, stream.getvalue())
    assert messages(path) == []
    assert repair(path).messages == 10
    assert [topic for topic, *_ in as_others_read_it(path)].count("/hull") == 5
    with path.open("rb") as opened:
        reader = make_reader(opened)
        (note,) = reader.iter_attachments()
        assert note.data == b"looked at in the morning"
        assert reader.get_header().library == "somebody"
    recording = Recording(path)
    list(recording.messages())
    assert recording.foreign == {"/cabin": 5, "/hull": 5}
    assert recording.whole


def test_a_recording_is_not_repaired_while_a_recorder_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "mission.mcap"
    with open_recording(path) as file:
        file.write(recorded(close=False))
        file.flush()
        with pytest.raises(InvalidInput, match="expected a recording that no process writes, got one in use by"):
            repair(path)
        assert path.read_bytes() == recorded(close=False)
    assert repair(path).messages == MESSAGES


@pytest.mark.parametrize("data", [None, b"", b"not a recording", b"\x89MCAP0\r\n"])
def test_a_file_that_is_no_recording_is_refused_and_left_as_it_is(tmp_path: Path, data: bytes | None) -> None:
    path = tmp_path / "mission.mcap"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(InvalidInput, match=r"mission\.mcap: expected a recording"):
        repair(path)
    assert (path.read_bytes() if path.exists() else None) == data
    assert len(list(tmp_path.iterdir())) == (data is not None)


def test_the_command_says_what_it_did_and_ends_with_1_if_records_are_lost(tmp_path: Path) -> None:
    path = saved(tmp_path, recorded(close=False))
    done = he3_here("recording", "repair", str(path))
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"repaired   {path}: 24 messages\ncompleted  byte ")
    done = he3_here("recording", "repair", str(path))
    assert (done.returncode, done.stdout) == (0, f"complete   {path}: 24 messages, nothing to repair\n")
    damaged = bytearray(recorded())
    damaged[damaged.index(b"\x28\xb5\x2f\xfd") + 50] ^= 0xFF
    saved(tmp_path, bytes(damaged))
    done = he3_here("recording", "repair", str(path), "--json")
    assert done.returncode == 1
    assert '"messages": 20' in done.stdout


def test_a_topic_whose_channel_is_lost_gets_its_own_schema_again(tmp_path: Path) -> None:
    damaged = bytearray(recorded(close=False))
    damaged[damaged.index(b"\x28\xb5\x2f\xfd") + 50] ^= 0xFF
    path = saved(tmp_path, bytes(damaged))
    repair(path)
    with path.open("rb") as stream:
        schemas = {schema.name for schema, _, _ in make_reader(stream).iter_messages() if schema is not None}
    assert schemas == {"RoverEvent"}

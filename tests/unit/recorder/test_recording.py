"""Recordings: written under the schemas of their topics, and read back."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from mcap.reader import make_reader

from he3.errors import InvalidInput
from schemas.codec import encode
from schemas.link import ClockState
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState
from schemas.topics import EARTH_CLOCK, EVENT, GROUND_STATUS, PLAN, SAMPLE, STATE, Topic
from schemas.wire import Header, Wire
from services.mission.deployment import find_scenario
from services.mission.mission_time import SECOND
from services.mission.scenario import load_scenario
from services.recorder import recovery
from services.recorder.node import RECORDED, RecorderNode, build_node
from services.recorder.reader import Recording
from services.recorder.writer import RecordingWriter
from services.runtime.node import Received, SetTimer, Started

MISSION = "m"


def state(number: int) -> RoverState:
    return RoverState(
        mode=RoverMode.DRIVING, x_m=float(number), y_m=2.0, heading_deg=0.0, energy_wh=10.0, capacity_wh=20.0,
        driven_m=float(number), drilled_m=0.0, round=1, plan_revision=1, rounds_on_board=0,
        samples_done=0, queue_depth=0,
    )  # fmt: skip


def event(number: int) -> RoverEvent:
    return RoverEvent(kind=EventKind.PARKED, at=number, x_m=0.0, y_m=0.0, round=number)


def header(number: int) -> Header:
    return Header(mission=MISSION, source="rover", incarnation=1, sequence=number, made_at=1000 + number)


def write(stream: io.BytesIO, count: int, close: bool = True) -> RecordingWriter:
    writer = RecordingWriter(stream, MISSION)
    for number in range(count):
        topic: Topic = STATE if number % 2 else EVENT
        body: Wire = state(number) if number % 2 else event(number)
        writer.write(topic, encode(header(number), body), 2000 + number, 1000 + number, number)
        if number % 5 == 4:
            writer.flush()
    if close:
        writer.close()
    return writer


def saved(tmp_path: Path, data: bytes) -> Recording:
    path = tmp_path / "mission.mcap"
    path.write_bytes(data)
    return Recording(path)


def test_messages_are_read_back_in_order_with_both_their_times(tmp_path: Path) -> None:
    stream = io.BytesIO()
    write(stream, 23)
    recording = saved(tmp_path, stream.getvalue())
    messages = list(recording.messages())
    assert recording.mission == MISSION
    assert recording.whole
    assert recording.recorded == recording.messages_by_topic == {"tm/event": 12, "tm/state": 11}
    assert [(m.received_at, m.header.made_at, m.header.sequence) for m in messages] == [
        (2000 + n, 1000 + n, n) for n in range(23)
    ]
    assert messages[3].body == state(3)
    assert messages[4].topic is EVENT


def test_the_reader_of_the_mcap_library_finds_each_message_under_the_json_schema_of_its_topic() -> None:
    stream = io.BytesIO()
    write(stream, 10)
    stream.seek(0)
    reader = make_reader(stream, validate_crcs=True)
    seen = 0
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        assert schema.encoding == "jsonschema"
        assert channel.message_encoding == "json"
        assert channel.topic in {f"he3/{MISSION}/tm/state", f"he3/{MISSION}/tm/event"}
        described = json.loads(schema.data)
        body = json.loads(message.data)["body"]
        reference = described["properties"]["body"]["$ref"].rsplit("/", 1)[-1]
        assert set(body) == set(described["$defs"][reference]["properties"])
        seen += 1
    assert seen == 10
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 10


def test_a_recording_that_was_never_closed_is_read_up_to_its_last_flush(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = write(stream, 17, close=False)
    assert writer.messages == 17
    recording = saved(tmp_path, stream.getvalue())
    assert len(list(recording.messages())) == 15
    assert recording.problems() == [
        f"byte {len(stream.getvalue())}, between 1970-01-01T00:00:00Z and the end: the file ends early: "
        "it was not closed, or it is cut off",
        "how many messages are missing is not known: the summary of the file is lost",
    ]


@pytest.mark.parametrize("data", [b"", b"not a recording", b"\x89MCAP0\r\n"])
def test_a_file_that_is_not_a_recording_is_refused_in_one_line(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(InvalidInput, match=r"mission\.mcap: expected a recording"):
        list(saved(tmp_path, data).messages())


def test_a_flush_soon_after_another_does_nothing(tmp_path: Path) -> None:
    times = iter([0.0, 0.1, 0.3])
    stream = io.BytesIO()
    writer = RecordingWriter(stream, MISSION, least_flush_s=0.2, clock=lambda: next(times))
    sizes = []
    for number in range(3):
        writer.write(EVENT, encode(header(number), event(number)), number, number, number)
        writer.flush()
        sizes.append(len(stream.getvalue()))
    assert sizes[0] == sizes[1] < sizes[2]
    assert len(list(saved(tmp_path, stream.getvalue()).messages())) == 3


class Kept:
    """A sink that keeps its messages."""

    failure = None
    omitted = 0
    lost = False

    def __init__(self) -> None:
        self.written: list[tuple[str, bytes, int, int, int]] = []
        self.flushes = 0

    def write(self, topic: Topic, payload: bytes, received_at: int, made_at: int, sequence: int) -> None:
        self.written.append((topic.name, payload, received_at, made_at, sequence))

    def flush(self) -> None:
        self.flushes += 1


def test_the_recorder_writes_each_message_and_flushes_once_for_a_burst() -> None:
    sink = Kept()
    node = RecorderNode(sink, flush_s=1.0)
    list(node.handle(Started(1), 0))
    effects = [list(node.handle(Received(EVENT, header(n), event(n)), 10 + n)) for n in range(3)]
    assert effects == [[SetTimer("flush", 10 + 1_000_000_000)], [], []]
    assert [(topic, received, made, sequence) for topic, _, received, made, sequence in sink.written] == [
        ("tm/event", 10 + n, 1000 + n, n) for n in range(3)
    ]
    assert sink.written[0][1] == encode(header(0), event(0))


def test_the_recorder_flushes_by_wall_time_also_when_the_pace_of_the_mission_changes() -> None:
    def clock(rate: float) -> Received:
        body = ClockState(rate=rate, anchor_wall_ns=0, anchor_mission_ns=0, start_ns=0)
        return Received(EARTH_CLOCK, header(0), body)

    sink = Kept()
    node = build_node(load_scenario(find_scenario("short")).model_copy(update={"rate": 100.0}), sink)
    list(node.handle(Started(1), 0))
    assert list(node.handle(clock(100.0), 0)) == [SetTimer("flush", 50 * SECOND)]
    assert list(node.handle(clock(2.0), 10)) == [SetTimer("flush", 10 + SECOND)], (
        "half a second of wall time from now on"
    )
    flushed = sink.flushes
    list(node.handle(Received(EVENT, header(1), event(1)), 20))
    list(node.handle(clock(0.0), 20))
    assert sink.flushes == flushed + 1, "time stands, so no timer would come"


def test_the_recorder_subscribes_to_every_recorded_topic_on_earth_and_to_no_other() -> None:
    assert {PLAN, SAMPLE, EVENT, STATE, GROUND_STATUS} <= set(RECORDED)
    assert all(topic.recorded for topic in RECORDED)
    interface = RecorderNode(Kept(), 1.0).interface
    assert not interface.custody
    assert interface.serves == ()


def test_a_recording_that_is_read_in_parts_is_read_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory of the parts behind is let go while the file is read."""
    stream = io.BytesIO()
    with RecordingWriter(stream, MISSION) as writer:
        for number in range(500):
            writer.write(STATE, encode(header(number), state(number)), 2000 + number, 1000 + number, number)
            writer.flush(now=True)
    assert len(stream.getvalue()) > 100_000
    monkeypatch.setattr(recovery, "BLOCK_BYTES", 8192)
    recording = saved(tmp_path, stream.getvalue())
    assert [message.header.sequence for message in recording.messages()] == list(range(500))
    assert recording.whole

"""The benchmark of recordings prints all its figures; a long recording is read in bounded memory."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.recording import Read, read, repeated, run, write
from he3.errors import InvalidInput
from schemas.codec import encode
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState
from schemas.topics import EVENT, STATE
from schemas.wire import Header
from services.recorder.reader import Recorded


def flown(count: int) -> list[Recorded]:
    """Reports of a rover that drives, with an event now and then."""
    messages: list[Recorded] = []
    for number in range(count):
        header = Header(mission="m", source="rover", incarnation=1, sequence=number, made_at=number * 10**9)
        x = number * 0.1
        if number % 10:
            body: RoverState | RoverEvent = RoverState(
                mode=RoverMode.DRIVING, x_m=x, y_m=2.0, heading_deg=90.0, energy_wh=10.0, capacity_wh=20.0,
                driven_m=x, drilled_m=0.0, round=1, plan_revision=1, rounds_on_board=0, samples_done=0, queue_depth=0,
            )  # fmt: skip
        else:
            body = RoverEvent(kind=EventKind.ROUND_STARTED, at=number * 10**9, x_m=x, y_m=2.0, round=1)
        topic = STATE if number % 10 else EVENT
        messages.append(Recorded(topic, header, body, encode(header, body), number * 10**9 + 5))
    return messages


def test_the_benchmark_prints_sizes_times_and_memory(tmp_path: Path) -> None:
    said: list[str] = []
    file, target = tmp_path / "mission.mcap", tmp_path / "figures.json"
    write(file, flown(100), 10.0, foxglove=False)
    result = run(file, messages=300, flush_s=10.0, json=target, say=said.append)
    assert json.loads(target.read_text()) == json.loads(json.dumps(result))
    figures = json.loads(target.read_text())
    assert figures["plain"]["messages"] == figures["with_foxglove"]["messages"] == 100
    assert figures["plain"]["bytes"] < figures["with_foxglove"]["bytes"]
    assert [each["messages"] for each in figures["read"]] == [30, 300]
    assert all(10 < each["peak_mb"] < 1000 for each in figures["read"])
    assert len(said) == 6


def test_a_file_without_messages_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="expected a recording"):
        run(tmp_path / "none.mcap")


@pytest.mark.exhaustive
def test_two_hundred_thousand_messages_take_no_more_memory_than_a_twentieth_of_them(tmp_path: Path) -> None:
    found: list[Read] = []
    for count in (10_000, 200_000):
        write(tmp_path / "mission.mcap", repeated(flown(1000), count), 60.0, foxglove=True)
        found.append(read(tmp_path / "mission.mcap"))
    assert [each.messages for each in found] == [10_000, 200_000]
    assert found[1].bytes > found[0].bytes + 20_000_000, "expected a file larger than what may be held of it"
    assert found[1].peak_mb < found[0].peak_mb + 30

"""A recording whose records another person has written by hand: shown as text, counted, and never a defect."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer

from schemas.codec import encode
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT
from schemas.wire import Header
from services.console.__main__ import main
from services.console.report.verification import Evidence
from services.recorder.about import SCENARIO_RECORD
from services.recorder.reader import Recording
from services.recorder.writer import CHANNEL_RECORD, GAP_RECORD, MISSION_RECORD, PROFILE, REPAIR_RECORD

STEERS = "\x1b]0;mine\x07\x1b[2J\u202e"
Records = list[tuple[str, dict[str, str]]]


def recording(path: Path, records: Records, channel: tuple[str, str] | None = None) -> Path:
    """A recording of one event, with these metadata records. channel: key and topic of one that has a message, too."""
    header = Header(mission="m", source="rover", incarnation=1, sequence=0, made_at=1000)
    event = RoverEvent(kind=EventKind.PARKED, at=1, x_m=0.0, y_m=0.0, round=1)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile=PROFILE)
        for name, fields in records:
            writer.add_metadata(name, fields)
        number = writer.register_channel("he3/m/tm/event", "json", 0, {"topic": EVENT.name})
        writer.add_message(number, 1000, encode(header, event), 1000)
        if channel is not None:
            key, topic = channel
            writer.add_message(writer.register_channel(key, "json", 0, {"topic": topic}), 1000, b"{}", 1000)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "records",
    [
        [(GAP_RECORD, {"count": STEERS, "first": "9" * 30, "last": "9" * 5000})],
        [(GAP_RECORD, {"count": "9" * 5000, "first": "²", "last": STEERS})],
        [(CHANNEL_RECORD, {"id": "9" * 5000, "topic": STEERS})],
        [(REPAIR_RECORD, {"what": STEERS, "messages": "yes"})],
        [(REPAIR_RECORD, {"what": STEERS, "messages": "no"})],
        [(MISSION_RECORD, {"mission": f"../../{STEERS}"})],
        [(SCENARIO_RECORD, {"json": "{"}), (STEERS, {STEERS: STEERS})],
    ],
)
def test_a_record_of_another_s_making_steers_no_terminal_and_is_no_defect(
    records: Records, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(recording(tmp_path / "m.mcap", records))
    for words in (["replay", file], ["replay", file, "--json"], ["recording", "repair", file]):
        code = main(words)
        shown = "".join(capsys.readouterr())
        assert code in (0, 1)
        assert "defect" not in shown
        assert all(each.isprintable() for each in shown.splitlines())
    assert Recording(Path(file)).mission == ""
    assert Evidence(Path(file)).scenario is None


@pytest.mark.parametrize("key", [f"he3/m/{STEERS}", f"he3/{STEERS}/tm/event", "he3/../tm/event", f"he3{STEERS}"])
def test_a_channel_of_another_s_making_names_no_mission_and_steers_no_terminal(
    key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = recording(tmp_path / "m.mcap", [], (key, STEERS))
    found = Recording(file)
    assert [message.topic for message in found.messages()] == [EVENT]
    assert found.mission == "m"
    assert main(["replay", str(file)]) == 1
    shown = "".join(capsys.readouterr())
    assert "left out" in shown
    assert all(each.isprintable() for each in shown.splitlines())


def test_a_scenario_that_is_damaged_is_told(tmp_path: Path) -> None:
    evidence = Evidence(recording(tmp_path / "m.mcap", [(SCENARIO_RECORD, {"json": '{"name": 3}'})]))
    assert [line.split(":")[0] for line in evidence.problems] == ["the scenario of the mission is damaged"]

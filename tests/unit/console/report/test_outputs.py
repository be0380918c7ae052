"""The folder of a mission: its files belong together, and no recording is ever lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from he3.errors import He3Error
from services.console.__main__ import main
from services.console.report.outputs import Outputs, claimed
from services.recorder.files import open_recording

LEFT = {"report.json": b"{}", "map.png": b"map", "rmse.png": b"rmse", "mission.mcap": b"earlier", "notes.txt": b"mine"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder in which an earlier mission has left its files."""
    folder = tmp_path / "out"
    folder.mkdir()
    for name, content in LEFT.items():
        (folder / name).write_bytes(content)
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_recording_that_stands_there_is_set_aside_under_the_next_free_name(folder: Path) -> None:
    recording = folder / "mission.mcap"
    for content in (b"second", b"third"):
        with open_recording(recording) as stream:
            stream.write(content)
    kept = {name: content for name, content in files(folder).items() if name.endswith(".mcap")}
    assert kept == {"mission-1.mcap": b"earlier", "mission-2.mcap": b"second", "mission.mcap": b"third"}


def test_an_empty_recording_is_not_kept_and_a_folder_is_made(tmp_path: Path) -> None:
    recording = tmp_path / "made" / "here.mcap"
    for _ in range(2):
        open_recording(recording).close()
    assert files(recording.parent) == {"here.mcap": b""}


def test_a_recording_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(He3Error, match="cannot write the recording"):
        open_recording(tmp_path)


def test_what_an_earlier_mission_left_makes_way_but_not_its_recording_nor_what_is_not_its_own(folder: Path) -> None:
    elsewhere, events = folder.parent / "r.json", folder.parent / "events.log"
    elsewhere.write_text("{}")
    events.write_text("")
    with claimed(Outputs(folder, elsewhere), events):
        pass
    assert files(folder) == {name: LEFT[name] for name in ("mission.mcap", "notes.txt")}
    assert not elsewhere.exists()
    assert not events.exists()


def test_nothing_is_removed_that_is_no_file(tmp_path: Path) -> None:
    with claimed(Outputs(None, Path("/dev/null"))):
        pass
    assert Path("/dev/null").exists()
    with claimed(Outputs(tmp_path / "new", None)):
        pass
    assert files(tmp_path / "new") == {}


@pytest.mark.parametrize("driver", [["--in-process"], ["--lockstep"], ["--rate", "100"]])
def test_a_scenario_that_is_refused_leaves_every_file_as_it_was(driver: list[str], folder: Path) -> None:
    assert main(["run", "short", *driver, "-q", "--out", str(folder), "--set", "start_m=[-5,3]"]) == 2
    assert files(folder) == LEFT


def test_a_mission_that_fails_leaves_its_recording_and_nothing_of_the_one_before(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from services.mission.in_process import InProcessMission

    def fail(self: InProcessMission, *_: object) -> None:
        self.simulation.step()
        raise He3Error("it fails")

    monkeypatch.setattr(InProcessMission, "run", fail)
    assert main(["run", "short", "--in-process", "-q", "--out", str(folder)]) == 1
    left = files(folder)
    assert set(left) == {"mission.mcap", "mission-1.mcap", "notes.txt"}
    assert left["mission-1.mcap"] == LEFT["mission.mcap"]
    assert left["mission.mcap"].startswith(b"\x89MCAP0\r\n")

"""A command whose standard streams are closed, full or without a reader does its work, and its exit code is right."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from services.recorder.reader import Recording
from services.runtime.child import python_command
from tests.processes import he3, run

SHORT = ("--set", "rounds=1", "--set", "samples_per_round=1")


def without_streams() -> None:
    for number in (0, 1, 2):
        os.close(number)


@pytest.mark.parametrize("driver", ["--in-process", pytest.param("--lockstep", marks=pytest.mark.exhaustive)])
def test_a_mission_that_is_started_without_standard_streams_prints_into_none_of_its_files(
    driver: str, tmp_path: Path
) -> None:
    done = run(he3("run", "short", driver, *SHORT, "--out", str(tmp_path)), preexec_fn=without_streams)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert Recording(tmp_path / "mission.mcap").whole
    assert (tmp_path / "report.json").read_bytes().startswith(b"{")


@pytest.mark.parametrize("command", [he3("run", "nowhere"), python_command("services.rover", "nowhere")])
def test_bad_input_has_exit_code_2_whatever_becomes_of_the_message(command: list[str]) -> None:
    assert run(command).returncode == 2
    assert run(command, preexec_fn=without_streams).returncode == 2
    with Path("/dev/full").open("wb") as full:
        assert run(command, stderr=full).returncode == 2


def test_bad_input_has_exit_code_2_where_nobody_reads_the_message() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    assert run(he3("run", "nowhere"), stderr=writer).returncode == 2
    os.close(writer)


def test_a_mission_whose_progress_goes_to_a_full_disk_runs_to_its_end(tmp_path: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        done = run(he3("run", "short", "--in-process", *SHORT, "--report", str(tmp_path / "r.json")), stderr=full)
    assert done.returncode == 0
    assert (tmp_path / "r.json").exists()


def test_a_mission_of_a_user_without_a_home_prints_no_line_of_a_library_and_leaves_only_its_own_folder(
    tmp_path: Path,
) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    away = {"HOME": "/proc/none", "XDG_RUNTIME_DIR": "", "XDG_CACHE_HOME": "", "TMPDIR": str(temporary)}
    done = run(he3("run", "short", "--in-process", "-q", *SHORT, "--out", str(tmp_path / "out")), env=away)
    assert (done.returncode, done.stderr) == (0, "")
    assert [path.name for path in temporary.iterdir()] == [f"he3-seeker-{os.getuid()}"]


def test_what_is_printed_on_a_full_disk_is_a_failure_in_one_line() -> None:
    with Path("/dev/full").open("wb") as full:
        done = run(he3("--version"), stdout=full)
    assert (done.returncode, done.stderr) == (1, "he3: the system refused: No space left on device\n")


def test_the_end_of_the_reader_is_no_failure() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = run(he3("schemas"), stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")

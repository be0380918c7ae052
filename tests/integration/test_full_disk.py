"""A mission on a full disk runs to its end, and reports each output that could not be written, with the cause."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest

from schemas.report import MissionReport
from services.recorder.reader import Recording
from tests.processes import he3, run

LARGEST_FILE_BYTES = 20_000
"""The system takes no byte beyond that in any file: enough for the report, too little for recording and pictures."""


def limit_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST_FILE_BYTES, LARGEST_FILE_BYTES))


@pytest.mark.parametrize("driver", ["--in-process", pytest.param("--lockstep", marks=pytest.mark.exhaustive)])
def test_a_mission_whose_recording_and_pictures_cannot_be_written_has_its_report(driver: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    short = ("--set", "rounds=1", "--set", "samples_per_round=2", "--set", "rover.state_period_s=60")
    done = run(he3("run", "short", driver, "-q", "--out", str(out), *short), preexec_fn=limit_files)
    said = done.stderr.splitlines()
    assert done.returncode == 0, done.stderr
    report = MissionReport.model_validate_json((out / "report.json").read_bytes())
    assert report.completed
    assert not (out / "map.png").exists(), "half a picture is no picture"
    assert [f"he3: {problem}" for problem in report.output_problems] == said
    recording, *pictures = report.output_problems
    messages = len(list(Recording(out / "mission.mcap").messages()))
    assert messages > 0
    assert recording.startswith(f"{out / 'mission.mcap'}: File too large: ")
    assert recording.endswith(" messages are not recorded")
    assert pictures == [f"{out / name}: cannot write the picture: File too large" for name in ("map.png", "rmse.png")]


@pytest.mark.parametrize("driver", ["--in-process", pytest.param("--lockstep", marks=pytest.mark.exhaustive)])
def test_an_event_log_that_cannot_be_written_is_one_line_and_takes_no_event_from_the_mission(
    driver: str, tmp_path: Path
) -> None:
    short = ("--set", "rounds=1", "--set", "samples_per_round=2")
    flags = ("--report", str(tmp_path / "r.json"), "--events", "/dev/full")
    done = run(he3("run", "short", driver, "-q", *flags, *short))
    assert done.returncode == 0, done.stderr
    report = MissionReport.model_validate_json((tmp_path / "r.json").read_bytes())
    assert report.samples == 2
    (problem,) = report.output_problems
    assert problem.startswith("/dev/full: ")
    assert done.stderr == f"he3: {problem}\n"
    assert "/dev/full" not in done.stdout


def test_a_report_that_cannot_be_written_is_one_line_and_exit_code_1_and_the_summary_is_printed(
    tmp_path: Path,
) -> None:
    report = tmp_path / "full" / "report.json"
    short = ("--set", "rounds=1", "--set", "samples_per_round=2")
    command = he3("run", "short", "--in-process", "-q", "--report", str(report), *short)

    def no_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    done = run(command, preexec_fn=no_files)
    assert done.returncode == 1
    assert done.stderr == f"he3: {report}: cannot write the report: File too large\n"
    assert "samples" in done.stdout

"""A recording that is deleted during a mission: the mission ends as planned, and says in one line what is lost."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Self

from services.console.launch.in_process import run_in_process
from services.console.launch.scenarios import choose
from services.console.report.outputs import outputs
from services.console.report.progress import Moment


class Deleting:
    """A progress display that deletes a file as soon as that is there."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def show(self, now: Callable[[], Moment]) -> None:
        self.path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_a_recording_that_is_deleted_during_a_mission_is_a_problem_in_its_report_and_not_listed_as_written(
    tmp_path: Path,
) -> None:
    recording = tmp_path / "mission.mcap"
    scenario = choose("short", settings=["rounds=1", "samples_per_round=1"]).scenario
    written = run_in_process(scenario, outputs(tmp_path, None), Deleting(recording), scores_rounds=False)
    assert written.report.completed
    (problem,) = written.report.output_problems
    assert problem.startswith(f"{recording}: the recording was deleted while it was written: ")
    assert recording not in written.files
    assert tmp_path / "report.json" in written.files

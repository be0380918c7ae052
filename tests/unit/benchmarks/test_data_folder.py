"""Benchmarks that take `--data` end with one line where it names no folder, or one without the rasters they need."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks import certificate, cost, covariates, exam, few_samples, places
from he3.errors import InvalidInput
from tests.processes import he3_here

TAKE_DATA: dict[str, Callable[..., Any]] = {
    "certificate": certificate.run,
    "cost": cost.run,
    "covariates": covariates.run,
    "exam": exam.run,
    "few-samples": few_samples.run,
    "places": places.run,
}
RUNS = pytest.mark.parametrize("run", TAKE_DATA.values(), ids=TAKE_DATA)


def refusal(run: Callable[..., Any], data: Path) -> str:
    """The line of the benchmark, which has said nothing else."""
    said: list[str] = []
    with pytest.raises(InvalidInput) as refused:
        run(data, say=said.append)
    assert said == []
    assert "\n" not in str(refused.value)
    return str(refused.value)


@RUNS
def test_a_folder_without_rasters_is_one_line_that_says_what_it_lacks(run: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "readme.txt").write_text("the rasters are elsewhere")
    line = refusal(run, tmp_path)
    assert line.startswith("expected --data DIR with the rasters (docs/")
    assert f", got {tmp_path}, which " in line
    assert ".tif" in line or ".npy" in line, "a file that is expected there"


@RUNS
def test_a_folder_that_is_not_there_and_a_file_in_its_place_are_told_apart(
    run: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    assert refusal(run, tmp_path / "file").endswith(f"got {tmp_path / 'file'}, which is a file")
    assert refusal(run, tmp_path / "folder").endswith(f"got {tmp_path / 'folder'}, which is not there")


@pytest.mark.parametrize("name", TAKE_DATA)
def test_on_the_command_line_it_is_bad_input(name: str, tmp_path: Path) -> None:
    done = he3_here("bench", name, "--data", str(tmp_path))
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)


def test_of_the_places_only_those_that_are_asked_for_need_their_rasters(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"which lacks apollo17_lm_dem_5m\.npy$"):
        places.run(tmp_path, places=("apollo-17",))
    with pytest.raises(InvalidInput, match=r"and 3 more$"):
        places.run(tmp_path)


def test_fields_that_need_no_raster_are_computed_without_any(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="a first seed of 0 or more"):  # the next thing that is wrong
        covariates.run(tmp_path, fields=("t1",), seeds=0)

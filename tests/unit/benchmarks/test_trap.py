"""The benchmark of missions that begin on uniform ground."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import trap
from he3.errors import InvalidInput


@pytest.mark.parametrize("name", list(trap.PLATEAUS))
def test_each_field_has_two_levels_or_more_and_each_is_uniform(name: str) -> None:
    field = trap.plateau(name).he3_ppb
    levels, cells = np.unique(field, return_counts=True)
    assert 2 <= len(levels) <= 3
    assert cells.min() > 0.1 * field.size


def test_missions_of_both_kinds_stand_in_the_table_and_the_trapped_are_counted() -> None:
    row = {"region": "two", "planner": "tour", "field_std_ppb": 3.0, "map_std_ppb": 1.0, "coverage_68": 0.7,
           "coverage_95": 0.9, "reached_share": 1.0, "samples": 20}  # fmt: skip
    rows = [{**row, "hyperparameters": "bayes", "rmse_ppb": 1.5}, {**row, "hyperparameters": "ml", "rmse_ppb": 3.1}]
    bayes, ml = (line.split() for line in trap.table(rows)[2:4])
    assert bayes[2:6] == ["bayes", "1", "0", "0.500"]
    assert ml[2:6] == ["ml", "1", "1", "1.033"]


def test_ground_that_cannot_be_reached_is_told() -> None:
    row = {"region": "far", "planner": "tour", "hyperparameters": "bayes", "field_std_ppb": 3.0, "map_std_ppb": 1.0,
           "rmse_ppb": 1.0, "coverage_68": 0.7, "coverage_95": 0.9, "reached_share": 0.04, "samples": 20}  # fmt: skip
    assert (
        trap.table([row])[-1] == "far, tour, bayes: 4.0% of the open ground can be reached from the start; 20 samples"
    )


def test_cells_without_a_reference_have_no_part_in_the_field_s_own_deviation(tmp_path: Path) -> None:
    field = 8.0 + np.add.outer(np.zeros(40), np.arange(40.0)) / 10.0
    field[:, 30:] = np.nan
    np.savez(tmp_path / "holes", he3_ppb=field, traversable=np.isfinite(field), resolution_m=10.0)
    row = trap.fly(trap.Trial(str(tmp_path / "holes.npz"), "tour", "ml", 1, 1, "matern12", (25.0, 25.0)))
    assert row["field_std_ppb"] == pytest.approx(field[:, :30].std())


@pytest.mark.exhaustive
def test_no_mission_with_uncertain_hyperparameters_is_trapped(tmp_path: Path) -> None:
    rows = trap.run(
        starts=1, fields=("two", "island"), planners=("informative",), jobs=2, json=tmp_path / "rows.json", say=str
    )
    assert json.loads((tmp_path / "rows.json").read_text())["rows"] == rows
    assert all(row["rmse_ppb"] < row["field_std_ppb"] for row in rows if row["hyperparameters"] == "bayes")


def test_unknown_names_are_refused() -> None:
    with pytest.raises(InvalidInput, match="expected names among two, island"):
        trap.run(fields=("three",))

"""The benchmark of missions of few samples: what is flown, what is resumed, and what the table counts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import few_samples
from benchmarks.few_samples import Trial, fly, run, table
from benchmarks.missions import drawn_start, run_mission
from he3.errors import InvalidInput
from services.mission.regions import load_region

WAVES = "waves.npy"


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A folder with one small field of two waves, a wall of cells without values across it, east of the middle."""
    x, y = np.meshgrid(np.arange(40.0), np.arange(30.0))
    values = np.sin(x / 5.0) + 0.7 * np.cos(y / 4.0)
    values[:, 28] = np.nan
    folder = tmp_path / "data"
    folder.mkdir()
    np.save(folder / WAVES, values)
    return folder


def _trial(data: Path | None, planner: str = "informative", rounds: int = 1, variation: int = 1) -> Trial:
    return Trial(WAVES if data else "t1", data, "", planner, "matern52", rounds, variation)


def test_a_mission_has_a_row_for_each_kind_of_hyperparameters_on_the_same_samples(data: Path) -> None:
    bayes, ml = fly(_trial(data, rounds=2))
    assert [bayes["hyperparameters"], ml["hyperparameters"]] == ["bayes", "ml"]
    assert bayes["samples"] == bayes["taken"] == len(bayes["places_m"]) == 10
    assert bayes["rmse_ppb"] != ml["rmse_ppb"]
    assert bayes["nrmse"] == pytest.approx(bayes["rmse_ppb"] / bayes["field_std_ppb"])
    assert bayes["samples_std"] == pytest.approx(np.std(bayes["values_ppb"]) / bayes["field_std_ppb"])


def test_the_row_of_a_mission_is_what_the_mission_found(data: Path) -> None:
    row, _ = fly(_trial(data, "tour", variation=3))
    field = few_samples.load_field(WAVES, data)
    mission = run_mission(
        field.region, "tour", "matern52", 3, rounds=1, start_m=tuple(row["start_m"]), likeliest=False,
        noise_std_ppb=field.noise_std_ppb,
    )  # fmt: skip
    assert row["places_m"] == mission.samples_m.tolist()
    assert (row["coverage_68"], row["coverage_95"]) == (mission.row["coverage_68"], mission.row["coverage_95"])


def test_a_variation_of_a_given_field_has_its_own_start_and_noise_on_the_same_field(data: Path) -> None:
    one, two = (fly(_trial(data, variation=variation))[0] for variation in (1, 2))
    assert one["field_std_ppb"] == two["field_std_ppb"]
    assert one["start_m"] != two["start_m"]
    assert fly(_trial(data, variation=2))[0] == two


def test_a_variation_of_our_own_region_is_another_field_from_the_same_start() -> None:
    one, two = (fly(_trial(None, variation=variation))[0] for variation in (1, 2))
    assert one["start_m"] == two["start_m"]
    assert one["field_std_ppb"] != two["field_std_ppb"]


def test_starts_are_drawn_from_the_largest_part_of_the_open_ground(data: Path) -> None:
    region = few_samples.load_field(WAVES, data).region
    starts = np.array([drawn_start(region, np.random.default_rng(seed)) for seed in range(60)])
    assert (starts[:, 0] < 28.0).all(), "the strip east of the wall is the smaller part"
    assert len({tuple(start) for start in starts}) > 50
    assert region.traversable[region.grid.cells_of(starts)].all()
    assert np.ptp(starts[:, 0]) > 20.0
    assert np.ptp(starts[:, 1]) > 20.0


def test_the_history_of_a_mission_changes_nothing_else(quarter_of_t1: Path) -> None:
    region = load_region(quarter_of_t1)
    with_it, without = (
        run_mission(region, "tour", "matern52", 1, rounds=2, likeliest=False, history=history)
        for history in (True, False)
    )
    assert (len(with_it.rmse_history), len(without.rmse_history)) == (10, 0)
    assert (with_it.mean_ppb == without.mean_ppb).all()
    assert (with_it.std_ppb == without.std_ppb).all()
    same = {key: value for key, value in with_it.row.items() if not key.endswith("time_s")}
    assert same.items() <= without.row.items()


def test_missions_are_flown_variation_by_variation_and_are_not_flown_again(data: Path, tmp_path: Path) -> None:
    said: list[str] = []
    asked = {"planners": ("informative",), "rounds": (1, 2), "kernel": "matern52", "store": tmp_path / "few.db"}
    rows = run(data, (WAVES,), variations=2, **asked, json=tmp_path / "few.json", say=said.append)
    missions = [(row["variation"], row["samples"]) for row in rows if row["hyperparameters"] == "bayes"]
    assert missions == [(1, 5), (1, 10), (2, 5), (2, 10)]
    assert json.loads((tmp_path / "few.json").read_text())["rows"] == rows
    again = run(data, (WAVES,), variations=1, first=2, **asked, say=str)
    assert again == rows[4:]
    line = next(line for line in said if line.startswith(f"{WAVES:<14} {'informative':<12} {'5':>7}"))
    assert line.split()[3] == "2"


def test_a_mission_is_flown_again_if_the_field_of_that_name_is_another(data: Path, tmp_path: Path) -> None:
    asked = {"planners": ("informative",), "rounds": (1,), "variations": 1, "kernel": "matern52"}
    (before, _) = run(data, (WAVES,), **asked, store=tmp_path / "few.db", say=str)
    np.save(data / WAVES, np.load(data / WAVES)[::-1])
    (after, _) = run(data, (WAVES,), **asked, store=tmp_path / "few.db", say=str)
    assert before["values_ppb"] != after["values_ppb"]


def _row(planner: str, samples: int, one: float, two: float, how: str = "bayes") -> few_samples.Row:
    return {
        "field": "t1", "planner": planner, "samples": samples, "taken": samples, "variation": 1,
        "start_m": [25.0, 30.5], "hyperparameters": how, "coverage_68": one, "coverage_95": two,
        "nrmse": 0.8, "samples_std": 0.25,
    }  # fmt: skip


def test_the_table_counts_the_missions_below_either_bound_and_names_them() -> None:
    rows = [_row("tour", 10, 0.449, 0.9), _row("tour", 10, 0.75, 0.9), _row("informative", 20, 0.6, 0.79)]
    rows += [{**row, "hyperparameters": "ml", "coverage_68": 0.3, "coverage_95": 0.5} for row in rows]
    lines = table(rows)
    of = {tuple(line.split()[:3]): line.replace("|", " ").split()[3:] for line in lines}
    assert of["t1", "tour", "10"] == ["2", "60.0%", "90.0%", "1/0", "0.800", "30.0%", "50.0%", "2/2", "0.800"]
    assert of["all", "all", "all"][:4] == ["3", "60.0%", "86.3%", "1/1"]
    assert of["all", "all", "20"][:4] == ["1", "60.0%", "79.0%", "0/1"]
    assert [line for line in lines if line.startswith("  t1")] == [
        "  t1, tour, 10 samples, variation 1, from 25,30.5: 44.9% and 90.0%; the samples vary by 0.25 of the field's "
        "standard deviation",
        "  t1, informative, 20 samples, variation 1, from 25,30.5: 60.0% and 79.0%; the samples vary by 0.25 of the "
        "field's standard deviation",
    ]


def test_missions_that_ended_early_are_told() -> None:
    rows = [{**_row("tour", 10, 0.7, 0.9, how), "taken": 5} for how in ("bayes", "ml")]
    assert "missions that ended before their last round: 1" in table(rows)


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        ({"variations": 0}, "--variations: expected 1 or more, got 0"),
        ({"first": 0}, "--first: expected 1 or more, got 0"),
        ({"rounds": ()}, "--rounds: expected 1 or more, got 0"),
        ({"planners": ()}, "--planners: expected one planner or more, got none"),
        ({"kernel": "cubic"}, "expected a kernel among"),
        ({"planners": ("teleport",)}, "expected planners among|teleport"),
        ({"fields": ("nowhere",)}, "expected fields out of t1, t2"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(asked: dict[str, object], why: str) -> None:
    with pytest.raises(InvalidInput, match=why):
        run(**asked)

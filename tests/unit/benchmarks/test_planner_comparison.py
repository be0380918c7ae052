"""The comparison of planners and of kernels, on a small region from a file."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import calibration, frontier, paper
from benchmarks.flights import Flight, conditions, expect_open, flown, fly
from benchmarks.floor import Floor
from benchmarks.missions import corner_of, start_of
from benchmarks.tasks import Tasks
from he3.errors import He3Error, InvalidInput
from he3.kernels import KERNELS
from services.mission.regions import load_region


@pytest.mark.parametrize("planner", ["rrt", pytest.param("tour", marks=pytest.mark.exhaustive)])
def test_the_paper_s_table_is_printed_written_and_held_against_the_yardstick(planner, quarter_of_t1, tmp_path):
    said, out = [], tmp_path / "rows.json"
    rows = paper.run(
        seeds=1, region=quarter_of_t1, planners=("rrtstar", planner), jobs=2, floor=False, json=out, say=said.append
    )
    assert [(row["planner"], row["samples"]) for row in rows] == [("rrtstar", 150), (planner, 150)]
    assert json.loads(out.read_text()) == {"rows": rows, "floors": []}
    by_name = {row["planner"]: row for row in rows}
    ratio = by_name[planner]["path_length_m"] / by_name["rrtstar"]["path_length_m"]
    assert ratio < 0.6 if planner == "tour" else ratio > 1.0
    line = next(line for line in said if line.startswith(f"{planner} "))
    assert f"{ratio:.3f}" in line


@pytest.mark.exhaustive
def test_each_planner_is_also_held_against_the_harder_yardstick(quarter_of_t1):
    said: list[str] = []
    rows = paper.run(seeds=1, region=quarter_of_t1, planners=("rrtstar", "rrtstar-matern52"), jobs=2, floor=False,
                     say=said.append)  # fmt: skip
    assert [(row["label"], row["kernel"]) for row in rows] == [("rrtstar", "se"), ("rrtstar-matern52", "matern52")]
    stated, harder = (row["rmse_ppb"] for row in rows)
    line = next(line for line in said if line.startswith("rrtstar  "))
    assert f"1.000  1.000  {stated / harder:.3f}" in line


def test_the_floors_stand_in_the_table_each_under_its_name():
    floors = [Floor("t1", 150, None, 0.7, 0.69, 6000.0, 3, 1.0), Floor("t1", 150, 2900.0, 0.9, 0.88, 2890.0, 3, 1.0)]
    lines = paper.table({}, "t1", ("tour",), floors)
    assert any(line.startswith("floor ") and "0.7000" in line and "6000" in line for line in lines)
    assert any(line.startswith("floor-fifth ") and "0.9000" in line and "2890" in line for line in lines)
    floors = [replace(floors[0], why_not="no stationary covariance describes the field")]
    lines = paper.table({}, "t1", ("tour",), floors)
    assert any(line.startswith("floor ") and "left out: no stationary" in line for line in lines)
    assert not any("0.7000" in line for line in lines)


def test_every_kernel_is_judged_on_the_same_samples_and_the_mismatched_are_marked(quarter_of_t1):
    rows = calibration.coverage(Flight(str(quarter_of_t1), "rrtstar", "matern52", 1))
    judged = [(how, kernel) for how in ("bayes", "ml") for kernel in (*KERNELS, "auto")]
    assert [(row["hyperparameters"], row["kernel"]) for row in rows] == judged
    assert rows[-1]["chosen"] in KERNELS
    assert {row["kernel"] for row in rows if row["mismatched"]} == {"se", "matern12", "matern32", "matern52"}
    assert all(0.2 < row["coverage_68"] < row["coverage_95"] <= 1.0 for row in rows)
    likelihood = {row["kernel"]: row["log_likelihood"] for row in rows}
    assert likelihood["matern12"] > likelihood["se"], "the field's covariance is exponential, and the samples tell"
    lines = calibration.table([{**row, "region": "t1"} for row in rows], "t1", 150)
    assert sum("smooth+rough " in line for line in lines) == 2
    assert any("matern12+" in line for line in lines)
    assert any("se*" in line for line in lines)


def test_missions_whose_intervals_hold_too_little_are_counted_for_each_interval():
    held = ((0.449, 0.9), (0.45, 0.799), (0.3, 0.7), (0.7, 0.8))
    of_a_line = {"region": "t1", "planner": "tour", "hyperparameters": "bayes", "kernel": "auto", "samples": 10}
    rows = [{**of_a_line, "rmse_ppb": 1.0, "coverage_68": one, "coverage_95": two} for one, two in held]
    assert calibration.poor(rows) == (2, 2)
    line = next(line for line in calibration.table(rows, "t1", 10) if line.startswith("tour"))
    assert line.split()[-1] == "2/2"


def test_a_mission_keeps_to_the_start_the_noise_and_the_budget_of_the_comparison(quarter_of_t1):
    shared = conditions(0.0, (41.0, 31.0), 300.0)
    assert shared.on(Flight("t1", "tour", "se", 1, budget_m=200.0)).budget_m == 200.0
    flight = shared.on(Flight(str(quarter_of_t1), "rrt", "matern52", 1))
    mission, field = fly(flight), load_region(quarter_of_t1)
    assert mission.path_m[0].tolist() == [41.0, 31.0]
    assert mission.row["path_length_m"] <= 300.0
    assert np.allclose(mission.values_ppb, field.he3_ppb[field.grid.cells_of(mission.samples_m)])


@pytest.mark.parametrize(
    ("noise", "start", "budget", "why"),
    [(-1.0, (), None, "noise"), (0.1, (3.0,), None, "start X,Y"), (0.1, (), 0.0, "positive budget")],
)
def test_conditions_that_do_not_fit_are_refused(noise, start, budget, why, quarter_of_t1):
    with pytest.raises(InvalidInput, match=why):
        conditions(noise, start, budget)
    with pytest.raises(InvalidInput, match=r"quarter: expected a start on open ground within 0..250 m"):
        expect_open(load_region(quarter_of_t1), (260.0, 40.0))


def test_missions_begin_where_the_ground_is_open(quarter_of_t1):
    region = load_region(quarter_of_t1)
    assert start_of(region) == (25.0, 25.0)
    closed = region.traversable.copy()
    closed[:40, :40] = False
    x, y = start_of(replace(region, traversable=closed))
    assert max(x, y) > 40.0
    assert region.traversable[int(y), int(x)]
    walled_in = region.traversable.copy()
    walled_in[:40, 38:42] = walled_in[38:42, :40] = False
    enclosed = replace(region, traversable=walled_in)
    assert corner_of(enclosed) == (25.0, 25.0)
    assert max(start_of(enclosed)) > 40.0
    with pytest.raises(InvalidInput, match="expected some traversable ground"):
        start_of(replace(region, traversable=np.zeros_like(closed)))


def test_a_mission_that_ends_early_is_told_from_the_others(quarter_of_t1):
    flight = Flight(str(quarter_of_t1), "rrt", "matern52", 1)
    whole = fly(flight)
    short = replace(whole, row={**whole.row, "samples": 12}, ended="no place left to go to")
    assert not any(" of 150 samples" in line for line in paper.table({flight: whole}, flight.region, ("rrt",)))
    lines = paper.table({flight: short}, flight.region, ("rrt",))
    assert "rrt, seed 1: 12 of 150 samples: no place left to go to" in lines


@pytest.mark.exhaustive
def test_a_mission_that_fails_does_not_take_the_others_with_it(quarter_of_t1, tmp_path, monkeypatch):
    (tmp_path / "failing.py").write_text("def planner(request):\n    return None\n")
    monkeypatch.chdir(tmp_path)
    said, out = [], tmp_path / "rows.json"
    expected = r"1 of the missions failed, the first: failing:planner on .* a PlannedRound, got NoneType"
    with pytest.raises(He3Error, match=expected):
        paper.run(seeds=1, region=quarter_of_t1, planners=("rrt", "failing:planner"), jobs=2, floor=False,
                  json=out, out=tmp_path, say=said.append)  # fmt: skip
    assert [row["planner"] for row in json.loads(out.read_text())["rows"]] == ["rrt"]
    assert any(line.startswith("rrt ") for line in said)
    assert (tmp_path / "paper-maps.png").stat().st_size > 10_000


@pytest.mark.exhaustive
def test_missions_are_in_the_order_in_which_they_were_asked_for(quarter_of_t1):
    region = str(quarter_of_t1)
    slow, quick = Flight(region, "rrtstar", "matern52", 1), Flight(region, "rrt", "matern52", 1)
    with Tasks(2) as pool:
        completed, failures = flown([slow, quick], pool)
    assert list(completed) == [slow, quick]
    assert failures == []


@pytest.mark.parametrize("budgets", [(float("nan"),), (0.0,), ()])
def test_a_frontier_without_a_budget_is_refused(quarter_of_t1, budgets):
    with pytest.raises(InvalidInput, match="positive budgets"):
        frontier.run(seeds=1, region=quarter_of_t1, budgets=budgets)


def test_a_comparison_of_planners_that_are_not_known_is_refused(quarter_of_t1):
    with pytest.raises(InvalidInput, match="expected planners among"):
        paper.run(seeds=1, region=quarter_of_t1, planners=("teleport",))
    with pytest.raises(InvalidInput, match="expected one seed"):
        calibration.run(seeds=0, region=quarter_of_t1)


def test_the_table_has_a_deviation_over_seeds_and_none_of_one_seed():
    row = {"region": "t1", "planner": "tour", "budget_m": 500.0, "plan_time_s": 1.0, "path_length_m": 400.0}
    rows = [row | {"rmse_ppb": rmse} for rmse in (0.5, 0.7)]
    alone, both = (frontier.table(some, "t1") for some in (rows[:1], rows))
    assert alone[3].split() == ["tour", "500", "400", "0.5000", "1.0"]
    assert both[3].split() == ["tour", "500", "400", "±", "0", "0.6000", "±", "0.1414", "1.0"]
    assert len(alone[3]) == len(both[3])
    assert both[-1] == "±: standard deviation over the seeds"

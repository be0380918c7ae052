"""The floor, and missions without services, on a small region from a file."""

import json
import subprocess
import sys
from dataclasses import replace
from math import inf

import numpy as np
import pytest

from benchmarks.floor import NODES, floor, lowest_rmse, true_covariance, why_not
from benchmarks.missions import run_mission
from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.hyperparameters import Hyperparameters
from he3.i_optimal_design import AverageVariance, field_nodes
from he3.kernels import Matern12
from he3.randomfield import unit_fields
from he3.reference import Region
from services.ground.planners.interface import PlannerOptions
from services.mission.regions import load_region

QUICK = PlannerOptions(extra={"designs": 1.0, "final_steps": 0.0, "first_steps": 10.0, "steps": 4.0, "kicks": 2.0})


@pytest.fixture(scope="module")
def region(quarter_of_t1):
    return load_region(quarter_of_t1)


def test_the_floor_lies_below_a_mission_and_above_nothing(region):
    lowest = floor(region, samples=40, designs=1, steps=60, cells=100)
    assert 0 < lowest.rmse_ppb < region.he3_ppb.std()
    # What is achieved on the one field that there is depends on luck; what is to be expected of a design does not.
    truth = true_covariance(region, cells=100)
    nodes, none = field_nodes(region.grid, None, NODES), np.zeros((0, 2))
    variance = AverageVariance(truth.kernel.of_squared_distance, truth.noise_variance, nodes, none)
    mission = run_mission(region, "tour", "matern12", 1, rounds=8, options=QUICK)
    of_mission = truth.scale_ppb * np.sqrt(truth.kernel.prior_variance * variance(mission.samples_m))
    assert lowest.expected_rmse_ppb < of_mission < region.he3_ppb.std()
    assert 0.7 < lowest.length_m / (0.9 * np.sqrt(40) * 250) < 1.5
    assert lowest.expected_rmse_ppb == pytest.approx(lowest.rmse_ppb, rel=0.35)


def test_a_floor_within_a_budget_keeps_to_it_and_lies_higher(region):
    held, free = (floor(region, samples=40, designs=1, steps=30, cells=100, budget_m=metres) for metres in (700.0, inf))
    assert held.length_m <= 700.0 < free.length_m
    assert held.expected_rmse_ppb > free.expected_rmse_ppb


@pytest.fixture(scope="module")
def wide():
    """A region of 20 km of cells of 200 m, its field of exponential covariance of 4 km; a wall closes a pocket."""
    grid = SiteGrid(100, 100, 200.0)
    field = 10.0 + 3.0 * unit_fields(1, grid.shape, (200.0, 200.0), 4000.0, np.random.default_rng(4))[0]
    level, ground = np.zeros(grid.shape), np.ones(grid.shape, dtype=bool)
    ground[12, :13] = ground[:13, 12] = False
    return Region(name="wide", title="wide", provenance="made by the test", grid=grid, he3_ppb=field,
                  orbital_ppb=field.copy(), elevation_m=level, slope_deg=level.copy(), traversable=ground)  # fmt: skip


def test_on_a_large_region_the_floor_is_one_and_no_mission_comes_below_it_or_its_bound(wide):
    start = (10_100.0, 10_100.0)
    lowest = floor(wide, samples=40, designs=1, steps=20, cells=80, start_m=start)
    assert lowest.why_not == ""
    assert lowest.bound_ppb < min(lowest.expected_rmse_ppb, lowest.rmse_ppb)
    mission = run_mission(wide, "tour", "matern12", 1, rounds=8, options=QUICK, start_m=start)
    assert lowest.rmse_ppb < mission.row["rmse_ppb"] < wide.he3_ppb.std()
    truth = true_covariance(wide, cells=80)
    assert max(value for key, value in truth.kernel.parameters().items() if "length" in key) > 1000.0


def test_a_floor_from_a_pocket_of_the_ground_is_left_out_and_says_so(wide):
    lowest = floor(wide, samples=10, designs=1, steps=2, cells=40, start_m=(1100.0, 1100.0))
    assert lowest.why_not.startswith("only 1.4% of the open ground can be reached from the start")


def test_what_fills_cells_without_a_reference_has_no_part_in_the_floor(wide):
    known = np.ones(wide.grid.shape, dtype=bool)
    known[60:90, 40:80] = False
    ground = wide.traversable & known
    filled = [np.where(known, wide.he3_ppb, value) for value in (0.0, 90.0)]
    regions = [replace(wide, he3_ppb=field, known=known, traversable=ground) for field in filled]
    one, other = (
        floor(each, samples=20, designs=1, steps=4, cells=60, start_m=(10_100.0, 10_100.0)) for each in regions
    )
    assert replace(one, seconds=0.0) == replace(other, seconds=0.0)
    assert one.rmse_ppb < 2.0 * wide.he3_ppb.std()


def test_independent_cells_leave_exactly_what_is_not_measured():
    nodes = field_nodes(SiteGrid(20, 20, 1.0), None)
    truth = Hyperparameters(Matern12(variance=1.0, length_scale_m=1e-3), scale_ppb=2.0)
    assert lowest_rmse(truth, nodes, 100) == pytest.approx(2.0 * np.sqrt(0.75))
    assert lowest_rmse(truth, nodes, 0) == pytest.approx(2.0)
    assert lowest_rmse(truth, nodes, 400) == 0.0


def test_an_error_far_from_the_expected_one_or_below_the_bound_is_no_floor():
    assert why_not(1.0, 1.1, 0.9, 1.0) == ""
    assert "no stationary covariance" in why_not(2.9, 2.0, 0.9, 1.0)
    assert "no stationary covariance" in why_not(1.0, 2.0, 0.9, 1.0)
    assert "below the bound" in why_not(0.85, 1.0, 0.9, 1.0)


def test_the_true_covariance_is_that_of_the_reference_field(region):
    truth = true_covariance(region, cells=200)
    apart = np.mean((region.he3_ppb[:, 5:] - region.he3_ppb[:, :-5]) ** 2) / 2  # 10 m
    unlike = truth.kernel.prior_variance - truth.kernel.of_squared_distance(np.array([10.0**2]))[0]
    assert truth.scale_ppb**2 * unlike == pytest.approx(apart, rel=0.3)


def test_a_mission_without_services_fills_its_row(region):
    mission = run_mission(region, "tour", "matern12", 3, rounds=3, samples=4, budget_m=400.0, options=QUICK)
    row = mission.row
    assert set(row) == {
        "region", "planner", "kernel", "prior", "budget_m", "seed", "samples", "rmse_ppb", "path_length_m",
        "coverage_68", "coverage_95", "plan_time_s", "wall_time_s",
    }  # fmt: skip
    assert (row["region"], row["planner"], row["samples"], row["budget_m"]) == ("quarter", "tour", 12, 400.0)
    assert 0 < row["path_length_m"] <= 400.0
    assert len(mission.rmse_history) == 12
    assert mission.rmse_history[-1] == row["rmse_ppb"]
    assert np.hypot(*np.diff(mission.path_m, axis=0).T).sum() == pytest.approx(row["path_length_m"])
    assert json.loads(json.dumps(row)) == row


def test_a_mission_is_a_function_of_its_seed(region):
    def flown(seed):
        mission = run_mission(region, "tour", "matern12", seed, rounds=2, options=QUICK)
        return mission.row["rmse_ppb"], mission.samples_m.tobytes(), mission.values_ppb.tobytes()

    assert flown(5) == flown(5)
    assert flown(5) != flown(6)


def test_a_mission_whose_budget_runs_out_says_why(region):
    def wasteful(request):
        from dataclasses import replace

        from services.ground.planners.tour.planner import tour

        answer = tour(request)
        return replace(answer, path_m=np.vstack((answer.path_m, answer.path_m[::-1], answer.path_m)))

    mission = run_mission(region, wasteful, "matern12", 1, rounds=6, budget_m=300.0, options=QUICK)
    assert mission.row["samples"] < 30
    assert "budget is spent" in mission.ended


def test_a_prior_that_is_not_known_is_refused(region):
    with pytest.raises(InvalidInput, match="orbital"):
        run_mission(region, "tour", "matern12", 1, rounds=1, prior="radar")


@pytest.mark.exhaustive
def test_the_floor_is_printed_and_written(quarter_of_t1, tmp_path):
    out = tmp_path / "floor.json"
    quick = ["--designs", "1", "--steps", "20", "--cells", "200", "--budget", "900"]
    command = [sys.executable, "-m", "benchmarks.floor", "--region", str(quarter_of_t1), "--json", str(out), *quick]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "quarter: floor" in done.stdout
    (row,) = json.loads(out.read_text())["rows"]
    assert row["region"] == "quarter"
    assert row["length_m"] <= 900

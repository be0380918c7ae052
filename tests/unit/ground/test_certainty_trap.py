"""A belief does not become certain of what few samples cannot show, and planners leave uniform ground."""

from __future__ import annotations

import os
from math import inf
from pathlib import Path

import numpy as np
import pytest

from benchmarks.missions import START_M, run_mission
from he3.frames import BoolArray, FloatArray, SiteGrid
from he3.kernels import AUTO, KERNELS
from he3.reference import Region
from services.ground.belief import Belief
from services.ground.fitting import fit
from services.ground.observation import Observation
from services.ground.planners import planner_named
from services.ground.planners.interface import PlanningRequest
from services.mission.regions import load_region

NOISE_PPB = 0.1
GRID = SiteGrid(50, 50, 10.0)
FIVE = np.column_stack((25.0 + 30.0 * np.arange(5), np.full(5, 25.0)))  # along 120 m, of a site of 500 m


def believed(
    places_m: FloatArray, values_ppb: FloatArray, kernel: str, noise_ppb: float = NOISE_PPB, grid: SiteGrid = GRID
) -> Belief:
    """The belief after one round of these samples and its refit."""
    belief = Belief(grid, kernel, noise_ppb)
    for i, (place, value) in enumerate(zip(places_m, values_ppb, strict=True)):
        belief.add(f"s{i}", Observation((1, 1, i), (float(place[0]), float(place[1])), float(value)))
    request = belief.fit_request(1, (1,))
    assert request is not None
    belief.adopt(fit(request))
    return belief


def unexplored(places_m: FloatArray) -> BoolArray:
    """Cells (rows, columns) farther than 150 m from every sample."""
    points = GRID.points()
    near = np.min([np.hypot(*(points - place).T) for place in places_m], axis=0)
    return (near > 150.0).reshape(GRID.shape)


@pytest.mark.parametrize("kernel", [*KERNELS, AUTO])
@pytest.mark.parametrize("values", [np.full(5, 3.0), 3.0 + np.array([0.05, -0.04, 0.02, 0.06, -0.09])], ids=["=", "~"])
def test_five_equal_values_in_a_corner_do_not_make_the_rest_of_the_site_known(kernel: str, values: FloatArray) -> None:
    std = believed(FIVE, values, kernel).map.std_ppb
    assert std[unexplored(FIVE)].min() > 0.35  # the regions of 500 m that are known have 0.6 and 1.0 ppb


@pytest.mark.parametrize("kernel", list(KERNELS))
def test_one_sample_leaves_the_site_as_uncertain_as_soils_are(kernel: str) -> None:
    std = believed(FIVE[:1], np.array([3.0]), kernel).map.std_ppb
    assert std[unexplored(FIVE[:1])].min() > 1.0


@pytest.mark.parametrize("noise_ppb", [0.0, NOISE_PPB])
def test_equal_values_all_over_the_site_do_make_it_known(noise_ppb: float) -> None:
    """A belief that can fool itself in neither direction: where all is sampled and all is equal, all is equal."""
    at = 25.0 + 50.0 * np.arange(10)
    places = np.column_stack([axis.ravel() for axis in np.meshgrid(at, at)])
    belief = believed(places, np.full(100, 5.0), "smooth+rough", noise_ppb)
    assert np.abs(belief.map.mean_ppb - 5.0).max() < 0.05
    assert belief.map.std_ppb.max() < 0.3


def plateaus(kind: str) -> Region:
    """A region of 500 m, all open, whose start lies on uniform ground."""
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    if kind == "two":
        field = np.where(x + 0.6 * y < 420.0, 3.0, 10.0)
    else:
        field = np.where(np.hypot(x - 330.0, y - 300.0) < 120.0, 9.0, 3.0)
    level = np.zeros(GRID.shape)
    return Region(
        name=kind, title=kind, provenance="made by the test", grid=GRID, he3_ppb=field, orbital_ppb=field.copy(),
        elevation_m=level, slope_deg=level.copy(), traversable=np.ones(GRID.shape, dtype=np.bool_),
    )  # fmt: skip


@pytest.mark.parametrize(("kind", "planner"), [("two", "informative"), ("island", "tour")])
def test_a_mission_that_starts_on_a_plateau_finds_the_other(kind: str, planner: str) -> None:
    region = plateaus(kind)
    mission = run_mission(region, planner, "smooth+rough", 1, rounds=8, samples=5, likeliest=False)
    assert np.ptp(mission.values_ppb) > 5.0
    assert mission.row["rmse_ppb"] < region.he3_ppb.std()


@pytest.mark.parametrize("planner", ["tour", "informative"])
def test_after_five_equal_values_a_planner_explores_all_the_same(planner: str) -> None:
    belief = believed(FIVE, np.full(5, 3.0), "smooth+rough")
    request = PlanningRequest(
        grid=GRID, traversable=np.ones(GRID.shape, dtype=np.bool_), start_m=(145.0, 25.0), observed_m=FIVE,
        std_ppb=belief.map.std_ppb, hyperparameters=belief.hyperparameters, samples=5, samples_left=25, budget_m=inf,
        seed=1,
    )  # fmt: skip
    planned = planner_named(planner)(request)
    ahead = planned.samples_m if planned.outlook_m is None else np.vstack((planned.samples_m, planned.outlook_m))
    assert np.ptp(np.vstack((FIVE, ahead)), axis=0).max() > 300.0


@pytest.mark.skipif(not os.environ.get("HE3_REAL_DATA"), reason="HE3_REAL_DATA names no folder of real rasters")
def test_on_real_terrain_uniform_ground_round_the_start_does_not_make_the_rest_known() -> None:
    region = load_region(Path(os.environ["HE3_REAL_DATA"]) / "real/regions/gld_taurus.npz")
    random = np.random.default_rng(5)
    places = random.uniform(0.0, 6000.0, (10, 2))
    belief = believed(places, 3.0 + 0.1 * random.standard_normal(10), "smooth+rough", grid=region.grid)
    assert belief.map.std_ppb[200:, 200:].min() > 0.5


@pytest.mark.skipif(not os.environ.get("HE3_REAL_DATA"), reason="HE3_REAL_DATA names no folder of real rasters")
@pytest.mark.parametrize("planner", ["tour", "informative"])
def test_on_real_terrain_a_planner_leaves_the_uniform_ground_round_its_start(planner: str) -> None:
    """Steep ground all but closes in the default start: the ways out are one cell of 99 m wide."""
    region = load_region(Path(os.environ["HE3_REAL_DATA"]) / "real/regions/gld_taurus.npz")
    mission = run_mission(region, planner, "smooth+rough", 1, rounds=8, likeliest=False, start_m=START_M)
    assert np.ptp(mission.values_ppb) > 5.0
    assert mission.row["rmse_ppb"] < region.he3_ppb.std()

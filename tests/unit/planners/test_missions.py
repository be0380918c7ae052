"""Whole missions of 30 rounds, by the paper's protocol: metres and errors as published, and better where claimed."""

from functools import cache
from math import inf

import numpy as np
import pytest

from he3.gp import fit_hyperparameters
from he3.information import rmse
from he3.posterior.grid import GridPosterior
from services.ground.planners import plan
from services.ground.planners.interface import PlanningRequest
from services.mission.regions import load_region

ROUNDS, SAMPLES = 30, 5
PUBLISHED = {
    ("t1", "rrt"): (0.8347, 16829.9),
    ("t1", "rrtstar"): (0.8517, 15024.1),
    ("t2", "rrt"): (0.5318, 18588.5),
    ("t2", "rrtstar"): (0.4949, 15358.5),
}
"""RMSE [ppb] and path length [m] of the paper's one seed (facts, section 6)."""


@cache
def flown(region_name: str, planner: str, seed: int = 1) -> tuple[float, float]:
    """RMSE [ppb] on all cells and driven metres of a mission; hyperparameters are fitted again every third round."""
    region = load_region(region_name)
    rng = np.random.default_rng([seed, 7])
    start, driven = (25.0, 25.0), 0.0
    places, values = np.empty((0, 2)), np.empty(0)
    hyperparameters = fit_hyperparameters(places, values, "matern52", rng=rng)
    posterior = GridPosterior(region.grid, hyperparameters)
    for number in range(ROUNDS):
        answer = plan(
            planner,
            PlanningRequest(
                grid=region.grid,
                traversable=region.traversable,
                start_m=start,
                observed_m=places,
                std_ppb=posterior.std_ppb,
                hyperparameters=hyperparameters,
                samples=SAMPLES,
                samples_left=(ROUNDS - number) * SAMPLES,
                budget_m=inf,
                seed=1000 * seed + number,
            ),
        )
        driven += answer.length_m
        start = (float(answer.path_m[-1, 0]), float(answer.path_m[-1, 1]))
        measured = region.he3_ppb[region.grid.cells_of(answer.samples_m)] + rng.normal(0.0, 0.1, SAMPLES)
        places, values = np.vstack((places, answer.samples_m)), np.append(values, measured)
        if number % 3 == 2 or number < 2:
            hyperparameters = fit_hyperparameters(places, values, "matern52", rng=rng, previous=hyperparameters)
            posterior = GridPosterior.build(region.grid, hyperparameters, places, values)
        else:
            for place, value in zip(answer.samples_m, measured, strict=True):
                posterior.add(place, float(value))
    return rmse(region.he3_ppb, posterior.mean_ppb), driven


@pytest.mark.parametrize(
    ("region", "planner"),
    [
        pytest.param(*key, marks=[] if key == ("t1", "rrtstar") else [pytest.mark.exhaustive])
        for key in sorted(PUBLISHED)
    ],
)
def test_the_papers_planners_drive_and_err_as_published(region, planner):
    error_ppb, driven_m = flown(region, planner)
    published_ppb, published_m = PUBLISHED[region, planner]
    assert error_ppb == pytest.approx(published_ppb, rel=0.15)
    assert driven_m == pytest.approx(published_m, rel=0.2)  # 15 % in the mean of seeds; this is one


@pytest.mark.exhaustive
@pytest.mark.parametrize("region", ["t1", "t2"])
def test_rewiring_saves_at_least_eight_percent_of_the_metres(region):
    assert flown(region, "rrtstar")[1] <= 0.92 * flown(region, "rrt")[1]


@pytest.mark.exhaustive
@pytest.mark.parametrize("region", ["t1", "t2"])
def test_the_computed_utility_errs_no_more_with_six_tenths_of_the_metres(region):
    (error_ppb, driven_m), (yardstick_ppb, yardstick_m) = flown(region, "informative"), flown(region, "rrtstar")
    assert error_ppb <= 1.03 * yardstick_ppb  # less in the mean of seeds; this is one
    assert driven_m <= 0.6 * yardstick_m

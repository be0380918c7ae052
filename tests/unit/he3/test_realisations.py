"""Realisations have the belief's moments, pass through the samples, and are as rough as the field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperposterior import infer_hyperparameters
from he3.hyperprior import Hyperprior
from he3.kernels import Matern32, kernel_from
from he3.mixture import ProcessMixture
from he3.realisations import MOST_CELLS, realisations
from he3.trend import UnknownConstant
from he3.warping import Warp

GRID = SiteGrid(20, 24, 10.0)
ONE = Hyperparameters(Matern32(1.0, 60.0), 0.1, 9.0, 1.5, trend=UnknownConstant(4.0))
SPREAD = replace(ONE, alternatives=((0.7, Matern32(0.5, 80.0)), (0.3, Matern32(2.0, 40.0))))
SKEWED = replace(SPREAD, warps=(Warp(9.0, 2.0, 0.5, 1.0), None))


def known(hyperparameters: Hyperparameters, count: int = 12) -> GaussianProcess:
    random = np.random.default_rng(3)
    places = random.uniform((0.0, 0.0), (240.0, 200.0), (count, 2))
    return GaussianProcess(hyperparameters).condition(places, random.normal(9.0, 1.0, count))


@pytest.mark.parametrize("hyperparameters", [ONE, SPREAD, SKEWED])
def test_many_realisations_have_the_mean_and_the_covariance_of_the_belief(hyperparameters: Hyperparameters) -> None:
    process = known(hyperparameters)
    fields, grid = realisations(process, GRID, 6000, np.random.default_rng(1))
    assert grid == GRID
    assert fields.shape == (6000, 20, 24)
    drawn = fields.reshape(6000, -1)
    mixture = ProcessMixture.of(process)
    mean, std = mixture.predict(GRID.points())
    assert np.abs(drawn.mean(axis=0) - mean).max() < 0.06 * std.max() + 0.02
    assert np.abs(drawn.std(axis=0) / std - 1.0).max() < 0.09
    cells = np.array([0, 1, 30, 200, 479])
    exact = mixture.posterior_covariance(GRID.points()[cells])
    assert np.abs(np.cov(drawn[:, cells].T) - exact).max() < 0.12 * exact.max()


def test_a_realisation_passes_through_the_samples_and_is_as_rough_as_the_field_away_from_them() -> None:
    process = GaussianProcess(ONE).condition([[5.0, 5.0], [235.0, 195.0]], [7.0, 11.0])
    fields, _ = realisations(process, GRID, 200, np.random.default_rng(2))
    assert np.abs(fields[:, 0, 0] - 7.0).max() < 0.5
    assert np.abs(fields[:, 19, 23] - 11.0).max() < 0.5
    steps = np.diff(fields[:, 10, 8:16], axis=1)
    apart = 2.0 * 1.5**2 * (1.0 - ONE.kernel.covariance([[0.0, 0.0]], [[10.0, 0.0]])[0, 0])
    assert np.mean(steps**2) == pytest.approx(apart, rel=0.15)


def test_an_estimated_constant_is_drawn_too() -> None:
    alone = replace(ONE, trend=None, kernel=Matern32(1e-4, 1e4))
    process = GaussianProcess(alone).condition([[120.0, 100.0]] * 4, [9.0, 9.1, 8.9, 9.0])
    fields, _ = realisations(process, GRID, 2000, np.random.default_rng(2))
    assert fields.mean(axis=(1, 2)).std() == pytest.approx(0.1 / 2.0, rel=0.15), "that of the mean of four samples"


def test_the_same_seed_draws_the_same_fields_and_another_seed_others() -> None:
    process = known(SPREAD)
    once, again, other = (realisations(process, GRID, 3, np.random.default_rng(seed))[0] for seed in (5, 5, 6))
    assert np.array_equal(once, again)
    assert not np.array_equal(once, other)


def test_the_processes_of_a_mixture_take_turns_in_no_order() -> None:
    rough = replace(ONE, alternatives=((0.5, Matern32(1e-6, 80.0)), (0.5, Matern32(4.0, 20.0))))
    fields, _ = realisations(GaussianProcess(rough), GRID, 200, np.random.default_rng(4))
    smooth = fields.std(axis=(1, 2)) < 0.1
    assert 60 < smooth[:100].sum() + smooth[100:].sum() < 140
    assert 0 < smooth[:20].sum() < 20


def test_a_large_site_is_drawn_on_a_coarser_grid_and_no_value_is_below_zero() -> None:
    fitted = infer_hyperparameters(
        np.random.default_rng(2).uniform(0.0, 500.0, (12, 2)), np.full(12, 0.4), "auto", Hyperprior(500.0),
        noise_std_ppb=0.1,
    )  # fmt: skip
    fields, grid = realisations(GaussianProcess(fitted), SiteGrid(500, 500), 4, np.random.default_rng(1))
    assert grid.rows * grid.columns <= MOST_CELLS
    assert (grid.width_m, grid.resolution_m) == (500.0, 10.0)
    assert fields.min() >= 0.0


def test_a_smooth_process_known_almost_everywhere_can_be_drawn() -> None:
    points = GRID.points()[::3]
    process = GaussianProcess(Hyperparameters(kernel_from("se"), 1e-4, 9.0, 1.0)).condition(
        points, 9.0 + np.sin(points[:, 0] / 90.0)
    )
    fields, _ = realisations(process, GRID, 3, np.random.default_rng(1))
    assert fields[0].ravel() == pytest.approx(9.0 + np.sin(GRID.points()[:, 0] / 90.0), abs=0.1)

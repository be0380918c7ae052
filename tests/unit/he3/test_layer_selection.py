"""A layer gets as much room as the samples speak for."""

from __future__ import annotations

import numpy as np
import pytest

from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess
from he3.hyperposterior import infer_hyperparameters
from he3.hyperprior import Hyperprior
from he3.layer_selection import LOG_ODDS, MULTIPLES, chosen_shares
from he3.mixture import ProcessMixture
from he3.randomfield import unit_fields
from he3.trend import covariate_trend, split_by_scale

GRID = SiteGrid(40, 40, 12.0)
PRIOR = Hyperprior(480.0)


def log_evidence(covariance: FloatArray, z: FloatArray) -> float:
    return -0.5 * float(z @ np.linalg.solve(covariance, z)) - 0.5 * float(np.linalg.slogdet(covariance)[1])


def test_a_layers_room_is_the_mean_over_its_posterior_by_brute_force() -> None:
    random = np.random.default_rng(4)
    square = random.normal(size=(12, 12))
    covariance, basis = square @ square.T + np.eye(12), random.normal(size=(12, 2))
    z = random.normal(size=12) + 0.6 * basis[:, 0]
    share, always = chosen_shares(
        covariance, z, basis[:, [0, 1, 1]], np.array([0.0, 2.0]), np.array([True, False]), LOG_ODDS
    )
    rest = covariance + 5.0 * np.outer(basis[:, 1], basis[:, 1])  # a layer with twice the room, and the constant
    found = [log_evidence(rest + m**2 * np.outer(basis[:, 0], basis[:, 0]), z) for m in (0.0, *MULTIPLES)]
    weights = np.exp(np.array(found) - found[0]) * np.array([1.0, *4 * [np.exp(LOG_ODDS) / 4.0]])
    assert share == pytest.approx(float(weights[1:] @ np.array(MULTIPLES)) / weights.sum())
    assert always == 2.0


def rmse_with(layers: list[FloatArray], truth: FloatArray, seed: int, samples: int = 40) -> float:
    random = np.random.default_rng(seed)
    cells = random.choice(truth.size, samples, replace=False)
    places, values = GRID.points()[cells], truth.ravel()[cells] + 0.1 * random.normal(size=samples)
    trend = None
    if layers:
        trend = covariate_trend(GRID, split_by_scale(np.stack(layers), GRID, samples), 7.5, 4.0, split=True)
    fitted = infer_hyperparameters(places, values, "matern12", PRIOR, noise_std_ppb=0.1, trend=trend)
    mean, _ = ProcessMixture.of(GaussianProcess(fitted).condition(places, values)).predict(GRID.points())
    return float(np.sqrt(np.mean((mean - truth.ravel()) ** 2)))


def test_with_few_samples_a_layer_that_tells_helps_and_three_that_do_not_cost_next_to_nothing() -> None:
    telling, not_telling = [], []
    for seed in range(6):
        a, b, c, d, rest = unit_fields(5, GRID.shape, (12.0, 12.0), 80.0, np.random.default_rng(seed))
        truth = 8.0 + a + 0.4 * rest
        without = rmse_with([], truth, seed)
        telling.append(rmse_with([5.0 - 100.0 * a], truth, seed) / without)
        not_telling.append(rmse_with([b, c, d], truth, seed) / without)
    assert np.mean(telling) < 0.85
    assert np.median(not_telling) < 1.005
    assert np.mean(not_telling) < 1.02


def test_detail_is_left_out_where_the_wide_features_say_nothing() -> None:
    random = np.random.default_rng(2)
    layer = random.normal(size=GRID.shape)
    cells = random.choice(layer.size, 60, replace=False)
    parts = split_by_scale(layer[None], GRID, 60)
    values = 8.0 + parts[1].ravel()[cells]
    trend = covariate_trend(GRID, parts, 7.5, 4.0, split=True)
    fitted = infer_hyperparameters(GRID.points()[cells], values, "matern12", PRIOR, noise_std_ppb=0.1, trend=trend)
    assert fitted.trend_shares[0] < 0.5
    assert fitted.trend_shares[1] == 0.0

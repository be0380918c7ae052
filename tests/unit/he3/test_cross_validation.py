"""Leave-one-out cross-validation says what the belief without a sample says of that sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from he3.cross_validation import cross_validate
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperposterior import infer_hyperparameters
from he3.hyperprior import Hyperprior
from he3.kernels import Matern32
from he3.trend import UnknownConstant
from he3.warping import Warp

NOISE_PPB = 0.1
ALTERNATIVES = ((0.7, Matern32(0.5, 80.0)), (0.3, Matern32(2.0, 40.0)))
ONE = Hyperparameters(Matern32(1.0, 60.0), NOISE_PPB, 7.0, 1.5, trend=UnknownConstant(4.0))
SPREAD = replace(ONE, alternatives=ALTERNATIVES)
SKEWED = replace(SPREAD, warps=(Warp(6.0, 2.0, 0.5, 1.0), None))


def drawn(count: int, seed: int = 2, width_m: float = 200.0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random.uniform(0.0, width_m, (count, 2)), random.normal(8.0, 0.3, count)


@pytest.mark.parametrize("hyperparameters", [ONE, SPREAD])
def test_each_sample_is_predicted_as_the_belief_without_it_does(hyperparameters: Hyperparameters) -> None:
    places, values = drawn(9)
    found = cross_validate(GaussianProcess(hyperparameters).condition(places, values))
    assert len(found) == 9
    assert found.measured_ppb == pytest.approx(values)
    each = [(1.0, ONE.kernel)] if hyperparameters is ONE else ALTERNATIVES
    for left_out in range(9):
        others = np.arange(9) != left_out
        mean = second = below = 0.0
        for weight, kernel in each:
            own = GaussianProcess(replace(ONE, kernel=kernel)).condition(places[others], values[others])
            expected, std = (float(value[0]) for value in own.predict(places[left_out][None]))
            spread = np.hypot(std, NOISE_PPB)
            mean += weight * expected
            second += weight * (expected**2 + spread**2)
            below += weight * float(ndtr((values[left_out] - expected) / spread))
        assert found.expected_ppb[left_out] == pytest.approx(mean)
        assert found.std_ppb[left_out] == pytest.approx(np.sqrt(second - mean**2))
        assert found.scores[left_out] == pytest.approx(ndtri(below), abs=1e-6)


def test_of_a_skewed_field_the_moments_are_those_of_the_field_and_not_of_the_latent_one() -> None:
    places, values = drawn(9)
    process = GaussianProcess(SKEWED).condition(places, values)
    found = cross_validate(process)
    assert found.measured_ppb == pytest.approx(values)
    random = np.random.default_rng(5)
    others = np.arange(9) != 4
    draws = []
    for (weight, kernel), warp in zip(ALTERNATIVES, SKEWED.warps, strict=True):
        own = GaussianProcess(replace(ONE, kernel=kernel, warp=warp)).condition(places[others], values[others])
        mean, std = (float(value[0]) for value in own.predict_latent(places[4][None]))
        noise = float(np.ravel(own.hyperparameters.noise_variances(values[4:5]))[0])
        latent = random.normal(mean, np.hypot(std, own.hyperparameters.scale_ppb * np.sqrt(noise)), 400_000)
        draws.append((weight, latent if warp is None else warp.field(latent)))
    expected = sum(weight * each.mean() for weight, each in draws)
    variance = sum(weight * np.mean((each - expected) ** 2) for weight, each in draws)
    assert found.expected_ppb[4] == pytest.approx(expected, abs=0.02)
    assert found.std_ppb[4] == pytest.approx(np.sqrt(variance), rel=0.01)


def test_the_summary_is_that_of_the_samples() -> None:
    found = cross_validate(GaussianProcess(ONE).condition(*drawn(40)))
    away = found.measured_ppb - found.expected_ppb
    assert found.rmse_ppb == pytest.approx(np.sqrt(np.mean(away**2)))
    assert found.bias_ppb == pytest.approx(away.mean())
    assert found.score_rms == pytest.approx(np.sqrt(np.mean((away / found.std_ppb) ** 2)))
    assert found.levels == (1.0, 2.0)
    assert found.within == (np.mean(np.abs(found.scores) <= 1.0), np.mean(np.abs(found.scores) <= 2.0))


def test_samples_of_the_belief_s_own_prior_lie_within_its_intervals_as_often_as_it_says() -> None:
    random = np.random.default_rng(8)
    within, rms = [], []
    for _ in range(30):
        places = random.uniform(0.0, 400.0, (60, 2))
        covariance = ONE.kernel.covariance(places, places) + (NOISE_PPB / ONE.scale_ppb) ** 2 * np.eye(60)
        values = 7.0 + 1.5 * (np.linalg.cholesky(covariance) @ random.normal(size=60))
        found = cross_validate(GaussianProcess(replace(ONE, trend=None)).condition(places, values))
        within.append(found.within)
        rms.append(found.score_rms)
    assert np.mean(within, axis=0) == pytest.approx([0.683, 0.954], abs=0.03)
    assert np.mean(rms) == pytest.approx(1.0, abs=0.04)


def test_a_belief_that_is_too_certain_shows() -> None:
    places, values = drawn(60)
    certain = replace(ONE, kernel=Matern32(0.05, 400.0))
    found = cross_validate(GaussianProcess(certain).condition(places, values))
    assert found.score_rms > 2.0
    assert found.within[0] < 0.45


def test_one_sample_is_predicted_by_what_was_known_before_landing() -> None:
    found = cross_validate(GaussianProcess(ONE).condition([[10.0, 10.0]], [9.0]))
    assert found.expected_ppb == pytest.approx([7.0])
    assert found.std_ppb == pytest.approx([np.sqrt(1.5**2 + 4.0**2 + NOISE_PPB**2)])


def test_the_samples_of_a_mission_are_predicted_in_their_order() -> None:
    places, values = drawn(25, width_m=400.0)
    fitted = infer_hyperparameters(places, values, "auto", Hyperprior(400.0), noise_std_ppb=NOISE_PPB)
    found = cross_validate(GaussianProcess(fitted).condition(places, values))
    assert found.measured_ppb == pytest.approx(values)
    assert np.isfinite(found.std_ppb).all()
    assert (found.std_ppb >= NOISE_PPB).all()
    assert 0.0 < found.levels[0] <= found.levels[1]

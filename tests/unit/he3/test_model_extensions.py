"""Noise and anisotropy are learned where samples speak for them, and nothing is where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperposterior import infer_hyperparameters
from he3.hyperprior import Hyperprior
from he3.kernels import KERNELS, Kernel, Matern12, SmoothPlusRough, Stretched, squared_distances
from he3.mixture import ProcessMixture, alternatives_of
from he3.model_extensions import LEAST_SAMPLES, Extended, stretched
from he3.posterior.grid import GridPosterior
from he3.resource import area_mean

SITE_M = 500.0
PRIOR = Hyperprior(SITE_M)
STATED_PPB = 0.1
GRID = SiteGrid(50, 40, 10.0)
LONG_TO_NORTH_EAST = Stretched(SmoothPlusRough(0.8, 90.0, 0.1, 20.0), 5.0, 40.0)


def drawn(kernel: Kernel, count: int, noise_ppb: float, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    """Places and noisy samples of a field drawn from the kernel, with a standard deviation of 1.7 ppb and mean of 7."""
    random = np.random.default_rng(seed)
    places = random.uniform(0.0, SITE_M, (count, 2))
    half = np.linalg.cholesky(kernel.covariance(places, places) + 1e-9 * np.eye(count))
    field = 7.0 + 1.7 * half @ random.standard_normal(count)
    return places, field + random.normal(0.0, noise_ppb, count)


def learned(places: FloatArray, values: FloatArray, kernel: str = "smooth+rough") -> Hyperparameters:
    return infer_hyperparameters(places, values, kernel, PRIOR, noise_std_ppb=STATED_PPB)


def share_stretched(fitted: Hyperparameters) -> float:
    return sum(weight for weight, kernel in fitted.alternatives if isinstance(kernel, Stretched))


def test_a_field_with_two_lengths_is_found_to_have_them_and_their_bearing() -> None:
    fitted = learned(*drawn(LONG_TO_NORTH_EAST, 120, STATED_PPB))
    assert share_stretched(fitted) > 0.9
    heaviest = max(fitted.alternatives)[1]
    assert isinstance(heaviest, Stretched)
    assert heaviest.bearing_deg == pytest.approx(40.0, abs=15.0)
    assert heaviest.stretch == pytest.approx(5.0, rel=0.5)
    assert not isinstance(fitted.kernel, Stretched)


def test_a_map_that_knows_two_lengths_has_a_lower_error() -> None:
    random = np.random.default_rng(5)
    places = random.uniform(0.0, SITE_M, (480, 2))
    half = np.linalg.cholesky(LONG_TO_NORTH_EAST.covariance(places, places) + 1e-9 * np.eye(480))
    truth = 7.0 + 1.7 * half @ random.standard_normal(480)
    known, values = places[:120], truth[:120] + random.normal(0.0, STATED_PPB, 120)
    fitted = learned(known, values)
    mean, std = ProcessMixture.of(GaussianProcess(fitted).condition(known, values)).predict(places[120:])
    alone = GaussianProcess(replace(fitted, alternatives=(), noises_ppb=())).condition(known, values)
    mean_alone, _ = alone.predict(places[120:])
    error, error_alone = (np.sqrt(((found - truth[120:]) ** 2).mean()) for found in (mean, mean_alone))
    assert error < 0.9 * error_alone
    assert 0.6 < (np.abs(mean - truth[120:]) < std).mean() < 0.85


@pytest.mark.parametrize("kernel", ["smooth+rough", "matern52"])
def test_an_isotropic_field_with_the_stated_noise_gets_neither(kernel: str) -> None:
    for seed in range(3):
        fitted = learned(*drawn(KERNELS[kernel](), 60, STATED_PPB, seed), kernel)
        assert share_stretched(fitted) < 0.5
        assert fitted.noise_std_ppb < 1.5 * STATED_PPB


def test_an_instrument_that_is_worse_than_its_sheet_is_found_to_be() -> None:
    places, values = drawn(Matern12(1.0, 150.0), 60, 0.0, 4)
    twice = np.vstack((places, places))
    random = np.random.default_rng(2)
    readings = np.concatenate((values, values)) + random.normal(0.0, 8.0 * STATED_PPB, 120)
    fitted = learned(twice, readings, "matern12")
    assert fitted.noise_std_ppb == pytest.approx(8.0 * STATED_PPB, rel=0.3)
    assert min(each.noise_std_ppb for _, each in alternatives_of(fitted)) >= STATED_PPB


def test_the_learned_noise_is_never_below_the_stated_one() -> None:
    places, values = drawn(Matern12(1.0, 150.0), 40, 0.0, 3)
    fitted = infer_hyperparameters(places, values, "matern12", PRIOR, noise_std_ppb=0.8)
    assert min(each.noise_std_ppb for _, each in alternatives_of(fitted)) >= 0.8


def test_a_few_samples_speak_for_nothing() -> None:
    fitted = learned(*drawn(LONG_TO_NORTH_EAST, LEAST_SAMPLES - 1, 5.0 * STATED_PPB))
    assert share_stretched(fitted) == 0.0
    assert fitted.noises_ppb == ()


@pytest.mark.parametrize(("noise", "stretch"), [(True, False), (False, True), (True, True)])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.7, -0.4)])
def test_the_gradient_is_that_of_the_likelihood(noise: bool, stretch: bool, centre: tuple[float, float]) -> None:
    places, values = drawn(SmoothPlusRough(), 25, 0.2)
    kernel = SmoothPlusRough()
    problem = Extended(
        kernel, squared_distances(places, places), values - 7.0, None, 0.01, np.empty((0, 2)), places, noise, stretch
    )
    theta = np.array([*np.log(list(kernel.parameters().values())), *[-1.5] * noise, *centre[: 2 * stretch]])
    cost, gradient = problem.cost(theta)
    assert problem.value(theta) == pytest.approx(cost)
    for number in range(len(theta)):
        step = np.zeros(len(theta))
        step[number] = 1e-5
        expected = (problem.cost(theta + step)[0] - problem.cost(theta - step)[0]) / 2e-5
        assert gradient[number] == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_a_metric_and_its_kernel_are_the_same() -> None:
    places, _ = drawn(SmoothPlusRough(), 12, 0.1)
    a, b = 0.6, -0.5
    kernel = stretched(Matern12(), a, b)
    values, vectors = np.linalg.eigh(np.array([[a, b], [b, -a]]))
    apart = places[:, None, :] - places[None, :, :]
    squared = np.einsum("nmi,ij,nmj->nm", apart, vectors @ np.diag(np.exp(values)) @ vectors.T, apart)
    assert np.allclose(kernel.covariance(places, places), Matern12().of_squared_distance(squared), rtol=1e-6, atol=1e-9)


def test_a_map_with_two_lengths_is_the_exact_process_on_every_cell() -> None:
    places, values = drawn(LONG_TO_NORTH_EAST, 30, STATED_PPB)
    at = Hyperparameters(LONG_TO_NORTH_EAST, STATED_PPB, 7.0, 1.7)
    posterior = GridPosterior.build(GRID, at, places[:-1] * 0.8, values[:-1])
    posterior.add(places[-1] * 0.8, float(values[-1]))
    mean, std = GaussianProcess(at).condition(places * 0.8, values).predict(GRID.points())
    assert np.allclose(posterior.mean_ppb.ravel(), mean, atol=1e-3)
    assert np.allclose(posterior.std_ppb.ravel(), std, atol=1e-3)


def test_the_mean_of_an_area_counts_both_lengths() -> None:
    at = Hyperparameters(LONG_TO_NORTH_EAST, STATED_PPB, 7.0, 1.7)
    process = GaussianProcess(at)
    area = np.zeros(GRID.shape, dtype=np.bool_)
    area[5:25, 10:40] = True
    joint = process.posterior_covariance(GRID.points()[area.ravel()]).mean()
    assert area_mean(process, GRID, np.zeros(GRID.shape), area).std_ppb == pytest.approx(float(np.sqrt(joint)))
    sets = np.random.default_rng(1).uniform(0.0, 400.0, (3, 4, 2))
    assert np.allclose(process.posterior_covariances(sets)[1], process.posterior_covariance(sets[1]))

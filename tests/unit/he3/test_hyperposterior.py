"""The alternatives to the most probable hyperparameters stand for the whole posterior."""

from __future__ import annotations

import numpy as np
import pytest

from he3.frames import FloatArray
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperposterior import COMPONENTS, hyperparameter_draws, infer_hyperparameters
from he3.hyperprior import Hyperprior
from he3.kernels import Matern52, squared_distances
from he3.likelihood import log_marginal_likelihood
from he3.mixture import ProcessMixture, mixture_moments
from he3.trend import UnknownConstant

PRIOR = Hyperprior(500.0)
NOISE_PPB = 0.1
POINTS = np.random.default_rng(8).uniform(0.0, 500.0, (60, 2))


def samples(count: int) -> tuple[FloatArray, FloatArray]:
    random = np.random.default_rng(count)
    places = random.uniform(0.0, 500.0, (count, 2))
    return places, 7.0 + np.sin(places / 70.0).sum(axis=1) + random.normal(0.0, NOISE_PPB, count)


def by_quadrature(places: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation at the points, over a fine lattice of variance and length scale."""
    medians, factors = PRIOR.log_normal("matern52")
    axis = np.linspace(-4.0, 4.0, 33)
    logs, means, stds = [], [], []
    scale = PRIOR.field_std_ppb
    trend = UnknownConstant(PRIOR.mean_std_ppb)
    for u in np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2):
        kernel = Matern52(*np.exp(medians + factors * u))
        each = Hyperparameters(kernel, NOISE_PPB, PRIOR.mean_ppb, scale, trend=trend)
        basis = trend.basis(places, scale)
        z = each.standardise(places, values)
        likelihood, _ = log_marginal_likelihood(
            kernel, each.noise_variance, squared_distances(places, places), z, basis @ basis.T
        )
        mean, std = GaussianProcess(each).condition(places, values).predict(POINTS)
        logs.append(likelihood - 0.5 * float(u @ u))
        means.append(mean)
        stds.append(std)
    weights = np.exp(np.array(logs) - max(logs))
    return mixture_moments(weights / weights.sum(), np.array(means), np.array(stds))


@pytest.mark.parametrize("count", [1, 6, 30])
def test_the_mixture_has_the_moments_of_the_posterior_by_quadrature(count: int) -> None:
    places, values = samples(count)
    mean, std = by_quadrature(places, values)
    found = infer_hyperparameters(places, values, "matern52", PRIOR, noise_std_ppb=NOISE_PPB)
    mixed_mean, mixed_std = ProcessMixture.of(GaussianProcess(found).condition(places, values)).predict(POINTS)
    assert np.sqrt((((mixed_mean - mean) / std) ** 2).mean()) < 0.05
    assert np.sqrt(((mixed_std / std - 1.0) ** 2).mean()) < 0.1


def test_draws_from_the_posterior_have_its_moments_and_are_more_kernels_than_stand_for_it() -> None:
    places, values = samples(6)
    mean, std = by_quadrature(places, values)
    random = np.random.default_rng(3)
    posterior = hyperparameter_draws(places, values, "matern52", PRIOR, noise_std_ppb=NOISE_PPB)
    draws = [posterior.draw(random) for _ in range(30)]
    assert len({draw.kernel for draw in draws}) > 2 * COMPONENTS
    means, stds = zip(*(GaussianProcess(draw).condition(places, values).predict(POINTS) for draw in draws), strict=True)
    drawn_mean, drawn_std = mixture_moments(np.full(30, 1.0 / 30), np.array(means), np.array(stds))
    assert np.sqrt((((drawn_mean - mean) / std) ** 2).mean()) < 0.3
    assert np.sqrt(((drawn_std / std - 1.0) ** 2).mean()) < 0.3


def test_there_are_a_few_alternatives_and_their_weights_sum_to_one() -> None:
    for kernel in ("se", "smooth+rough"):
        found = infer_hyperparameters(*samples(9), kernel, PRIOR, noise_std_ppb=NOISE_PPB)
        assert 1 < len(found.alternatives) <= COMPONENTS
        assert sum(weight for weight, _ in found.alternatives) == pytest.approx(1.0)
        assert {alternative.name for _, alternative in found.alternatives} == {kernel}


def test_many_samples_leave_little_to_the_alternatives() -> None:
    places, values = samples(150)
    found = infer_hyperparameters(places, values, "matern52", PRIOR, noise_std_ppb=NOISE_PPB)
    process = GaussianProcess(found).condition(places, values)
    assert np.allclose(ProcessMixture.of(process).predict(POINTS)[1], process.predict(POINTS)[1], rtol=0.1)


def test_a_field_in_another_unit_is_given_room_in_that_unit() -> None:
    places, values = samples(8)
    found = infer_hyperparameters(places, 40.0 * values, "smooth+rough", PRIOR, noise_std_ppb=4.0)
    mean, std = ProcessMixture.of(GaussianProcess(found).condition(places, 40.0 * values)).predict(POINTS)
    truth = 40.0 * (7.0 + np.sin(POINTS / 70.0).sum(axis=1))
    assert (np.abs(mean - truth) < 2.0 * std).mean() > 0.9


def test_the_kernel_that_guides_planners_is_no_shorter_than_the_spacing_and_the_alternatives_may_be() -> None:
    axis = 25.0 + 50.0 * np.arange(10)
    places = np.column_stack([values.ravel() for values in np.meshgrid(axis, axis)])
    independent = np.random.default_rng(3).normal(7.0, 1.0, 100)
    found = infer_hyperparameters(places, independent, "matern12", PRIOR, noise_std_ppb=NOISE_PPB)
    assert found.kernel.parameters()["length_scale_m"] >= 40.0 - 1e-6
    assert min(kernel.parameters()["length_scale_m"] for _, kernel in found.alternatives) < 30.0

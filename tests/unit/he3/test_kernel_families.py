"""With the kernel "auto" the map is the mixture of all families of kernels, by how well they predict the samples."""

from __future__ import annotations

import numpy as np
import pytest

from he3 import hyperposterior
from he3.frames import FloatArray
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperposterior import COMPONENTS, infer_hyperparameters
from he3.hyperprior import Hyperprior
from he3.kernel_families import POWER, PRIOR_WEIGHTS, left_out, log_family_weights, log_predictive
from he3.kernels import AUTO, KERNELS, kernel_from
from he3.mixture import ProcessMixture, mixture_moments
from he3.trend import UnknownConstant

PRIOR = Hyperprior(500.0)
NOISE_PPB = 0.1
POINTS = np.random.default_rng(8).uniform(0.0, 500.0, (40, 2))
FAMILIES = ("matern12", "se")


def samples(count: int) -> tuple[FloatArray, FloatArray]:
    random = np.random.default_rng(count)
    places = random.uniform(0.0, 500.0, (count, 2))
    return places, 7.0 + np.sin(places / 70.0).sum(axis=1) + random.normal(0.0, NOISE_PPB, count)


def process(name: str, u: FloatArray) -> GaussianProcess:
    medians, factors = PRIOR.log_normal(name)
    names = kernel_from(name).parameters()
    kernel = kernel_from(name, dict(zip(names, np.exp(medians + factors * u), strict=True)))
    trend = UnknownConstant(PRIOR.mean_std_ppb)
    return GaussianProcess(Hyperparameters(kernel, NOISE_PPB, PRIOR.mean_ppb, PRIOR.field_std_ppb, trend=trend))


def normal_log_density(away: float, variance: float) -> float:
    return -0.5 * float(np.log(2.0 * np.pi * variance) + away**2 / variance)


def log_evidence(one: GaussianProcess, values: FloatArray) -> float:
    """Of a conditioned process, up to a constant."""
    whitened = one.whitened
    return -0.5 * float(whitened @ whitened) - float(np.log(np.diag(one.factor)).sum())


def test_each_sample_is_predicted_as_by_a_process_that_never_saw_it() -> None:
    places, values = samples(9)
    prior = process("matern32", np.array([0.3, -0.2]))
    found = prior.condition(places, values)
    away, variances = left_out(found.factor, found.whitened)
    scale = prior.hyperparameters.scale_ppb
    for number in range(len(values)):
        others = np.delete(np.arange(len(values)), number)
        mean, std = prior.condition(places[others], values[others]).predict(places[number : number + 1])
        assert away[number] * scale == pytest.approx(values[number] - mean[0])
        assert variances[number] * scale**2 == pytest.approx(std[0] ** 2 + NOISE_PPB**2)


def by_brute_force(name: str, places: FloatArray, values: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """A family's log density of each sample given the others, and its mean and std at the points, on a fine lattice.

    For each sample that is left out, all weights are found anew from the others.
    """
    axis = np.linspace(-3.5, 3.5, 13)
    lattice = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    priors = [process(name, u) for u in lattice]
    of_prior = -0.5 * (lattice * lattice).sum(axis=1)

    def mixed(known: FloatArray, at: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        each = [prior.condition(places, known) for prior in priors]
        logs = of_prior + np.array([log_evidence(one, known) for one in each])
        weights = np.exp(logs - logs.max())
        means, stds = zip(*(one.predict(at) for one in each), strict=True)
        return mixture_moments(weights / weights.sum(), np.array(means), np.array(stds))

    total = 0.0
    for number in range(len(values)):
        others = np.delete(np.arange(len(values)), number)
        mean, std = mixed(values[others], places[number : number + 1], places[others])
        scale = PRIOR.field_std_ppb
        away, variance = (values[number] - mean[0]) / scale, (std[0] ** 2 + NOISE_PPB**2) / scale**2
        total += normal_log_density(away, variance)
    return total, *mixed(values, POINTS, places)


def test_the_map_has_the_moments_of_all_families_by_quadrature(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hyperposterior, "CAUTIOUS_FIRST", FAMILIES)
    places, values = samples(6)
    predictive, means, stds = zip(*(by_brute_force(name, places, values) for name in FAMILIES), strict=True)
    weights = np.array([PRIOR_WEIGHTS[name] for name in FAMILIES]) * np.exp(POWER * (np.array(predictive)))
    mean, std = mixture_moments(weights / weights.sum(), np.array(means), np.array(stds))
    found = infer_hyperparameters(places, values, AUTO, PRIOR, noise_std_ppb=NOISE_PPB)
    mixed_mean, mixed_std = ProcessMixture.of(GaussianProcess(found).condition(places, values)).predict(POINTS)
    assert np.sqrt((((mixed_mean - mean) / std) ** 2).mean()) < 0.05
    assert np.sqrt(((mixed_std / std - 1.0) ** 2).mean()) < 0.1


def test_a_family_that_predicts_better_counts_more_and_none_is_left_out_for_a_little() -> None:
    names = list(PRIOR_WEIGHTS)
    alike = np.exp(log_family_weights(names, [-50.0] * len(names)))
    assert alike == pytest.approx(np.array(list(PRIOR_WEIGHTS.values())) / sum(PRIOR_WEIGHTS.values()))
    better = np.exp(log_family_weights(names, [-50.0] * (len(names) - 1) + [-45.0]))
    assert better.sum() == pytest.approx(1.0)
    assert better[-1] / better[0] == pytest.approx(np.exp(5.0 * POWER) * alike[-1] / alike[0])


def test_what_even_samples_say_for_a_smooth_kernel_does_not_leave_out_the_rough_ones() -> None:
    """150 samples of Walker Lake, 21 m apart, spoke for these kernels so; `se` held 65 of 95 % of the other cells."""
    said = {"smooth+rough": -231.6, "matern12": -275.7, "matern32": -259.0, "matern52": -250.1, "se": -226.2}
    weights = dict(zip(said, np.exp(log_family_weights(list(said), list(said.values()))), strict=True))
    assert weights["smooth+rough"] + weights["matern12"] > 0.8


def test_the_smoother_a_kernel_the_more_must_speak_for_it() -> None:
    ordered = [PRIOR_WEIGHTS[name] for name in ("matern12", "matern32", "matern52", "se")]
    assert ordered == sorted(ordered, reverse=True)


def test_a_predictive_density_without_samples_is_that_of_nothing() -> None:
    assert log_predictive(np.zeros(1), np.ones((1, 2, 0))) == 0.0


def test_auto_mixes_several_families_of_kernels_and_is_the_same_each_time() -> None:
    for count in (1, 12):
        found, again = (infer_hyperparameters(*samples(count), AUTO, PRIOR, noise_std_ppb=NOISE_PPB) for _ in range(2))
        assert found == again
        assert 1 < len(found.alternatives) <= COMPONENTS
        assert sum(weight for weight, _ in found.alternatives) == pytest.approx(1.0)
        assert len({kernel.name for _, kernel in found.alternatives}) > 1


def test_every_family_of_kernels_has_a_prior_weight() -> None:
    assert set(PRIOR_WEIGHTS) == set(KERNELS)

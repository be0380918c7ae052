"""Quiet and rough parts are recognised from the samples, and a field without any is left as it was."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import cholesky

import he3.hyperposterior
from he3.amplitude_inference import (
    LEAST_SAMPLES,
    MOST,
    STD,
    _Amplitudes,
    _prior_stds,
    _State,
    local_member,
    with_local_members,
)
from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperposterior import hyperparameter_draws, infer_hyperparameters
from he3.hyperprior import Hyperprior
from he3.kernels import AUTO, Matern12, Matern32
from he3.local_amplitude import LocalAmplitude, LocallyScaled, limited, modes, waves
from he3.mixture import ProcessMixture
from he3.trend import UnknownConstant, orbital_trend
from he3.warping import Warp

WIDTH_M = 500.0
GRID = SiteGrid(25, 25, 20.0)
NOISE_PPB = 0.1
WEST_TO_EAST = LocalAmplitude(WIDTH_M, tuple(-1.5 if mode == (1, 0) else 0.0 for mode in modes()))
"""Plains in the west, mountains in the east: six times as much variation."""


@cache
def drawn(seed: int, count: int, uneven: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places (n, 2) [m] and values (n,) [ppb] of samples, and the field on all cells."""
    random = np.random.default_rng(seed)
    cells = GRID.points()
    factor = cholesky(Matern32(1.5**2, 90.0).covariance(cells, cells) + 1e-8 * np.eye(len(cells)), lower=True)
    even = factor @ random.standard_normal(len(cells))
    field = 8.0 + (WEST_TO_EAST.at(cells) * even if uneven else even)
    chosen = random.choice(len(cells), count, replace=False)
    return cells[chosen], field[chosen] + NOISE_PPB * random.standard_normal(count), field


def inferred(places: FloatArray, values: FloatArray, kernel: str = AUTO) -> Hyperparameters:
    return infer_hyperparameters(places, values, kernel, Hyperprior(WIDTH_M), noise_std_ppb=NOISE_PPB)


def weight_of_local(found: Hyperparameters) -> float:
    return sum(weight for weight, kernel in found.alternatives if isinstance(kernel, LocallyScaled))


def nlpd(found: Hyperparameters, places: FloatArray, values: FloatArray, field: FloatArray) -> float:
    mean, std = ProcessMixture.of(GaussianProcess(found).condition(places, values)).predict(GRID.points())
    return float(np.mean(0.5 * np.log(2.0 * np.pi * std**2) + 0.5 * ((field - mean) / std) ** 2))


def without_local(monkeypatch: pytest.MonkeyPatch, places: FloatArray, values: FloatArray) -> Hyperparameters:
    with monkeypatch.context() as patch:
        patch.setattr(he3.hyperposterior, "with_local_members", lambda mixture, *_: mixture)
        return inferred(places, values)


def test_plains_beside_mountains_are_recognised_and_their_map_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    weights, gains = [], []
    for seed in range(3):
        places, values, field = drawn(seed, 120, True)
        plain = without_local(monkeypatch, places, values)
        found = with_local_members(plain, places, values, WIDTH_M, GRID.points()[::17], 6)
        weights.append(weight_of_local(found))
        gains.append(nlpd(plain, places, values, field) - nlpd(found, places, values, field))
        for _, kernel in found.alternatives:
            if isinstance(kernel, LocallyScaled):
                west, east = kernel.amplitude.at(np.array([[60.0, 250.0], [440.0, 250.0]]))
                assert east > 2.0 * west
    assert np.mean(weights) > 0.5
    assert min(weights) > 0.35  # four times what it is before any sample
    assert max(weights) < MOST + 0.1  # the moments of a few members are kept, and their weights nearly so
    assert np.mean(gains) > 0.1
    assert min(gains) > 0.0


@pytest.mark.parametrize("count", [20, 120])
def test_an_even_field_is_left_as_it_was(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    changes, weights = [], []
    for seed in range(5):
        places, values, field = drawn(seed, count, False)
        plain = without_local(monkeypatch, places, values)
        found = with_local_members(plain, places, values, WIDTH_M, GRID.points()[::17], 6)
        weights.append(weight_of_local(found))
        assert (found is plain) == (weights[-1] == 0.0)
        changes.append(nlpd(found, places, values, field) - nlpd(plain, places, values, field))
    assert np.mean(weights) < 0.1
    assert np.mean(changes) < 0.005
    assert max(changes) < 0.03


def problem(warp: Warp | None = None, count: int = 25) -> tuple[_Amplitudes, FloatArray]:
    places, values, _ = drawn(1, count, True)
    own = Hyperparameters(Matern12(1.0, 120.0), NOISE_PPB, 8.0, 1.5, trend=UnknownConstant(4.0), warp=warp)
    return _Amplitudes.of(own, places, values), waves(places, WIDTH_M) * _prior_stds()


def log_posterior(asked: _Amplitudes, u: FloatArray, columns: FloatArray) -> float:
    """By the textbook, less a constant."""
    amplitude = np.exp(limited(columns @ u))
    total = asked.covariance * np.outer(amplitude, amplitude) + asked.others
    _, determinant = np.linalg.slogdet(total)
    return -0.5 * float(asked.z @ np.linalg.inv(total) @ asked.z) - 0.5 * float(determinant) - 0.5 * float(u @ u)


@pytest.mark.parametrize("warp", [None, Warp(8.0, 1.5, 1.0, 0.3, NOISE_PPB)], ids=["plain", "warped"])
def test_gain_gradient_and_information_are_those_of_brute_force(warp: Warp | None) -> None:
    asked, columns = problem(warp)
    u: FloatArray = np.random.default_rng(2).normal(size=columns.shape[1]) / 2.0
    state = asked._at(u, columns)
    assert state.gain == pytest.approx(log_posterior(asked, u, columns) - log_posterior(asked, 0.0 * u, columns))
    total = np.exp(limited(columns @ u))
    whole = asked.covariance * np.outer(total, total) + asked.others
    slopes = []
    for axis in np.eye(len(u)):
        step = 1e-5 * axis
        change = log_posterior(asked, u + step, columns) - log_posterior(asked, u - step, columns)
        assert state.gradient @ axis == pytest.approx(-change / 2e-5, abs=1e-4)
        more, less = (np.exp(limited(columns @ (u + sign * step))) for sign in (1.0, -1.0))
        slopes.append(asked.covariance * (np.outer(more, more) - np.outer(less, less)) / 2e-5)
    inverse = np.linalg.inv(whole)
    expected = [[0.5 * np.trace(inverse @ one @ inverse @ other) for other in slopes] for one in slopes]
    np.testing.assert_allclose(state.information, np.array(expected) + np.eye(len(u)), atol=1e-4)


def test_the_mode_is_a_maximum_and_the_evidence_is_close_to_that_of_quadrature() -> None:
    asked, columns = problem(count=60)
    for chosen in ([0], [0, modes().index((1, 0))]):
        some = columns[:, chosen]
        start = asked.start(some)
        assert isinstance(start, _State)
        mode = asked.mode(some, start)
        assert -0.5 * float(mode.gradient @ mode.step) < 1e-3  # what another step would gain
        assert mode.gain >= start.gain == 0.0
        axis, step = np.linspace(-6.0, 6.0, 61), 0.2
        grids = np.meshgrid(*[axis] * len(chosen))
        points = np.column_stack([grid.ravel() for grid in grids])
        gains = np.array([log_posterior(asked, u, some) for u in points]) - log_posterior(asked, 0.0 * points[0], some)
        largest = gains.max()
        of_prior = len(chosen) * math.log(step / math.sqrt(2.0 * math.pi))
        evidence = largest + math.log(np.exp(gains - largest).sum()) + of_prior
        assert mode.evidence == pytest.approx(evidence, abs=0.2)
        assert mode.gain == pytest.approx(largest, abs=0.1)


def test_the_prior_of_the_amplitude_has_its_stated_standard_deviation_over_a_square() -> None:
    axis = (np.arange(50) + 0.5) / 50 * WIDTH_M
    places = np.column_stack([values.ravel() for values in np.meshgrid(axis, axis)])
    columns = waves(places, WIDTH_M) * _prior_stds()
    assert (columns[:, 1:] ** 2).sum(axis=1).mean() == pytest.approx(STD**2, rel=1e-6)
    np.testing.assert_allclose(columns[:, 0], STD)


def test_too_few_samples_a_named_kernel_and_a_map_from_orbit_have_none() -> None:
    places, values, field = drawn(0, 120, True)
    few = places[: LEAST_SAMPLES - 1], values[: LEAST_SAMPLES - 1]
    assert weight_of_local(inferred(*few)) == 0.0
    assert local_member(Hyperparameters(Matern32(), NOISE_PPB, 8.0, 1.5), *few, WIDTH_M) is None
    assert weight_of_local(inferred(places, values, "matern32")) == 0.0
    trend = orbital_trend(GRID, field.reshape(GRID.shape), 1.0)
    with_map = infer_hyperparameters(places, values, AUTO, Hyperprior(WIDTH_M), noise_std_ppb=NOISE_PPB, trend=trend)
    assert weight_of_local(with_map) == 0.0


def test_the_members_are_few_their_weights_sum_to_one_and_the_same_samples_give_the_same() -> None:
    places, values, _ = drawn(2, 120, True)
    found = inferred(places, values)
    assert weight_of_local(found) > 0.4
    assert found == replace(inferred(places, values), log_likelihood=found.log_likelihood)
    assert len(found.alternatives) <= 6
    assert sum(weight for weight, _ in found.alternatives) == pytest.approx(1.0)
    assert not isinstance(found.kernel, LocallyScaled)
    assert len(found.warps) in {0, len(found.alternatives)}
    assert len(found.noises_ppb) in {0, len(found.alternatives)}


def test_noises_and_warps_stay_with_their_members() -> None:
    places, values, _ = drawn(3, 120, True)
    warp = Warp(8.0, 1.5, 1.0, 0.3, NOISE_PPB)
    own = Hyperparameters(
        Matern32(1.0, 90.0), NOISE_PPB, 8.0, 1.5, trend=UnknownConstant(4.0),
        alternatives=((0.5, Matern32(1.0, 90.0)), (0.5, Matern12(1.0, 200.0))), noises_ppb=(0.1, 0.3),
        warps=(None, warp),
    )  # fmt: skip
    found = with_local_members(own, places, values, WIDTH_M, GRID.points()[::25], 8)
    each = list(zip(found.alternatives, found.noises_ppb, found.warps, strict=True))
    assert weight_of_local(found) > 0.4
    for (_, kernel), noise, member_warp in each:
        rough = isinstance(kernel.even if isinstance(kernel, LocallyScaled) else kernel, Matern12)
        assert (noise, member_warp) == ((0.3, warp) if rough else (0.1, None))


def test_draws_are_uneven_as_often_as_the_mixture() -> None:
    places, values, _ = drawn(0, 60, True)
    asked = hyperparameter_draws(places, values, AUTO, Hyperprior(WIDTH_M), noise_std_ppb=NOISE_PPB)
    drawn_ones = [asked.draw(np.random.default_rng(seed)) for seed in range(60)]
    share = np.mean([isinstance(one.kernel, LocallyScaled) for one in drawn_ones])
    assert share == pytest.approx(weight_of_local(inferred(places, values)), abs=0.2)
    again = asked.draw(np.random.default_rng(7))
    assert again == replace(drawn_ones[7], log_likelihood=again.log_likelihood)


def test_samples_that_are_all_the_same_show_no_parts() -> None:
    places, _, _ = drawn(0, 40, True)
    found = inferred(places, np.full(40, 8.0))
    assert weight_of_local(found) == 0.0

"""A skewed field is recognised from its samples, and a normal one is not hurt."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import he3.hyperposterior
from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperposterior import hyperparameter_draws, infer_hyperparameters
from he3.hyperprior import Hyperprior
from he3.kernels import AUTO, Matern32
from he3.mixture import ProcessMixture
from he3.trend import orbital_trend
from he3.warp_choice import LEAST_SAMPLES, MOST_LOG_VARIANCE, SHAPES, WARP_ODDS, log_warp_weight, warps_to_try
from he3.warping import Warp

GRID = SiteGrid(25, 25, 20.0)
NOISE_PPB = 0.1
SKEWED = Warp(8.0, 1.5, 1.8, 0.6, NOISE_PPB)  # none of those that are tried


@pytest.fixture(autouse=True)
def even_fields(monkeypatch: pytest.MonkeyPatch) -> None:
    """No member has a local amplitude: a few samples of a skewed field look as if its high parts were rough."""
    monkeypatch.setattr(he3.hyperposterior, "with_local_members", lambda mixture, *_: mixture)


@cache
def drawn(seed: int, count: int, warp: Warp | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places (n, 2) [m] and values (n,) [ppb] of samples, and the field on all cells, seen through the warp."""
    random = np.random.default_rng(seed)
    cells = GRID.points()
    factor = np.linalg.cholesky(Matern32(1.5**2, 90.0).covariance(cells, cells) + 1e-8 * np.eye(len(cells)))
    field = 8.0 + factor @ random.standard_normal(len(cells))
    if warp is not None:
        field = warp.field(field)
    chosen = random.choice(len(cells), count, replace=False)
    return cells[chosen], field[chosen] + NOISE_PPB * random.standard_normal(count), field


def inferred(places: FloatArray, values: FloatArray, kernel: str = AUTO) -> Hyperparameters:
    return infer_hyperparameters(places, values, kernel, Hyperprior(500.0), noise_std_ppb=NOISE_PPB)


def weight_of_warps(found: Hyperparameters, *shifts: float) -> float:
    """Of those with one of the shifts, or of all."""
    return sum(
        weight
        for (weight, _), warp in zip(found.alternatives, found.warps or (None,) * 9, strict=False)
        if warp is not None and (not shifts or warp.shift in shifts)
    )


def moments(found: Hyperparameters, places: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    return ProcessMixture.of(GaussianProcess(found).condition(places, values)).predict(GRID.points())


def nlpd(mean: FloatArray, std: FloatArray, field: FloatArray) -> float:
    return float(np.mean(0.5 * np.log(2.0 * np.pi * std**2) + 0.5 * ((field - mean) / std) ** 2))


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["upwards", "downwards"])
def test_a_skewed_field_is_recognised_and_its_map_is_better_than_without_a_warp(
    sign: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights, gains = [], []
    for seed in range(4):
        places, values, field = drawn(seed, 150, replace(SKEWED, shift=sign * SKEWED.shift))
        found = inferred(places, values)
        weights.append(weight_of_warps(found, *((1.0, 2.0) if sign > 0 else (-1.0,))))
        with monkeypatch.context() as patch:
            patch.setattr(he3.hyperposterior, "warps_to_try", lambda *_: [])
            plain = inferred(places, values)
        assert plain.warps == ()
        gains.append(nlpd(*moments(plain, places, values), field) - nlpd(*moments(found, places, values), field))
    assert np.mean(weights) > 0.7
    assert min(weights) > 0.4  # five times what it is before any sample
    assert np.mean(gains) > 0.05
    assert min(gains) > 0.0


@pytest.mark.parametrize("count", [20, 60, 150])
def test_a_normal_field_keeps_its_map(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    weights, losses = [], []
    for seed in range(4):
        places, values, field = drawn(100 + seed, count, None)
        found = inferred(places, values)
        with monkeypatch.context() as patch:
            patch.setattr(he3.hyperposterior, "warps_to_try", lambda *_: [])
            plain = inferred(places, values)
        weights.append(weight_of_warps(found))
        mean, std = moments(found, places, values)
        plain_mean, plain_std = moments(plain, places, values)
        assert np.sqrt((((mean - plain_mean) / plain_std) ** 2).mean()) < 0.2
        assert float(std.mean()) == pytest.approx(float(plain_std.mean()), rel=0.1)
        losses.append(nlpd(mean, std, field) - nlpd(plain_mean, plain_std, field))
    assert np.mean(weights) < 0.35
    assert np.mean(losses) < 0.01


def test_few_samples_named_kernels_and_maps_from_orbit_have_no_warp() -> None:
    places, values, field = drawn(0, 150, SKEWED)
    few = LEAST_SAMPLES - 1
    assert inferred(places[:few], values[:few]).warps == ()
    assert inferred(places, values, "matern32").warps == ()
    trend = orbital_trend(GRID, field.reshape(GRID.shape))
    with_map = infer_hyperparameters(places, values, AUTO, Hyperprior(500.0), noise_std_ppb=NOISE_PPB, trend=trend)
    assert with_map.warps == ()


def test_a_field_that_hardly_varies_or_drowns_in_noise_has_no_warp() -> None:
    values = np.random.default_rng(1).normal(8.0, 1.0, 60)
    assert len(warps_to_try(values, 0.1)) == len(SHAPES)
    assert warps_to_try(values, 0.6) == []
    assert warps_to_try(np.full(60, 8.0), 0.0) == []
    assert warps_to_try(8.0 + 1e-10 * values, 0.0) == []


def test_before_any_evidence_most_of_the_weight_is_without_a_warp() -> None:
    assert log_warp_weight([-30.0, -40.0], [-30.0, -35.0]) == pytest.approx(np.log(WARP_ODDS))
    assert 1.0 / (1.0 + len(SHAPES) * WARP_ODDS) > 0.75
    assert log_warp_weight([-10.0], [-30.0]) > 0.0


def test_a_skewed_field_in_another_unit_has_the_same_warps() -> None:
    places, values, _ = drawn(0, 150, SKEWED)
    weights = []
    for unit in (1.0, 1000.0):
        found = infer_hyperparameters(places, unit * values, AUTO, Hyperprior(500.0), noise_std_ppb=unit * NOISE_PPB)
        weights.append(weight_of_warps(found))
    assert weights[0] > 0.6
    assert weights[1] > 0.6


def test_no_kernel_leaves_so_much_unknown_that_the_tail_decides_the_moments() -> None:
    places, values, _ = drawn(0, 20, SKEWED)
    found = inferred(places, values)
    for process in ProcessMixture.of(GaussianProcess(found).condition(places, values)).processes:
        warp = process.hyperparameters.warp
        if warp is not None:
            variance = process.predict_latent(GRID.points())[1] ** 2
            assert float(warp.log_variance(variance).max()) < 1.5 * MOST_LOG_VARIANCE
    mean, std = moments(found, places, values)
    assert np.isfinite(mean).all()
    assert float(std.max()) < 5.0 * float(values.std())


def test_draws_of_the_hyperparameters_have_the_warps_of_the_mixture() -> None:
    places, values, _ = drawn(0, 150, SKEWED)
    draws = hyperparameter_draws(places, values, AUTO, Hyperprior(500.0), noise_std_ppb=NOISE_PPB)
    random = np.random.default_rng(2)
    seen = [draws.draw(random).warp is not None for _ in range(300)]
    assert np.mean(seen) == pytest.approx(weight_of_warps(inferred(places, values)), abs=0.1)
    assert {draws.draw(random).warps for _ in range(5)} == {()}

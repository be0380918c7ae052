"""A field of quiet and rough parts is an even one times an amplitude, in every sum that a map is made of."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Kernel as SklearnKernel
from sklearn.gaussian_process.kernels import Matern

from he3.certificate import Targets, blocks_of, places_of
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import KERNELS, Kernel, Matern32, Stretched
from he3.local_amplitude import (
    HIGHEST,
    MOST_LOG,
    LocalAmplitude,
    LocallyScaled,
    covariances_within,
    even_kernel,
    least_prior_variance,
    modes,
    prior_variance_at,
    site_kernel_from,
)
from he3.mixture import ProcessMixture, heaviest_of
from he3.mixture_posterior import MixturePosterior
from he3.posterior.grid import GridPosterior
from he3.resource import area_mean
from he3.trend import UnknownConstant
from he3.warping import Warp

WIDTH_M = 300.0
GRID = SiteGrid(20, 30, 10.0)
COEFFICIENTS = tuple(0.7 * (-1.0) ** (j + k) / (1 + j + 2 * k) for j, k in modes())
AMPLITUDE = LocalAmplitude(WIDTH_M, COEFFICIENTS)
EVEN = [*(kind() for kind in KERNELS.values()), Stretched(KERNELS["matern32"](), 2.0, 40.0)]
random = np.random.default_rng(4)
PLACES = random.uniform(0.0, 1.0, (24, 2)) * (WIDTH_M, 200.0)
VALUES = 8.0 + random.normal(0.0, 1.5, 24)


def amplitude_by_hand(x_m: float, y_m: float) -> float:
    g = 0.0
    for (j, k), c in zip(modes(), COEFFICIENTS, strict=True):
        g += c * math.cos(math.pi * j * x_m / WIDTH_M) * math.cos(math.pi * k * y_m / WIDTH_M)
    return math.exp(math.tanh(g))  # ``MOST_LOG`` is 1


def under(kernel: Kernel, warp: Warp | None = None) -> GaussianProcess:
    own = Hyperparameters(kernel, 0.2, 8.0, 1.5, trend=UnknownConstant(2.0), warp=warp)
    return GaussianProcess(own).condition(PLACES, VALUES)


def uneven(kernel: Kernel) -> LocallyScaled:
    return LocallyScaled(kernel, AMPLITUDE)


@pytest.mark.parametrize("even", EVEN, ids=lambda one: type(one).__name__)
def test_the_covariance_is_that_of_an_even_field_times_the_amplitude_at_both_places(even: Kernel) -> None:
    a, b = PLACES[:4], PLACES[4:9]
    expected = [
        [
            amplitude_by_hand(*one) * amplitude_by_hand(*other) * even.covariance(one[None], other[None])[0, 0]
            for other in b
        ]
        for one in a
    ]
    np.testing.assert_allclose(uneven(even).covariance(a, b), expected, rtol=1e-12)
    variances = [uneven(even).covariance(one[None], one[None])[0, 0] for one in PLACES]
    np.testing.assert_allclose(prior_variance_at(uneven(even), PLACES), variances, rtol=1e-12)
    sets = PLACES.reshape(6, 4, 2)
    within = [uneven(even).covariance(one, one) for one in sets]
    np.testing.assert_allclose(covariances_within(uneven(even), sets), within, rtol=1e-12)
    np.testing.assert_allclose(covariances_within(even, sets), [even.covariance(one, one) for one in sets], rtol=1e-12)


@given(
    st.lists(st.floats(-30.0, 30.0), min_size=len(modes()), max_size=len(modes())),
    st.integers(0, 2**32 - 1),
    st.sampled_from(EVEN),
)
def test_it_is_a_covariance_with_any_amplitude_and_no_part_varies_beyond_the_bounds(
    coefficients: list[float], seed: int, even: Kernel
) -> None:
    kernel = LocallyScaled(even, LocalAmplitude(WIDTH_M, tuple(coefficients)))
    places = np.random.default_rng(seed).uniform(0.0, WIDTH_M, (12, 2))
    covariance = kernel.covariance(places, places)
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-12)
    greatest = even.prior_variance * math.exp(2.0 * MOST_LOG)
    assert np.linalg.eigvalsh(covariance).min() > -1e-12 * len(places) * greatest
    assert covariance.diagonal().max() <= greatest * (1.0 + 1e-12)
    assert covariance.diagonal().min() >= least_prior_variance(kernel) * (1.0 - 1e-12)


def test_the_waves_go_up_to_the_highest_in_any_direction_and_begin_with_the_constant() -> None:
    assert modes()[0] == (0, 0)
    assert {(0, HIGHEST), (HIGHEST, 0), (2, 2)} <= set(modes())
    assert max(j * j + k * k for j, k in modes()) <= HIGHEST**2
    assert len(set(modes())) == len(modes()) == len(COEFFICIENTS)


def test_the_gradient_of_its_logarithm_is_that_of_differences() -> None:
    step = 1e-4
    for axis in range(2):
        aside = step * np.eye(2)[axis]
        change = AMPLITUDE.log_at(PLACES + aside) - AMPLITUDE.log_at(PLACES - aside)
        np.testing.assert_allclose(AMPLITUDE.gradient_of_log(PLACES)[:, axis], change / (2 * step), atol=1e-8)


class _Uneven(SklearnKernel):  # type: ignore[misc]
    """The same kernel for scikit-learn."""

    def __init__(self) -> None:
        pass

    def is_stationary(self) -> bool:
        return False

    def __call__(self, X: FloatArray, Y: FloatArray | None = None, eval_gradient: bool = False) -> FloatArray:
        assert not eval_gradient
        Y = X if Y is None else Y
        at_x, at_y = (np.array([amplitude_by_hand(*place) for place in places]) for places in (X, Y))
        found: FloatArray = 0.8 * at_x[:, None] * at_y * Matern(70.0, nu=1.5)(X, Y)
        return found

    def diag(self, X: FloatArray) -> FloatArray:
        return np.array([0.8 * amplitude_by_hand(*place) ** 2 for place in X])


def test_the_prediction_is_that_of_scikit_learn_with_the_same_kernel() -> None:
    own = Hyperparameters(uneven(Matern32(0.8, 70.0)), 0.2, 8.0, 1.5)
    other = GaussianProcessRegressor(_Uneven(), alpha=(0.2 / 1.5) ** 2, optimizer=None)
    other.fit(PLACES, (VALUES - 8.0) / 1.5)
    points = GRID.points()[::7]
    mean, std = GaussianProcess(own).condition(PLACES, VALUES).predict(points)
    expected_mean, expected_std = other.predict(points, return_std=True)
    np.testing.assert_allclose(mean, 8.0 + 1.5 * expected_mean, rtol=1e-7)
    np.testing.assert_allclose(std, 1.5 * expected_std, rtol=1e-6)


@pytest.mark.parametrize("even", EVEN, ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("followed", [True, False])
def test_the_map_has_the_mean_and_deviation_of_the_process_in_every_cell(even: Kernel, followed: bool) -> None:
    process = under(uneven(even))
    own = process.hyperparameters
    known = GridPosterior.build(GRID, own, PLACES[:20], VALUES[:20], followed=followed)
    for place, value in zip(PLACES[20:], VALUES[20:], strict=True):
        known.add(place, float(value))
    mean, std = process.predict(GRID.points())
    np.testing.assert_allclose(known.mean_ppb.ravel(), mean, atol=2e-4)
    np.testing.assert_allclose(known.std_ppb.ravel(), std, rtol=2e-3)
    prior = GridPosterior(GRID, own).std_ppb.ravel()
    np.testing.assert_allclose(prior, np.sqrt(1.5**2 * prior_variance_at(own.kernel, GRID.points()) + 4.0), rtol=1e-5)


def test_the_mean_of_an_area_and_of_blocks_varies_as_the_joint_covariance_says() -> None:
    process = under(uneven(Matern32(0.8, 70.0)))
    area = np.zeros(GRID.shape, dtype=np.bool_)
    area[3:12, 5:20] = True
    area[5, 7:9] = False
    covariance = process.posterior_covariance(GRID.points()[area.ravel()])
    found = area_mean(process, GRID, process.predict(GRID.points())[0].reshape(GRID.shape), area)
    assert found.std_ppb == pytest.approx(math.sqrt(covariance.mean()), rel=1e-6)
    for targets in (blocks_of(GRID, 50.0), places_of(GRID, area)):
        mean, std = targets.moments(process)
        for target in (0, len(targets) // 2):
            points = targets.points_m[target]
            assert mean[target] == pytest.approx(process.predict(points)[0].mean(), rel=1e-9)
            assert std[target] == pytest.approx(math.sqrt(process.posterior_covariance(points).mean()), rel=1e-6)


@pytest.mark.parametrize("warp", [None, Warp(8.0, 1.5, 1.0, 0.3, 0.2)], ids=["plain", "warped"])
def test_a_mixture_with_it_has_the_moments_of_its_parts_on_map_area_and_target(warp: Warp | None) -> None:
    kernels = (0.4, Matern32(0.8, 70.0)), (0.6, uneven(Matern32(0.8, 70.0)))
    own = Hyperparameters(
        kernels[0][1], 0.2, 8.0, 1.5, trend=UnknownConstant(2.0), alternatives=kernels,
        warps=() if warp is None else (None, warp),
    )  # fmt: skip
    parts = [under(kernels[0][1]), under(kernels[1][1], warp)]
    means, stds = (np.array(each) for each in zip(*(part.predict(GRID.points()) for part in parts), strict=True))
    mean = 0.4 * means[0] + 0.6 * means[1]
    variance = 0.4 * (stds[0] ** 2 + (means[0] - mean) ** 2) + 0.6 * (stds[1] ** 2 + (means[1] - mean) ** 2)
    made = MixturePosterior(GRID, own, lambda grid, one: GridPosterior.build(grid, one, PLACES, VALUES))
    np.testing.assert_allclose(made.snapshot().mean_ppb.ravel(), mean, atol=1e-3)
    np.testing.assert_allclose(made.snapshot().std_ppb.ravel(), np.sqrt(variance), rtol=2e-3)
    assert made.intervals() is not None
    at = Targets(GRID.points()[100:102][:, None])
    for part, part_means, part_stds in zip(parts, means, stds, strict=True):
        found, spread = at.moments(part)
        np.testing.assert_allclose(found, part_means[100:102], rtol=1e-9)
        np.testing.assert_allclose(spread, part_stds[100:102], rtol=1e-9)
    assert [part.hyperparameters.kernel for part in ProcessMixture.of(made.process).processes] == [
        kernel for _, kernel in kernels
    ]


def test_the_least_variance_is_below_that_of_many_samples_in_the_quietest_place() -> None:
    quiet = LocalAmplitude(WIDTH_M, (-9.0, *(0.0,) * (len(modes()) - 1)))
    process = GaussianProcess(Hyperparameters(LocallyScaled(Matern32(), quiet), 0.2, 8.0, 1.5))
    process = process.condition(np.repeat(PLACES[:1], 50, axis=0), np.full(50, 8.0))
    variance = process.hyperparameters.covariance(PLACES[:1], PLACES[:1])[0, 0] - float(
        (np.linalg.solve(process.factor, process.hyperparameters.covariance(process.places_m, PLACES[:1])) ** 2).sum()
    )
    assert 0.0 < process.least_variance() < variance


def test_planners_are_told_of_the_kernel_without_it() -> None:
    kernels = (0.3, Matern32(0.8, 70.0)), (0.7, uneven(Matern32(0.5, 40.0)))
    own = Hyperparameters(kernels[0][1], 0.2, 8.0, 1.5, alternatives=kernels)
    assert heaviest_of(own).kernel == even_kernel(kernels[1][1]) == Matern32(0.5, 40.0)


@pytest.mark.parametrize("even", EVEN, ids=lambda one: type(one).__name__)
def test_it_is_the_same_from_its_name_and_parameters(even: Kernel) -> None:
    kernel = uneven(even)
    assert site_kernel_from(kernel.name, kernel.parameters()) == kernel
    assert site_kernel_from(even.name, even.parameters()) == even
    without = {key: value for key, value in kernel.parameters().items() if key != "amplitude_1_0"}
    with pytest.raises(InvalidInput, match="coefficients of an amplitude"):
        site_kernel_from(kernel.name, without)


def test_what_needs_a_function_of_distance_refuses_it() -> None:
    kernel = uneven(Matern32())
    flat, short = np.zeros((1, 1)), np.zeros((1, 1), dtype=np.float32)
    for ask in (
        lambda: kernel.of_squared_distance(flat),
        lambda: kernel.with_log_gradients(flat),
        lambda: kernel.fill(short, short),
    ):
        with pytest.raises(TypeError, match="no function of a distance"):
            ask()


@pytest.mark.parametrize(
    ("extent_m", "coefficients"),
    [
        (0.0, COEFFICIENTS),
        (math.nan, COEFFICIENTS),
        (WIDTH_M, COEFFICIENTS[:-1]),
        (WIDTH_M, (math.inf, *COEFFICIENTS[1:])),
    ],
)
def test_an_amplitude_of_bad_numbers_is_refused(extent_m: float, coefficients: tuple[float, ...]) -> None:
    with pytest.raises(InvalidInput, match="expected"):
        LocalAmplitude(extent_m, coefficients)

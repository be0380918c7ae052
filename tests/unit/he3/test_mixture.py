"""The moments of a mixture are those of its distribution, at places, over areas, and on the cells of a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from he3.coarse_grid import MOST_CELLS, coarser
from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperdraws import redrawn
from he3.kernels import Matern32, SmoothPlusRough
from he3.mixture import ProcessMixture, mixture_moments
from he3.mixture_posterior import MixturePosterior
from he3.posterior.grid import GridPosterior
from he3.resource import area_mean, drawn_fields
from he3.trend import UnknownConstant

GRID = SiteGrid(20, 30, 10.0)
ALTERNATIVES = ((0.5, Matern32(1.0, 60.0)), (0.3, Matern32(0.2, 150.0)), (0.2, Matern32(4.0, 30.0)))
SPREAD = Hyperparameters(Matern32(0.8, 70.0), 0.1, 7.5, 1.5, trend=UnknownConstant(4.0), alternatives=ALTERNATIVES)


def samples(count: int, grid: SiteGrid = GRID) -> tuple[FloatArray, FloatArray]:
    random = np.random.default_rng(4)
    places = random.uniform((0.0, 0.0), (grid.width_m, grid.height_m), (count, 2))
    return places, 8.0 + np.sin(places[:, 0] / 40.0) + random.normal(0.0, 0.1, count)


def known(count: int) -> GaussianProcess:
    return GaussianProcess(SPREAD).condition(*samples(count))


def mixed_map(grid: SiteGrid, spread: Hyperparameters, places: FloatArray, values: FloatArray) -> MixturePosterior:
    return MixturePosterior(grid, spread, lambda on, of: GridPosterior.build(on, of, places, values))


def test_the_moments_are_those_of_the_density_by_quadrature() -> None:
    weights, means, stds = np.array([0.5, 0.3, 0.2]), np.array([1.0, -2.0, 4.0]), np.array([0.3, 1.0, 2.0])
    x = np.linspace(-25.0, 25.0, 200_001)
    density = sum(w / s * np.exp(-0.5 * ((x - m) / s) ** 2) for w, m, s in zip(weights, means, stds, strict=True))
    density /= density.sum()
    mean, std = mixture_moments(weights, means, stds)
    assert mean == pytest.approx(float(density @ x), abs=1e-9)
    assert std == pytest.approx(float(np.sqrt(density @ (x - mean) ** 2)), abs=1e-9)


def test_each_process_of_the_mixture_has_the_same_samples() -> None:
    places, values = samples(12)
    for process, (_, kernel) in zip(ProcessMixture.of(known(12)).processes, ALTERNATIVES, strict=True):
        own = GaussianProcess(replace(SPREAD, kernel=kernel, alternatives=())).condition(places, values)
        assert np.allclose(process.predict(GRID.points()), own.predict(GRID.points()), atol=1e-9)


def test_an_area_is_as_uncertain_as_the_joint_distribution_of_its_cells() -> None:
    area = np.zeros(GRID.shape, dtype=np.bool_)
    area[3:12, 8:25] = True
    mixture = ProcessMixture.of(known(12))
    joint = mixture.posterior_covariance(GRID.points()[area.ravel()])
    mean = mixture.predict(GRID.points())[0].reshape(GRID.shape)
    found = area_mean(known(12), GRID, mean, area)
    assert found.std_ppb == pytest.approx(float(np.sqrt(joint.mean())), rel=1e-6)
    alone = area_mean(GaussianProcess(replace(SPREAD, alternatives=())).condition(*samples(12)), GRID, mean, area)
    assert abs(alone.std_ppb - found.std_ppb) > 0.05 * found.std_ppb


def test_fields_drawn_from_the_mixture_have_its_spread() -> None:
    area = np.zeros(GRID.shape, dtype=np.bool_)
    area[::5, ::5] = True
    fields, _ = drawn_fields(known(12), GRID, area, np.random.default_rng(2), 4000)
    mean, std = ProcessMixture.of(known(12)).predict(GRID.points()[area.ravel()])
    assert np.allclose(fields.mean(axis=0), mean, atol=0.15 * std.max())
    assert np.allclose(fields.std(axis=0), std, rtol=0.1)


def test_a_small_map_has_the_moments_of_the_mixture_and_keeps_them_with_one_sample_more() -> None:
    places, values = samples(13)
    posterior = mixed_map(GRID, SPREAD, places[:12], values[:12])
    before = GaussianProcess(SPREAD).condition(places[:12], values[:12])
    for process in (before, before.condition(places[12:], values[12:])):
        mean, std = ProcessMixture.of(process).predict(GRID.points())
        assert np.allclose(posterior.snapshot().mean_ppb.ravel(), mean, atol=1e-4)
        assert np.allclose(posterior.snapshot().std_ppb.ravel(), std, rtol=1e-3)
        posterior.add(places[12], values[12])


def test_a_large_map_has_the_moments_of_the_mixture_nearly() -> None:
    grid = SiteGrid(125, 150, 4.0)
    kernels = [SmoothPlusRough(0.5, 120.0, 0.5, 25.0), SmoothPlusRough(1.5, 200.0, 0.3, 40.0)]
    mixed = replace(SPREAD, kernel=kernels[0], alternatives=((0.6, kernels[0]), (0.4, kernels[1])))
    places, values = samples(40, grid)
    posterior = mixed_map(grid, mixed, places, values)
    mean, std = ProcessMixture.of(posterior.process).predict(grid.points())
    assert np.sqrt((((posterior.snapshot().mean_ppb.ravel() - mean) / std) ** 2).mean()) < 0.02
    assert np.sqrt(((posterior.snapshot().std_ppb.ravel() / std - 1.0) ** 2).mean()) < 0.02
    alone = GridPosterior.build(grid, replace(mixed, alternatives=()), places, values)
    assert np.sqrt(((alone.std_ppb.ravel() / std - 1.0) ** 2).mean()) > 0.1


@pytest.mark.parametrize("shape", [(1, 9000), (500, 500), (77, 61), (95, 47)])
def test_the_coarser_grid_covers_the_site(shape: tuple[int, int]) -> None:
    grid = SiteGrid(*shape, 2.0)
    coarse = coarser(grid)
    assert coarse.rows * coarse.columns <= MOST_CELLS
    assert 0.0 <= coarse.width_m - grid.width_m < coarse.resolution_m
    assert 0.0 <= coarse.height_m - grid.height_m < coarse.resolution_m


def test_the_map_of_a_kernel_that_is_certain_is_its_own_to_the_byte() -> None:
    certain = replace(SPREAD, alternatives=())
    places, values = samples(12)
    mixed = mixed_map(GRID, certain, places, values).snapshot()
    own = GridPosterior.build(GRID, certain, places, values).snapshot()
    assert mixed.mean_ppb.tobytes() == own.mean_ppb.tobytes()
    assert mixed.std_ppb.tobytes() == own.std_ppb.tobytes()


def test_a_rehearsal_draws_the_alternatives_with_their_weights() -> None:
    random, belief = np.random.default_rng(1), known(6)
    drawn = [redrawn(belief, random) for _ in range(400)]
    for weight, kernel in ALTERNATIVES:
        share = sum(each.hyperparameters.kernel == kernel for each in drawn) / len(drawn)
        assert share == pytest.approx(weight, abs=0.08)
    assert not drawn[0].hyperparameters.alternatives
    assert np.allclose(drawn[0].predict(samples(6)[0])[0], samples(6)[1], atol=0.3)

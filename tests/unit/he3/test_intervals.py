"""The central intervals of a mixture hold as much of it as they say, however the parts differ."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from he3.frames import FloatArray, SiteGrid
from he3.gp import Hyperparameters
from he3.intervals import NORMAL_ENDS, Intervals, mixture_ends, normal_levels
from he3.kernels import Matern32
from he3.mixture import ProcessMixture, mixture_moments
from he3.mixture_posterior import MixturePosterior
from he3.posterior.grid import GridPosterior
from he3.tails import interval_levels, residuals

WEIGHTS = np.array([0.6, 0.3, 0.1])
NORMAL = np.array(NORMAL_ENDS)


def drawn(places: int, apart: float, factor: float) -> tuple[FloatArray, FloatArray]:
    """Means and standard deviations (3, places) of parts."""
    random = np.random.default_rng(3)
    return 7.0 + apart * random.normal(size=(3, places)), np.exp(np.log(factor) * random.normal(size=(3, places)))


@pytest.mark.parametrize(("apart", "factor"), [(0.0, 1.0), (0.5, 1.5), (0.0, 10.0), (30.0, 3.0)])
def test_the_ends_are_the_quantiles_of_the_distribution(apart: float, factor: float) -> None:
    means, stds = drawn(200, apart, factor)
    mean, std = mixture_moments(WEIGHTS, means, stds)
    ends = mean + std * mixture_ends(WEIGHTS, means, stds, NORMAL)
    below = np.tensordot(WEIGHTS, ndtr((ends[:, None] - means[:, None].swapaxes(0, 1)) / stds), axes=([0], [1]))
    assert np.allclose(below, ndtr(np.array(NORMAL_ENDS))[:, None], atol=1e-3)


def test_the_ends_are_in_order_where_almost_all_of_the_mixture_is_at_one_value() -> None:
    weights, stds = np.array([0.94, 0.06]), np.array([1e-5, 1.0])
    means = np.linspace(-1.0, 1.0, 40)[None, :] * np.array([[0.0], [1.0]])
    found = Intervals.of(SiteGrid(1, 40, 10.0), weights, means, np.tile(stds[:, None], 40), NORMAL)
    assert (np.diff(found.ends, axis=0) >= 0.0).all()
    levels = normal_levels(np.linspace(-3.0, 3.0, 40)[:, None], list(found.ends.reshape(4, 1, -1)))
    assert np.isfinite(levels).all()
    assert (np.diff(levels, axis=0) >= 0.0).all()


def test_a_value_at_an_end_has_its_probability_and_one_between_equal_ends_has_a_number() -> None:
    ends = [np.array([end]) for end in (-1.5, -0.2, 0.4, 3.0)]
    for end, normal in zip(ends, NORMAL_ENDS, strict=True):
        assert normal_levels(end, ends) == pytest.approx(normal)
    equal = [np.zeros(1) for _ in range(4)]
    for value, least, most in ((-1.0, -np.inf, -2.0), (0.0, -2.0, 2.0), (1.0, 2.0, np.inf)):
        level = normal_levels(np.array([value]), equal)
        assert np.isfinite(level).all()
        assert least < level < most


def test_one_part_or_equal_ones_have_the_ends_of_a_normal_distribution() -> None:
    means, stds = drawn(5, 1.0, 2.0)
    assert np.array_equal(
        mixture_ends(np.ones(1), means[:1], stds[:1], NORMAL), np.tile(np.array(NORMAL_ENDS)[:, None], 5)
    )
    same = mixture_ends(WEIGHTS, np.tile(means[:1], (3, 1)), np.tile(stds[:1], (3, 1)), NORMAL)
    assert np.allclose(same, np.array(NORMAL_ENDS)[:, None], atol=1e-6)


def test_of_parts_that_differ_in_width_the_middle_is_narrower_than_one_standard_deviation() -> None:
    ends = mixture_ends(np.array([0.8, 0.2]), np.zeros((2, 1)), np.array([[0.5], [3.0]]), NORMAL)[:, 0]
    assert ends == pytest.approx(-ends[::-1], abs=1e-3)
    assert ends[2] < 0.6
    assert ends[3] > 2.0


def test_the_map_of_a_mixture_has_the_quantiles_of_its_processes_at_each_cell() -> None:
    grid = SiteGrid(9, 12, 20.0)
    alternatives = ((0.7, Matern32(0.3, 90.0)), (0.3, Matern32(5.0, 30.0)))
    spread = Hyperparameters(Matern32(0.5, 70.0), 0.1, 7.5, 1.5, alternatives=alternatives)
    places = np.array([[30.0, 40.0], [200.0, 110.0], [120.0, 90.0]])
    values = np.array([6.0, 9.5, 8.0])
    posterior = MixturePosterior(grid, spread, lambda on, of: GridPosterior.build(on, of, places, values))
    found = posterior.intervals()
    assert found is not None
    mixture = ProcessMixture.of(posterior.process)
    means, stds = (
        np.array(each) for each in zip(*(one.predict(grid.points()) for one in mixture.processes), strict=True)
    )
    mean, std = mixture.predict(grid.points())
    two, one = interval_levels(residuals(mixture.weights, mixture.processes, 3), (2.0, 1.0))
    for end, normal in zip(found.on(grid), (-two, -one, one, two), strict=True):
        below = mixture.weights @ ndtr((mean + std * end.ravel() - means) / stds)
        assert np.allclose(below, ndtr(normal), atol=2e-3)


def test_a_certain_kernel_has_no_intervals_but_those_of_its_standard_deviation() -> None:
    certain = Hyperparameters(Matern32(0.5, 70.0), 0.1, 7.5, 1.5)
    posterior = MixturePosterior(SiteGrid(4, 4, 20.0), certain, lambda on, of: GridPosterior(on, of))
    assert posterior.intervals() is None


def test_a_place_has_the_ends_of_the_cell_whose_centre_it_is() -> None:
    random = np.random.default_rng(1)
    coarse, grid = SiteGrid(4, 5, 30.0), SiteGrid(11, 14, 10.0)
    intervals = Intervals(coarse, random.normal(size=(4, 4, 5)).astype(np.float32))
    on_cells = intervals.on(grid)
    for row, column in ((0, 0), (10, 13), (4, 7), (1, 12)):
        at = intervals.at((column + 0.5) * 10.0, (row + 0.5) * 10.0)
        assert at == pytest.approx(tuple(on_cells[:, row, column]), abs=1e-6)

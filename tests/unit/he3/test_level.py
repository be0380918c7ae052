"""The level of a wide site is another far from the samples than at them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from he3.errors import InvalidInput
from he3.gp import GaussianProcess
from he3.hyperposterior import infer_hyperparameters
from he3.hyperprior import MEAN_PPB, MEAN_STD_PPB, Hyperprior
from he3.level import LEVEL_LENGTH_M, NARROW_M, level_columns
from he3.mixture import ProcessMixture
from he3.trend import UnknownConstant, UnknownLevel, unknown_level

WIDE_M = 30_000.0
PLACES = np.random.default_rng(3).uniform(0.0, WIDE_M, (200, 2))


def test_the_level_of_a_narrow_site_is_a_constant() -> None:
    assert unknown_level(4.0, 0.99 * NARROW_M) == UnknownConstant(4.0)


@pytest.mark.parametrize(("width_m", "columns_at_most"), [(3000.0, 6), (10_000.0, 12), (30_000.0, 26), (51_000.0, 41)])
def test_the_columns_of_a_wide_site_have_nearly_the_levels_correlation(width_m: float, columns_at_most: int) -> None:
    columns = level_columns(PLACES * (width_m / WIDE_M), width_m)
    apart_m = cdist(PLACES, PLACES) * (width_m / WIDE_M)
    assert columns.shape[1] <= columns_at_most
    # What is left out is narrow: it is of places less than a lattice's step apart.
    far = apart_m > width_m / 9.0
    error = (columns @ columns.T - np.exp(-apart_m / LEVEL_LENGTH_M))[far]
    assert np.sqrt(np.mean(error**2)) < 0.065
    assert np.abs(error).max() < 0.22


@pytest.mark.parametrize("width_m", [NARROW_M, 3000.0, 10_000.0, 51_000.0])
def test_the_level_is_equally_uncertain_everywhere(width_m: float) -> None:
    axis = (np.arange(60) + 0.5) / 60 * width_m
    places = np.column_stack([each.ravel() for each in np.meshgrid(axis, axis)])
    assert (level_columns(places, width_m) ** 2).sum(axis=1) == pytest.approx(1.0)


def test_equal_samples_in_a_corner_leave_distant_ground_as_uncertain_as_soils_are() -> None:
    corner = PLACES[:80] / 5.0
    fitted = infer_hyperparameters(corner, np.full(80, 3.0), "matern52", Hyperprior(WIDE_M), noise_std_ppb=0.1)
    mixture = ProcessMixture.of(GaussianProcess(fitted).condition(corner, np.full(80, 3.0)))
    mean, std = mixture.predict([[3000.0, 3000.0], [28_000.0, 28_000.0]])
    assert mean[0] == pytest.approx(3.0, abs=0.2)
    assert std[0] < 0.2
    assert 3.0 + 0.4 * (MEAN_PPB - 3.0) < mean[1] < MEAN_PPB
    assert std[1] > 0.8 * MEAN_STD_PPB


@pytest.mark.parametrize(("std_ppb", "extent_m"), [(0.0, WIDE_M), (4.0, 0.0), (np.nan, WIDE_M), (4.0, np.inf)])
def test_a_level_needs_a_width_and_a_standard_deviation(std_ppb: float, extent_m: float) -> None:
    with pytest.raises(InvalidInput, match="expected a positive width"):
        UnknownLevel(std_ppb, extent_m)

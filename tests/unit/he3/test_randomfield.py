"""Random fields against the covariance that they promise, over many seeds, with bounds from their sampling error."""

from __future__ import annotations

import numpy as np
import pytest

from he3.errors import InvalidInput, NumericalFailure
from he3.randomfield import correlated, exponential_covariance, layer_correlation, unit_fields


def fields(count: int, shape: tuple[int, int], length_m: float, seed: int, spacing_m: float = 1.0) -> np.ndarray:
    return unit_fields(count, shape, (spacing_m, spacing_m), length_m, np.random.default_rng(seed))


def test_the_full_covariance_matrix_of_a_small_field_is_exponential() -> None:
    """Every pair of cells, not only lags along axes; entries scatter by about sqrt((1 + c^2) / N)."""
    shape, length, count = (6, 5), 2.5, 20_000
    sample = fields(count, shape, length, seed=1).reshape(count, -1)
    y, x = np.divmod(np.arange(30), 5)
    wanted = np.exp(-np.hypot(y[:, None] - y, x[:, None] - x) / length)
    error = sample.T @ sample / count - wanted
    assert np.abs(error / np.sqrt((1 + wanted**2) / count)).max() < 4.5


@pytest.fixture(scope="module")
def at_the_papers_scale() -> list[np.ndarray]:
    """Two fields of each of 12 seeds."""
    return [fields(2, (500, 500), 25.0, seed) for seed in range(12)]


@pytest.mark.parametrize("lag_m", [5, 25, 60])
def test_at_the_papers_scale_the_covariance_is_exponential_along_both_axes(
    lag_m: int, at_the_papers_scale: list[np.ndarray]
) -> None:
    products = []
    for sample in at_the_papers_scale:
        products.append((sample[:, lag_m:] * sample[:, :-lag_m]).mean(axis=(1, 2)))
        products.append((sample[:, :, lag_m:] * sample[:, :, :-lag_m]).mean(axis=(1, 2)))
    means = np.concatenate(products)
    error = means.mean() - np.exp(-lag_m / 25.0)
    assert abs(error) < 4 * means.std() / np.sqrt(means.size / 2)
    assert abs(error) < 0.05


def test_mean_is_zero_and_variance_one_over_seeds() -> None:
    sample = fields(400, (20, 30), 5.0, seed=3)
    at_one_cell = sample[:, 7, 11]
    assert abs(at_one_cell.mean()) < 4 / np.sqrt(400)
    assert abs(at_one_cell.var() - 1) < 4 * np.sqrt(2 / 400)


def test_rows_and_columns_may_have_different_spacing() -> None:
    sample = unit_fields(4000, (4, 4), (2.0, 1.0), 3.0, np.random.default_rng(4))
    north = (sample[:, 0, 0] * sample[:, 1, 0]).mean()
    east = (sample[:, 0, 0] * sample[:, 0, 1]).mean()
    assert north == pytest.approx(np.exp(-2 / 3), abs=0.07)
    assert east == pytest.approx(np.exp(-1 / 3), abs=0.07)


def test_fields_made_together_are_independent() -> None:
    first, second, third = fields(3, (400, 400), 4.0, seed=5)
    for one, other in ((first, second), (second, third), (first, third)):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.05


def test_the_same_seed_gives_the_same_field_and_another_seed_another() -> None:
    assert np.array_equal(fields(2, (40, 30), 8.0, 6), fields(2, (40, 30), 8.0, 6))
    assert not np.array_equal(fields(2, (40, 30), 8.0, 6), fields(2, (40, 30), 8.0, 7))


def test_a_field_smaller_than_its_correlation_length_still_has_the_right_covariance() -> None:
    """The least torus has negative eigenvalues here, so this goes through the grown one."""
    sample = fields(4000, (8, 8), 10.0, seed=8)
    across = (sample[:, 0, 0] * sample[:, 7, 7]).mean()
    assert across == pytest.approx(np.exp(-np.hypot(7, 7) / 10), abs=0.05)


def test_a_length_that_no_bearable_torus_holds_is_refused_with_numbers() -> None:
    with pytest.raises(NumericalFailure, match="shorter length"):
        fields(1, (300, 300), 5000.0, seed=0)


@pytest.mark.parametrize(("count", "shape", "length"), [(0, (5, 5), 1.0), (1, (0, 5), 1.0), (1, (5, 5), 0.0)])
def test_empty_fields_and_lengths_are_refused(count: int, shape: tuple[int, int], length: float) -> None:
    with pytest.raises(InvalidInput):
        fields(count, shape, length, 0)


def test_layers_get_the_correlation_that_is_asked_for() -> None:
    wanted = np.array([[1.0, -0.6, 0.2], [-0.6, 1.0, 0.3], [0.2, 0.3, 1.0]])
    joint = correlated(fields(3, (500, 500), 3.0, seed=9), wanted)
    assert np.corrcoef(joint.reshape(3, -1)) == pytest.approx(wanted, abs=0.04)


def test_correlating_keeps_the_first_layer_and_uncorrelated_ones_as_they_are() -> None:
    independent = fields(2, (20, 20), 3.0, seed=10)
    assert np.array_equal(correlated(independent, np.eye(2)), independent)
    assert np.array_equal(correlated(independent, np.array([[1.0, 0.5], [0.5, 1.0]]))[0], independent[0])


def test_a_correlation_that_cannot_be_is_refused() -> None:
    with pytest.raises(NumericalFailure, match="positive definite"):
        correlated(np.zeros((2, 3, 3)), np.array([[1.0, 1.2], [1.2, 1.0]]))
    with pytest.raises(InvalidInput, match="correlation"):
        correlated(np.zeros((2, 3, 3)), np.eye(3))


def test_the_correlation_of_layers_is_pearsons() -> None:
    random = np.random.default_rng(11)
    layers = random.standard_normal((3, 15, 12)) * [[[2.0]], [[0.1]], [[30.0]]] + [[[5.0]], [[-3.0]], [[100.0]]]
    assert layer_correlation(layers) == pytest.approx(np.corrcoef(layers.reshape(3, -1)))


def test_a_constant_layer_correlates_with_nothing() -> None:
    layers = np.stack([np.full((4, 4), 0.3), np.arange(16.0).reshape(4, 4)])
    assert np.array_equal(layer_correlation(layers), np.eye(2))


def test_covariance_falls_to_a_third_over_one_length() -> None:
    assert exponential_covariance(np.array([0.0, 25.0]), 25.0) == pytest.approx([1.0, 1 / np.e])

"""A few weighted distributions keep the moments of many."""

from __future__ import annotations

import numpy as np
import pytest

from he3.condensation import condensed
from he3.errors import InvalidInput
from he3.frames import FloatArray


def family(count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights (N,), means and variances (N, 20) that vary smoothly with two parameters."""
    a, b = np.random.default_rng(3).normal(size=(2, count, 1))
    at = np.linspace(0.0, 1.0, 20)
    weights = np.exp(-0.5 * (a - 0.3) ** 2 - b * b)[:, 0]
    return weights, np.sin(3.0 * at + a) + 0.2 * b, np.exp(0.5 * a + b * at)


def moments(weights: FloatArray, means: FloatArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
    mean = weights @ means
    return mean, np.sqrt(weights @ (variances + (means - mean) ** 2))


def test_six_distributions_keep_the_moments_of_two_hundred() -> None:
    weights, means, variances = family(200)
    mean, std = moments(weights / weights.sum(), means, variances)
    chosen, shares = condensed(weights, means, variances, 6)
    assert len(chosen) <= 6
    assert shares.sum() == pytest.approx(1.0)
    assert (np.diff(shares) <= 0.0).all()
    kept_mean, kept_std = moments(shares, means[chosen], variances[chosen])
    assert np.abs((kept_mean - mean) / std).max() < 0.05
    assert np.abs(kept_std / std - 1.0).max() < 0.05


def test_the_one_of_all_the_weight_is_kept_alone() -> None:
    _, means, variances = family(9)
    chosen, shares = condensed(np.eye(9)[4], means, variances, 6)
    assert chosen[0] == 4
    assert shares[0] == pytest.approx(1.0, abs=1e-5)


def test_one_without_weight_far_from_all_others_does_not_leave_the_mixture_empty() -> None:
    weights, means, variances = family(9)
    weights[2], variances[2] = 1e-14, 1e10 * variances[2]  # as after equal samples without noise
    mean, std = moments(weights / weights.sum(), means, variances)
    chosen, shares = condensed(weights, means, variances, 6)
    assert len(chosen) > 1
    kept_mean, kept_std = moments(shares, means[chosen], variances[chosen])
    assert np.abs((kept_mean - mean) / std).max() < 0.05
    assert np.abs(kept_std / std - 1.0).max() < 0.05


@pytest.mark.parametrize("far", [1e200, np.inf, np.nan])
def test_one_whose_moments_overflow_is_left_out(far: float) -> None:
    weights, means, variances = family(9)
    others = np.arange(9) != 2
    chosen, shares = condensed(weights[others], means[others], variances[others], 6)
    weights[2], variances[2, 3] = 1e-14, far
    found, found_shares = condensed(weights, means, variances, 6)
    assert np.array_equal(found, np.flatnonzero(others)[chosen])
    assert found_shares == pytest.approx(shares)


def test_shapes_that_do_not_fit_are_refused() -> None:
    weights, means, variances = family(5)
    with pytest.raises(InvalidInput, match="expected N weights and N x P moments"):
        condensed(weights[:4], means, variances, 3)


def test_the_weight_of_each_kind_is_kept_where_moments_do_not_tell_them_apart() -> None:
    weights, means, variances = family(200)
    kinds = ["a" if number % 3 else "b" for number in range(200)]
    of_a = np.array([kind == "a" for kind in kinds])
    wanted = float(weights[of_a].sum() / weights.sum())
    chosen, shares = condensed(weights, means, variances, 6, kinds)
    assert float(shares[of_a[chosen]].sum()) == pytest.approx(wanted, abs=0.02)
    one_kind = condensed(weights, means, variances, 6, ["a"] * 200)
    np.testing.assert_array_equal(one_kind[1], condensed(weights, means, variances, 6)[1])

"""A Cholesky factor that grows in place is the factor of all its samples, and no factor taken before changes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import solve_triangular

from he3.factor_room import MORE_ROWS, FactorRoom
from he3.frames import FloatArray
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import Matern32

N = 3 * MORE_ROWS


@pytest.fixture
def covariance() -> FloatArray:
    mixed = np.random.default_rng(5).normal(size=(N, N))
    return mixed @ mixed.T / N + np.eye(N)


def grown(covariance: FloatArray, sizes: list[int]) -> tuple[FactorRoom, list[FloatArray]]:
    """The room after blocks of these sizes, and the factor after each block, as it was then."""
    whole = np.linalg.cholesky(covariance)
    room, taken = FactorRoom(whole[:0, :0]), []
    for size in sizes:
        first = room.rows
        rows = whole[first : first + size, : first + size]
        room = room.extended(rows[:, :first], rows[:, first:])
        taken.append(room.factor(room.rows))
    return room, taken


@pytest.mark.parametrize("sizes", [[1] * N, [N], [MORE_ROWS, 1, MORE_ROWS, N - 2 * MORE_ROWS - 1], [7] * (N // 7)])
def test_a_factor_in_a_room_is_the_factor_of_all_its_samples_at_each_size(
    covariance: FloatArray, sizes: list[int]
) -> None:
    whole = np.linalg.cholesky(covariance)
    _, taken = grown(covariance, sizes)
    for factor in taken:
        assert_array_equal(factor, whole[: len(factor), : len(factor)])


@pytest.mark.parametrize("columns", [(), (1,), (5,)])
@pytest.mark.parametrize("transposed", [False, True])
def test_a_room_solves_for_the_factor_of_any_number_of_its_samples(
    covariance: FloatArray, columns: tuple[int, ...], transposed: bool
) -> None:
    room, taken = grown(covariance, [1] * (N - 10))
    for n in (1, 2, MORE_ROWS, N - 10):
        right = np.random.default_rng(n).normal(size=(n, *columns))
        exact = solve_triangular(np.array(taken[n - 1]), right, lower=True, trans=int(transposed))
        assert_allclose(room.solve(right, transposed), exact, rtol=1e-12, atol=1e-12)


def test_a_second_continuation_of_the_same_samples_leaves_the_first_as_it_was(covariance: FloatArray) -> None:
    room, _ = grown(covariance, [1] * 20)
    first = room.extended(np.full((1, 20), 0.25), np.array([[2.0]]))
    of_first = first.factor(21).copy()
    second = room.extended(np.full((1, 20), -0.5), np.array([[3.0]]))
    assert_array_equal(first.factor(21), of_first)
    assert_array_equal(second.factor(21)[:20], of_first[:20])
    assert_array_equal(second.factor(21)[20], [*([-0.5] * 20), 3.0])


def test_a_belief_with_room_is_the_belief_without_sample_by_sample() -> None:
    rng = np.random.default_rng(2)
    places, values = rng.uniform(0, 500, (2 * MORE_ROWS, 2)), rng.normal(8, 2, 2 * MORE_ROWS)
    hyperparameters = Hyperparameters(Matern32(length_scale_m=90.0), noise_std_ppb=0.3, mean_ppb=8.0, scale_ppb=2.0)
    apart, growing, kept = GaussianProcess(hyperparameters), GaussianProcess(hyperparameters).with_room(), []
    for place, value in zip(places, values, strict=True):
        apart = apart.condition([place], [value])
        growing = growing.condition([place], [value])
        kept.append((growing, growing.factor.copy()))
    for name in ("factor", "whitened", "places_m"):
        assert_allclose(getattr(growing, name), getattr(apart, name), rtol=1e-12, atol=1e-12)
    points = rng.uniform(0, 500, (40, 2))
    assert_allclose(growing.predict(points), apart.predict(points), rtol=1e-12)
    assert all(np.array_equal(belief.factor, factor) for belief, factor in kept)
    assert growing.with_room() is growing
    own = growing.without_room()
    assert own.factor.flags.c_contiguous
    assert_array_equal(own.factor, growing.factor)
    assert own.without_room() is own

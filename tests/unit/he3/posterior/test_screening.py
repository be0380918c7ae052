"""The rows that a sum leaves out are bounded by its tolerance, and every row that is needed is read."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_triangular

from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import KERNELS, Kernel
from he3.posterior.screening import ReadPlan, significant_rows
from he3.posterior.stored_rows import FLOAT32, screening_tolerance
from he3.posterior.tiles import TiledGrid

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(0, 80), st.floats(-9, 1))
def test_as_many_rows_are_left_out_as_may_be_and_no_more(seed: int, n: int, exponent: float) -> None:
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(size=n) * 10.0 ** rng.uniform(-8, 0, n)
    peaks = (10.0 ** rng.uniform(-8, 0, (5, n))).astype(np.float32)
    tolerance = 10.0**exponent
    needed = significant_rows(coefficients, peaks, tolerance)
    assert needed.shape == (5, n)
    share = np.abs(coefficients) * peaks
    left_out = np.where(needed, 0.0, share).sum(axis=1)
    assert (left_out <= tolerance * (1 + 1e-6)).all()
    for tile in np.flatnonzero(needed.any(axis=1)):
        assert left_out[tile] + share[tile, needed[tile]].min() >= tolerance * (1 - 1e-6)


def test_rows_of_equal_bounds_are_kept_or_left_out_together() -> None:
    needed = significant_rows(np.ones(4), np.ones((1, 4), dtype=np.float32), tolerance=2.5)
    assert needed.all()
    assert not significant_rows(np.ones(4), np.ones((1, 4), dtype=np.float32), tolerance=4.5).any()


@settings(max_examples=60)
@given(
    seeds,
    st.sampled_from(sorted(KERNELS)),
    st.integers(2, 60),
    st.floats(2.0, 300.0),
    st.floats(0.001, 1.0),
    st.integers(3, 30),
    st.booleans(),
)
def test_what_is_left_out_of_a_row_changes_no_cell_by_more_than_the_tolerance(
    seed: int, name: str, n: int, length: float, noise: float, edge: int, clustered: bool
) -> None:
    rng = np.random.default_rng(seed)
    tiled = TiledGrid(SiteGrid(24, 31, 10.0), edge)
    kernel = _kernel(name, length)
    places = rng.uniform(0, 1, (n, 2)) * [310.0, 240.0]
    if clustered:
        places = places[rng.integers(0, min(n, 4), n)] + rng.normal(0, 3.0, (n, 2))
    process = GaussianProcess(Hyperparameters(kernel, noise)).condition_on_places(places)
    points = tiled.in_tile_order(tiled.grid.points())
    rows = solve_triangular(process.factor[:-1, :-1], kernel.covariance(places[:-1], points), lower=True)
    coefficients, pivot = process.factor[-1, :-1], process.factor[-1, -1]
    peaks = np.maximum.reduceat(np.abs(rows), [tile.cells.start for tile in tiled.tiles], axis=1).T
    tolerance = screening_tolerance(FLOAT32) * np.sqrt(kernel.prior_variance)
    needed = significant_rows(coefficients, peaks.astype(np.float32), tolerance * pivot)
    for tile, kept in zip(tiled.tiles, needed, strict=True):
        left_out = coefficients[~kept] @ rows[~kept, tile.cells] / pivot
        assert np.abs(left_out).max() <= tolerance * (1 + 1e-5)


def _kernel(name: str, length: float) -> Kernel:
    kind = KERNELS[name]
    return kind(0.7, 3 * length, 0.4, length) if name == "smooth+rough" else kind(1.3, length)


@given(seeds, st.integers(0, 150), st.floats(0, 1), st.integers(1, 40))
def test_every_row_that_is_needed_is_read_once(seed: int, n: int, density: float, rows_per_block: int) -> None:
    rng = np.random.default_rng(seed)
    tiled = TiledGrid(SiteGrid(3, 8), 4)
    needed = rng.random((len(tiled.tiles), n)) < density
    rows = rng.integers(-9, 10, (n, tiled.cells)).astype(np.float32)
    blocks = _blocks(rows, tiled, rows_per_block)
    plan = ReadPlan(needed, rows_per_block)
    for tile in tiled.tiles:
        read: list[int] = []
        for numbers, known in plan.batches(tile, blocks):
            here = np.arange(n)[numbers]
            np.testing.assert_array_equal(known, rows[here, tile.cells])
            read += here.tolist()
        assert len(set(read)) == len(read) == plan.rows_read[tile.number] <= 1.5 * needed[tile.number].sum()
        assert set(np.flatnonzero(needed[tile.number])) <= set(read)


def _blocks(rows: np.ndarray, tiled: TiledGrid, rows_per_block: int) -> Sequence[Sequence[np.ndarray]]:
    blocks = []
    for first in range(0, len(rows), rows_per_block):
        block = np.full((rows_per_block, tiled.cells), np.nan, dtype=np.float32)
        block[: len(rows) - first] = rows[first : first + rows_per_block]
        blocks.append([block[:, tile.cells].copy() for tile in tiled.tiles])
    return blocks


@pytest.mark.parametrize("numbers", [[], [0], [63], [0, 63], [10, 11, 12], list(range(64))])
def test_rows_far_apart_in_a_block_are_read_without_those_between(numbers: list[int]) -> None:
    needed = np.zeros((1, 64), dtype=bool)
    needed[0, numbers] = True
    assert ReadPlan(needed, 64).rows_read.tolist() == [len(numbers)]

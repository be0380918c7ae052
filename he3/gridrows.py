"""The rows of V = L^-1 K(samples, cells) on a grid: how a sample's row comes from those before it.

Row n is v = (k_n - l' V) / d, with l and d from row n of the Cholesky factor L. In terms of the kernel itself,
v = (k_n - w' K) / d with w = L^-T l. So there are two ways to get it:

- ``StoredRows`` keeps V, n values a cell in float32, and reads it once: for any kernel, at the speed of memory;
- ``SeparableRows`` keeps nothing: the squared exponential is a product of a function of x and one of y, so w' K over
  the whole grid is one small matrix product, (rows x n) times (n x columns), in float64.

Both are tested to agree; ``rows_for`` takes the second where it applies, since it is faster and takes no memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np
from scipy.linalg import blas, solve_triangular

from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess
from he3.kernels import Float32Array, Kernel, SquaredExponential

ROWS_A_BLOCK = 64  # rows of V allocated together: 64 MB at 500 x 500 cells; V grows by blocks and is never moved
_ROWS_TO_SOLVE = 128  # rows solved for together when many are; more waste in the triangle, fewer waste in the product

RowOnBand = Callable[[slice], Float32Array | FloatArray]


class RowsOnGrid(Protocol):
    """What knows the rows so far and can tell the next."""

    def next_row(self, process: GaussianProcess) -> RowOnBand:
        """The last of the process's n rows as a function of a band (slice of grid rows); all before are known.

        Each band of the grid must be asked for once, in any order, from any thread.
        """

    def make_room(self, process: GaussianProcess) -> None:
        """Get ready for ``store`` of all rows of a process, in place of those known."""

    def store(self, first: int, cells: slice, rows_of_v: Float32Array) -> None:
        """Take in rows (k, cells) of V from number ``first`` on, for some of the cells."""

    def fork(self) -> RowsOnGrid:
        """An independent copy, sharing what neither will change."""


def rows_for(grid: SiteGrid, kernel: Kernel) -> RowsOnGrid:
    """The fastest exact way for that kernel."""
    return SeparableRows(grid, kernel) if isinstance(kernel, SquaredExponential) else StoredRows(grid, kernel)


class StoredRows:
    """All rows, kept in blocks of float32."""

    def __init__(self, grid: SiteGrid, kernel: Kernel) -> None:
        self._grid = grid
        self._kernel = kernel
        self._blocks: list[Float32Array] = []
        self._tail_is_shared = False

    def next_row(self, process: GaussianProcess) -> RowOnBand:
        n = len(process) - 1
        row = self._room_for(n)
        place = process.places_m[n:]
        inverse_pivot = np.float32(1.0 / process.factor[n, n])
        ties = [
            (process.factor[n, first : first + len(block)].astype(np.float32), block) for first, block in self._known(n)
        ]

        def on_band(band: slice) -> Float32Array:
            cells = cells_of(self._grid, band)
            part = row[cells]
            covariance_on_cells(self._kernel, place, self._grid, band, part[None, :])
            for tie, block in ties:
                part -= tie @ block[:, cells]
            part *= inverse_pivot
            return part

        return on_band

    def make_room(self, process: GaussianProcess) -> None:
        blocks = -(-len(process) // ROWS_A_BLOCK)
        self._blocks = [self._new_block() for _ in range(blocks)]
        self._tail_is_shared = False

    def store(self, first: int, cells: slice, rows_of_v: Float32Array) -> None:
        for begin in range(0, len(rows_of_v), ROWS_A_BLOCK):
            piece = rows_of_v[begin : begin + ROWS_A_BLOCK]
            self._blocks[(first + begin) // ROWS_A_BLOCK][: len(piece), cells] = piece

    def fork(self) -> StoredRows:
        copy = StoredRows(self._grid, self._kernel)
        copy._blocks = list(self._blocks)
        copy._tail_is_shared = self._tail_is_shared = True
        return copy

    def _room_for(self, n: int) -> Float32Array:
        """Where row n is to be written. The last block may be another fork's too, and is then copied first."""
        block, offset = divmod(n, ROWS_A_BLOCK)
        if block == len(self._blocks):
            self._blocks.append(self._new_block())
        elif self._tail_is_shared:
            tail = self._new_block()
            tail[:offset] = self._blocks[block][:offset]
            self._blocks[block] = tail
        self._tail_is_shared = False
        row: Float32Array = self._blocks[block][offset]
        return row

    def _known(self, n: int) -> list[tuple[int, Float32Array]]:
        """The first n rows, as (number of its first row, block)."""
        return [(first, self._blocks[first // ROWS_A_BLOCK][: n - first]) for first in range(0, n, ROWS_A_BLOCK)]

    def _new_block(self) -> Float32Array:
        return np.empty((ROWS_A_BLOCK, self._grid.rows * self._grid.columns), dtype=np.float32)


class SeparableRows:
    """The two factors of a squared exponential at the samples: east (n, columns) and north (n, rows)."""

    def __init__(self, grid: SiteGrid, kernel: SquaredExponential) -> None:
        self._grid = grid
        self._kernel = kernel
        self._east = np.empty((0, grid.columns))
        self._north = np.empty((0, grid.rows))

    def next_row(self, process: GaussianProcess) -> RowOnBand:
        n = len(process) - 1
        self._know(process)
        tie, pivot = process.factor[n, :n], process.factor[n, n]
        weights = np.empty(n + 1)
        weights[:n] = -solve_triangular(process.factor[:n, :n], tie, lower=True, trans=1, check_finite=False)
        weights[n] = 1.0
        weights /= pivot
        east = self._east[: n + 1]
        north = self._north[: n + 1] * weights[:, None]

        def on_band(band: slice) -> FloatArray:
            row: FloatArray = (north[:, band].T @ east).ravel()
            return row

        return on_band

    def make_room(self, process: GaussianProcess) -> None:
        self._east = self._east[:0]
        self._north = self._north[:0]
        self._know(process)

    def store(self, first: int, cells: slice, rows_of_v: Float32Array) -> None:
        """Nothing: rows are computed when they are asked for."""

    def fork(self) -> SeparableRows:
        copy = SeparableRows(self._grid, self._kernel)
        copy._east, copy._north = self._east, self._north
        return copy

    def _know(self, process: GaussianProcess) -> None:
        """Bring the factors up to the process's places; never in place, so that forks may share them."""
        new = process.places_m[len(self._east) :]
        decay = -0.5 / self._kernel.length_scale_m**2
        east = self._kernel.variance * np.exp(decay * (new[:, :1] - self._grid.x_m) ** 2)
        north = np.exp(decay * (new[:, 1:] - self._grid.y_m) ** 2)
        self._east = np.vstack((self._east, east))
        self._north = np.vstack((self._north, north))


def solve_rows(
    process: GaussianProcess, factor: Float32Array, grid: SiteGrid, band: slice
) -> Iterator[tuple[int, Float32Array]]:
    """All rows of V on a band, by block forward substitution: (number of the first row, rows (k, cells)), in order.

    factor: the process's Cholesky factor in float32, which the caller converts once for all bands.
    """
    cells = cells_of(grid, band)
    done: list[tuple[int, Float32Array]] = []
    for first in range(0, len(process), _ROWS_TO_SOLVE):
        last = min(first + _ROWS_TO_SOLVE, len(process))
        work = np.empty((last - first, cells.stop - cells.start), dtype=np.float32)
        covariance_on_cells(process.hyperparameters.kernel, process.places_m[first:last], grid, band, work)
        for before, rows in done:
            work -= factor[first:last, before : before + len(rows)] @ rows
        # Transposed, work is in Fortran order, and X L' = work' is solved in place: X' are the rows of V.
        corner = factor[first:last, first:last]
        solved: Float32Array = blas.strsm(1.0, corner, work.T, side=1, lower=1, trans_a=1, overwrite_b=1).T
        done.append((first, solved))
        yield first, solved


def covariance_on_cells(kernel: Kernel, places: FloatArray, grid: SiteGrid, band: slice, out: Float32Array) -> None:
    """Write the kernel between k places [m] and the cells of a band of the grid into out (k, cells), in float32."""
    dx2 = ((places[:, :1] - grid.x_m) ** 2).astype(np.float32)
    dy2 = ((places[:, 1:] - grid.y_m[band]) ** 2).astype(np.float32)
    shaped = out.reshape(len(places), dy2.shape[1], grid.columns)
    if isinstance(kernel, SquaredExponential):  # separable: two short exponentials instead of one long one
        decay = np.float32(-0.5 / kernel.length_scale_m**2)
        east = np.exp(dx2 * decay) * np.float32(kernel.variance)
        north = np.exp(dy2 * decay)
        np.multiply(north[:, :, None], east[:, None, :], out=shaped)
    else:
        kernel.fill(dy2[:, :, None] + dx2[:, None, :], shaped)


def cells_of(grid: SiteGrid, band: slice) -> slice:
    """The cells of a band (slice of grid rows) in the order of ``array.ravel()``."""
    return slice(band.start * grid.columns, band.stop * grid.columns)

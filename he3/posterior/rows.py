"""The rows of V = L^-1 K(samples, cells) on a grid: how a sample's row comes from those before it.

Row n is v = (k_n - l' V) / d, with l and d from row n of the Cholesky factor L. In terms of the kernel itself,
v = (k_n - w' K) / d with w = L^-T l. So there are three ways to get it, all exact:

- ``StoredRows`` keeps V, n values a cell in float32, and reads what matters of it: for any kernel;
- ``SeparableRows`` keeps nothing: the squared exponential is a product of a function of x and one of y, so w' K over
  the whole grid is a few small matrix products, in float64;
- ``SplitRows`` does the one for the smooth part of a kernel and the other for the rough part.

All are tested to agree; ``rows_for`` takes the fastest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

from he3.frames import Float32Array, FloatArray
from he3.gp import GaussianProcess
from he3.hyperparameters import Hyperparameters
from he3.kernels import SmoothPlusRough, SquaredExponential
from he3.posterior.separable_rows import SeparableRows
from he3.posterior.split_rows import SplitRows
from he3.posterior.stored_rows import StoredRows
from he3.posterior.tiles import ShareOut, Tile, TiledGrid

SPLIT_FROM = 256  # samples; the rows of fewer are read in less time than it takes to make two kinds of them [measured]


class RowsOnGrid(Protocol):
    """What knows the rows so far and can tell the next. Rows are in tile order, (cells,)."""

    @property
    def values_read(self) -> int:
        """How many values of the rows known it took to tell the last one."""

    def next_row(self, process: GaussianProcess, share_out: ShareOut) -> Float32Array | FloatArray:
        """The last of the process's n rows, (cells,) in tile order, good until the next; all before are known."""

    def rows_anew(self, process: GaussianProcess) -> Callable[[Tile], Iterator[tuple[int, Float32Array]]]:
        """All rows of a process, in place of those known, as a function of a part of a tile.

        They come in order, several at once: (number of the first, rows (k, cells)). The parts must cover the grid.
        """

    def fork(self) -> RowsOnGrid:
        """An independent copy, sharing what neither will change."""


def rows_for(tiled: TiledGrid, hyperparameters: Hyperparameters, at_once: int | None = None) -> RowsOnGrid:
    """The fastest exact way for that kernel, with no rows yet. The hyperparameters must be without a trend.

    at_once: how many rows are about to be made anew; None if they will come one by one.
    """
    kernel = hyperparameters.kernel
    if isinstance(kernel, SquaredExponential):
        return SeparableRows(tiled, kernel)
    if isinstance(kernel, SmoothPlusRough) and (at_once is None or at_once >= SPLIT_FROM):
        return SplitRows(tiled, kernel, hyperparameters)
    return StoredRows(tiled, kernel)

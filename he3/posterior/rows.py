"""The rows of V = L^-1 K(samples, cells) on a grid: how the row of a new sample follows from the rows before it.

Row n is v = (k_n - l' V) / d, with l and d from row n of the Cholesky factor L. In terms of the kernel itself,
v = (k_n - w' K) / d with w = L^-T l. There are three exact ways to compute it:

- ``StoredRows`` keeps V, n values a cell, and reads the significant part of it: for any kernel;
- ``SeparableRows`` keeps nothing: the squared exponential is a product of a function of x and one of y, so w' K over
  the whole grid is a few small matrix products, in float64;
- ``SplitRows`` uses the second for the smooth part of a kernel and the first for the rough part.

They are tested to agree; ``row_source`` returns the fastest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from he3.gp import GaussianProcess
from he3.kernels import SmoothPlusRough, SquaredExponential
from he3.posterior.separable_rows import SeparableRows
from he3.posterior.split_rows import SplitRows
from he3.posterior.stored_rows import StoredRows

if TYPE_CHECKING:
    from he3.hyperparameters import Hyperparameters
    from he3.posterior.screening import RowBlock
    from he3.posterior.tiles import RunTasks, Tile, TiledGrid

SPLIT_FROM = 256  # samples; the rows of fewer are read in less time than two kinds of rows take to make [measured]


class RowSource(Protocol):
    """Knows the rows so far and computes the next one. Rows are in tile order, (cells,)."""

    @property
    def values_read(self) -> int:
        """How many values of stored rows the last row was computed from."""

    def next_row(self, process: GaussianProcess, run_tasks: RunTasks) -> RowBlock:
        """The last of the process's n rows, (cells,), valid until the next call; all rows before must be known."""

    def recompute(self, process: GaussianProcess) -> Callable[[Tile], Iterator[tuple[int, RowBlock]]]:
        """All rows of a process, replacing those known, as a function of a part of a tile.

        They come in order, several at once: (number of the first, rows (k, cells)). The parts must cover the grid.
        """


def row_source(
    tiled: TiledGrid, hyperparameters: Hyperparameters, dtype: np.dtype[Any], bulk_count: int | None = None
) -> RowSource:
    """The fastest exact source of rows for the hyperparameters' kernel, with no rows yet.

    The hyperparameters must be without a trend. dtype: float32 or float64, of stored and recomputed rows. bulk_count:
    how many rows are about to be recomputed at once; None if they come one by one.
    """
    kernel = hyperparameters.kernel
    if isinstance(kernel, SquaredExponential):
        return SeparableRows(tiled, kernel, dtype)
    if isinstance(kernel, SmoothPlusRough) and (bulk_count is None or bulk_count >= SPLIT_FROM):
        smooth, rough = SeparableRows(tiled, kernel.smooth, dtype), StoredRows(tiled, kernel.rough, dtype)
        return SplitRows(kernel, smooth, rough, GaussianProcess(replace(hyperparameters, kernel=kernel.rough)))
    return StoredRows(tiled, kernel, dtype)

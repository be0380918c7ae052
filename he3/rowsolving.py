"""Rows of V = L^-1 K(samples, cells) from the kernel, on a part of a grid: the covariances, and the triangle solved."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.linalg import blas

from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess
from he3.kernels import Float32Array, Kernel, SquaredExponential
from he3.tiles import Tile

_ROWS_TO_SOLVE = 128  # rows solved for together when many are; more waste in the triangle, fewer waste in the product


def solve_rows(
    process: GaussianProcess, factor: Float32Array, grid: SiteGrid, part: Tile
) -> Iterator[tuple[int, Float32Array]]:
    """All rows of V on a part, by block forward substitution: (number of the first row, rows (k, cells)), in order.

    factor: the process's Cholesky factor in float32, which the caller converts once for all parts.
    """
    done: list[tuple[int, Float32Array]] = []
    for first in range(0, len(process), _ROWS_TO_SOLVE):
        last = min(first + _ROWS_TO_SOLVE, len(process))
        work = np.empty((last - first, part.cells.stop - part.cells.start), dtype=np.float32)
        covariance_on_cells(process.hyperparameters.kernel, process.places_m[first:last], grid, part, work)
        for before, rows in done:
            work -= factor[first:last, before : before + len(rows)] @ rows
        # Transposed, work is in Fortran order, and X L' = work' is solved in place: X' are the rows of V.
        corner = factor[first:last, first:last]
        solved: Float32Array = blas.strsm(1.0, corner, work.T, side=1, lower=1, trans_a=1, overwrite_b=1).T
        done.append((first, solved))
        yield first, solved


def covariance_on_cells(kernel: Kernel, places: FloatArray, grid: SiteGrid, part: Tile, out: Float32Array) -> None:
    """Write the kernel between k places [m] and the cells of a part of the grid into out (k, cells), in float32."""
    dx2 = ((places[:, :1] - grid.x_m[part.columns]) ** 2).astype(np.float32)
    dy2 = ((places[:, 1:] - grid.y_m[part.rows]) ** 2).astype(np.float32)
    shaped = out.reshape(len(places), *part.shape)
    if isinstance(kernel, SquaredExponential):  # separable: two short exponentials instead of one long one
        decay = np.float32(-0.5 / kernel.length_scale_m**2)
        east = np.exp(dx2 * decay) * np.float32(kernel.variance)
        north = np.exp(dy2 * decay)
        np.multiply(north[:, :, None], east[:, None, :], out=shaped)
    else:
        kernel.fill(dy2[:, :, None] + dx2[:, None, :], shaped)

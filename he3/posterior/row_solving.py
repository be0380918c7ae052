"""Rows of V = L^-1 K(samples, cells) from the kernel, on a part of a grid: the covariances, and the triangle solved."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.linalg import blas

from he3.frames import Float32Array, FloatArray, SiteGrid
from he3.gp import GaussianProcess
from he3.kernels import Kernel, SmoothPlusRough, SquaredExponential
from he3.posterior.tiles import Tile, TiledGrid

_ROWS_TO_SOLVE = 128  # rows solved for together when many are; more waste in the triangle, fewer waste in the product


def solve_rows(
    process: GaussianProcess, factor: Float32Array, grid: SiteGrid, part: Tile
) -> Iterator[tuple[int, Float32Array]]:
    """All rows of V on a part, by block forward substitution: (number of the first row, rows (k, cells)), in order.

    factor: the process's Cholesky factor in float32, which the caller converts once for all parts.
    """
    dx2 = squared_offsets(process.places_m, grid.x_m[part.columns], 0)
    dy2 = squared_offsets(process.places_m, grid.y_m[part.rows], 1)
    done: list[tuple[int, Float32Array]] = []
    for first in range(0, len(process), _ROWS_TO_SOLVE):
        last = min(first + _ROWS_TO_SOLVE, len(process))
        work = np.empty((last - first, part.size), dtype=np.float32)
        covariance_on_cells(process.hyperparameters.kernel, dx2[first:last], dy2[first:last], work)
        for before, rows in done:
            work -= factor[first:last, before : before + len(rows)] @ rows
        # Transposed, work is in Fortran order, and X L' = work' is solved in place: X' are the rows of V.
        corner = factor[first:last, first:last]
        solved: Float32Array = blas.strsm(1.0, corner, work.T, side=1, lower=1, trans_a=1, overwrite_b=1).T
        done.append((first, solved))
        yield first, solved


def fill_covariance(kernel: Kernel, place_m: FloatArray, tiled: TiledGrid, out: Float32Array) -> None:
    """Write the kernel between one place (2,) [m] and all cells into out (cells,), in tile order and float32."""
    dx2 = squared_offsets(place_m[None, :], tiled.grid.x_m, 0)
    dy2 = squared_offsets(place_m[None, :], tiled.grid.y_m, 1)
    for tile in tiled.tiles:
        covariance_on_cells(kernel, dx2[:, tile.columns], dy2[:, tile.rows], out[tile.cells])


def squared_offsets(places: FloatArray, axis_m: FloatArray, coordinate: int) -> Float32Array:
    """Squared distances (k, cells) [m^2] of k places (k, 2) [m] from the cells along an axis; coordinate 0 is east."""
    offsets: Float32Array = ((places[:, coordinate, None] - axis_m) ** 2).astype(np.float32)
    return offsets


def covariance_on_cells(kernel: Kernel, dx2: Float32Array, dy2: Float32Array, out: Float32Array) -> None:
    """Write the kernel between k places and cells in rows and columns into out (k, rows * columns), in float32.

    dx2: (k, columns) and dy2: (k, rows), the places' ``squared_offsets`` [m^2].
    """
    shaped = out.reshape(len(dy2), dy2.shape[1], dx2.shape[1])
    if isinstance(kernel, SquaredExponential):  # separable: two short exponentials instead of one long one
        decay = np.float32(-0.5 / kernel.length_scale_m**2)
        east = np.exp(dx2 * decay) * np.float32(kernel.variance)
        north = np.exp(dy2 * decay)
        np.multiply(north[:, :, None], east[:, None, :], out=shaped)
    elif isinstance(kernel, SmoothPlusRough):
        covariance_on_cells(kernel.smooth, dx2, dy2, out)
        rough = dy2[:, :, None] + dx2[:, None, :]
        kernel.rough.fill(rough, rough)
        shaped += rough
    else:
        kernel.fill(dy2[:, :, None] + dx2[:, None, :], shaped)

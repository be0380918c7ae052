"""Rows of V = L^-1 K(samples, cells) on a part of a grid: covariances from the kernel, and the triangular solve."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas

from he3.kernels import Kernel, SmoothPlusRough, SquaredExponential, Stretched
from he3.local_amplitude import LocallyScaled

if TYPE_CHECKING:
    from he3.frames import FloatArray, SiteGrid
    from he3.gp import GaussianProcess
    from he3.posterior.screening import RowBlock
    from he3.posterior.tiles import Tile, TiledGrid

_BY_PLACES = Stretched, LocallyScaled  # kernels that are no functions of east^2 + north^2
_ROWS_TO_SOLVE = 128  # rows solved for together; more waste time in the triangle, fewer in the product [measured]


@dataclass(frozen=True, slots=True)
class RowCombination:
    """A row (k_n - coefficients' V) / pivot of the n rows known, and how far each of its values may be off."""

    coefficients: FloatArray
    pivot: float
    tolerance: float


def solve_rows(
    process: GaussianProcess, factor: NDArray[np.floating], grid: SiteGrid, part: Tile
) -> Iterator[tuple[int, RowBlock]]:
    """All rows of V on a part, by block forward substitution: (number of the first row, rows (k, cells)), in order.

    factor: the process's Cholesky factor (n, n) in the precision of the rows, converted once for all parts.
    """
    dtype, kernel = factor.dtype, process.hyperparameters.kernel
    trsm = blas.strsm if dtype == np.float32 else blas.dtrsm
    dx2 = squared_offsets(process.places_m, grid.x_m[part.columns], 0, dtype)
    dy2 = squared_offsets(process.places_m, grid.y_m[part.rows], 1, dtype)
    solved_before: list[tuple[int, RowBlock]] = []
    for first in range(0, len(process), _ROWS_TO_SOLVE):
        last = min(first + _ROWS_TO_SOLVE, len(process))
        work = np.empty((last - first, part.size), dtype=dtype)
        if isinstance(kernel, _BY_PLACES):
            _by_places_on_cells(kernel, process.places_m[first:last], grid.x_m[part.columns], grid.y_m[part.rows], work)
        else:
            covariance_on_cells(kernel, dx2[first:last], dy2[first:last], work)
        for before, rows in solved_before:
            work -= factor[first:last, before : before + len(rows)] @ rows
        # Transposed, work is in Fortran order, and X L' = work' is solved in place: X' are the rows of V.
        corner = factor[first:last, first:last]
        solved: RowBlock = trsm(1.0, corner, work.T, side=1, lower=1, trans_a=1, overwrite_b=1).T
        solved_before.append((first, solved))
        yield first, solved


def fill_covariance(kernel: Kernel, place_m: FloatArray, tiled: TiledGrid, out: NDArray[np.floating]) -> None:
    """Write the kernel between one place (2,) [m] and all cells, in tile order, into out (cells,)."""
    if isinstance(kernel, _BY_PLACES):
        x, y = tiled.grid.x_m, tiled.grid.y_m
        for tile in tiled.tiles:
            _by_places_on_cells(kernel, place_m[None, :], x[tile.columns], y[tile.rows], out[None, tile.cells])
        return
    dx2 = squared_offsets(place_m[None, :], tiled.grid.x_m, 0, out.dtype)
    dy2 = squared_offsets(place_m[None, :], tiled.grid.y_m, 1, out.dtype)
    for tile in tiled.tiles:
        covariance_on_cells(kernel, dx2[:, tile.columns], dy2[:, tile.rows], out[tile.cells])


def squared_offsets(
    places_m: FloatArray, axis_m: FloatArray, coordinate: int, dtype: np.dtype[Any]
) -> NDArray[np.floating]:
    """Squared offsets (k, cells) [m^2] of places (k, 2) [m] from the cells along one axis; coordinate 0 is east."""
    offsets: NDArray[np.floating] = ((places_m[:, coordinate, None] - axis_m) ** 2).astype(dtype)
    return offsets


def covariance_on_cells(
    kernel: Kernel, dx2: NDArray[np.floating], dy2: NDArray[np.floating], out: NDArray[np.floating]
) -> None:
    """Write the kernel between k places and rows x columns of cells into out (k, rows * columns).

    dx2: (k, columns) and dy2: (k, rows), the ``squared_offsets`` [m^2] in the precision of out.
    """
    shaped = out.reshape(len(dy2), dy2.shape[1], dx2.shape[1])
    if isinstance(kernel, SquaredExponential):  # separable: two short exponentials instead of one long one
        scalar = out.dtype.type
        decay = scalar(-0.5 / kernel.length_scale_m**2)
        east = np.exp(dx2 * decay) * scalar(kernel.variance)
        north = np.exp(dy2 * decay)
        np.multiply(north[:, :, None], east[:, None, :], out=shaped)
    elif isinstance(kernel, SmoothPlusRough):
        covariance_on_cells(kernel.smooth, dx2, dy2, out)
        shaped += _of_squared_distance(kernel.rough, dy2[:, :, None] + dx2[:, None, :])
    elif out.dtype == np.float32:
        kernel.fill(dy2[:, :, None] + dx2[:, None, :], shaped)
    else:
        shaped[...] = _of_squared_distance(kernel, dy2[:, :, None] + dx2[:, None, :])


def _by_places_on_cells(
    kernel: Kernel, places_m: FloatArray, x_m: FloatArray, y_m: FloatArray, out: NDArray[np.floating]
) -> None:
    """Write the kernel between k places (k, 2) and the cells at x (columns,) and y (rows,) [m] into out (k, cells).

    In float64: only the coarse maps of a mixture have such kernels.
    """
    x, y = np.meshgrid(x_m, y_m)
    out[...] = kernel.covariance(places_m, np.column_stack((x.ravel(), y.ravel())))


def _of_squared_distance(kernel: Kernel, r2: NDArray[np.floating]) -> NDArray[np.floating]:
    """The kernel at squared distances [m^2], in their precision; float32 distances are overwritten."""
    if r2.dtype == np.float32:
        kernel.fill(r2, r2)
        return r2
    return kernel.of_squared_distance(r2.astype(np.float64, copy=False))


def row_weights(process: GaussianProcess) -> FloatArray:
    """Weights (n,) of the kernel at the samples in the last row of V: (-L^-T l, 1) / d, with l of the rows before."""
    last = np.zeros(len(process))
    last[-1] = 1.0
    return process.solve(last, transposed=True)

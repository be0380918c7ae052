"""Rows of V for the squared exponential, of which none is kept: a product of a function of x and one of y.

With w = L^-T l, a new row is (k_n - w' K) / d, a sum of n + 1 squared exponentials over the grid. On a tile, such a sum
is so smooth that it is known from its values at a few Chebyshev nodes an axis: those are one small matrix product,
(nodes x n) times (n x nodes), and two smaller ones carry them to the cells. All is in float64 and as near as that: the
number of nodes follows from the bound on the error of interpolation (Trefethen, Approximation Theory and Approximation
Practice, 2013, theorem 8.2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby

import numpy as np
from scipy.linalg import solve_triangular

from he3.frames import Float32Array, FloatArray
from he3.gp import GaussianProcess
from he3.kernels import SquaredExponential
from he3.posterior.row_solving import solve_rows
from he3.posterior.tiles import ShareOut, Tile, TiledGrid

_ROUNDING = 2.0**-53  # of float64: the interpolation of a function of size 1 is off by no more


@dataclass(frozen=True, slots=True, eq=False)
class SmoothPiece:
    """Nodes (m,) [m] along a piece of an axis, and the matrix (cells, m) that carries values there to the cells."""

    nodes_m: FloatArray
    to_cells: FloatArray

    @classmethod
    def of(cls, cells_m: FloatArray, length_scale_m: float) -> SmoothPiece:
        """Nodes for squared exponentials of that length scale, wherever they are centred; never more than cells."""
        extent = float(cells_m[-1] - cells_m[0])
        count = _nodes_needed(extent / length_scale_m)
        if count >= len(cells_m):
            return cls(cells_m, np.eye(len(cells_m)))
        order = np.arange(count)
        nodes = cells_m[0] + extent * 0.5 * (1.0 - np.cos(np.pi * order / (count - 1)))
        # The barycentric formula, with the weights of Chebyshev points (Trefethen 2013, theorem 5.2).
        weights = np.where(order % 2 == 0, 1.0, -1.0)
        weights[[0, -1]] *= 0.5
        distance = cells_m[:, None] - nodes
        met = distance == 0.0
        to_cells = weights / np.where(met, 1.0, distance)
        to_cells /= to_cells.sum(axis=1, keepdims=True)
        at_node = met.any(axis=1)
        to_cells[at_node] = met[at_node]
        return cls(nodes, to_cells)


def _nodes_needed(lengths: float) -> int:
    """Chebyshev nodes for that many length scales: every ellipse around the axis gives a bound, the best one counts."""
    size = np.geomspace(1.01, 1e3, 500)  # sum of the half-axes of the ellipse, if the axis is [-1, 1]
    largest = 0.5 * (lengths / 4.0 * (size - 1.0 / size)) ** 2  # logarithm of |exp(-z^2 / 2)| on it
    degree = (largest + np.log(4.0 / (size - 1.0)) - np.log(_ROUNDING)) / np.log(size)
    return max(int(np.ceil(degree.min())), 1) + 1


class _Axis:
    """The factor of a squared exponential along one axis, at the nodes of every piece of it."""

    def __init__(self, cells_m: FloatArray, pieces: list[slice], length_scale_m: float) -> None:
        self._decay = -0.5 / length_scale_m**2
        smooth = [SmoothPiece.of(cells_m[piece], length_scale_m) for piece in pieces]
        ends = np.cumsum([len(piece.nodes_m) for piece in smooth]).tolist()
        self._nodes_m = np.concatenate([piece.nodes_m for piece in smooth])
        self._pieces = {
            cells.start: (slice(end - len(piece.nodes_m), end), piece.to_cells)
            for cells, piece, end in zip(pieces, smooth, ends, strict=True)
        }

    def factor(self, coordinate_m: FloatArray) -> FloatArray:
        """The factor of samples (n,) [m] at all nodes, (n, nodes)."""
        factor: FloatArray = np.exp(self._decay * (coordinate_m[:, None] - self._nodes_m) ** 2)
        return factor

    def piece(self, cells: slice) -> tuple[slice, FloatArray]:
        """Which nodes are those of that piece, and how they are carried to its cells."""
        return self._pieces[cells.start]


class SeparableRows:
    """The two factors of a squared exponential at the samples, (n, nodes) each; ``values_read`` is 0 always."""

    values_read = 0

    def __init__(self, tiled: TiledGrid, kernel: SquaredExponential) -> None:
        """No rows yet."""
        self._tiled = tiled
        self._kernel = kernel
        self._beside = [list(tiles) for _, tiles in groupby(tiled.tiles, key=lambda tile: tile.rows.start)]
        self._eastward = _Axis(tiled.grid.x_m, [tile.columns for tile in self._beside[0]], kernel.length_scale_m)
        self._northward = _Axis(tiled.grid.y_m, [tiles[0].rows for tiles in self._beside], kernel.length_scale_m)
        self._forget()

    def next_row(self, process: GaussianProcess, share_out: ShareOut) -> FloatArray:
        """The last of the process's n rows, (cells,) in tile order."""
        return self.next_sum(process.places_m, row_weights(process), share_out)

    def next_sum(self, places_m: FloatArray, weights: FloatArray, share_out: ShareOut) -> FloatArray:
        """The kernel at places (n, 2) [m] times weights (n,), summed up, (cells,) in tile order.

        The places must begin with those of the call before.
        """
        self._know(places_m)
        east = self._east
        north = self._north * (self._kernel.variance * weights)[:, None]
        total = np.empty(self._tiled.cells)

        def add_up(beside: Sequence[Tile]) -> None:
            rows, to_rows = self._northward.piece(beside[0].rows)
            at_nodes = to_rows @ (north[:, rows].T @ east)
            for tile in beside:
                columns, to_columns = self._eastward.piece(tile.columns)
                np.matmul(at_nodes[:, columns], to_columns.T, out=total[tile.cells].reshape(tile.shape))

        share_out(partial(add_up, beside) for beside in self._beside)
        return total

    def rows_anew(self, process: GaussianProcess) -> Callable[[Tile], Iterator[tuple[int, Float32Array]]]:
        """All rows of a process, in place of those known, as a function of a part of a tile: see ``RowsOnGrid``."""
        self._forget()
        self._know(process.places_m)
        factor = process.factor.astype(np.float32)
        return lambda part: solve_rows(process, factor, self._tiled.grid, part)

    def fork(self) -> SeparableRows:
        """An independent copy, sharing what neither will change."""
        copy: SeparableRows = object.__new__(SeparableRows)
        copy.__dict__.update(self.__dict__)
        return copy

    def _forget(self) -> None:
        nowhere = np.empty(0)
        self._east, self._north = self._eastward.factor(nowhere), self._northward.factor(nowhere)

    def _know(self, places_m: FloatArray) -> None:
        """Bring the factors up to the places; never in place, so that forks may share them."""
        new = places_m[len(self._east) :]
        self._east = np.vstack((self._east, self._eastward.factor(new[:, 0])))
        self._north = np.vstack((self._north, self._northward.factor(new[:, 1])))


def row_weights(process: GaussianProcess) -> FloatArray:
    """Weights (n,) of the kernel at the samples in the last row of V: with L^-T l from above, (-L^-T l, 1) / d."""
    last = np.zeros(len(process))
    last[-1] = 1.0
    weights: FloatArray = solve_triangular(process.factor, last, lower=True, trans=1, check_finite=False)
    return weights

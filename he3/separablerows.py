"""Rows of V for the squared exponential, of which none is kept: a product of a function of x and one of y.

With w = L^-T l, a new row is (k_n - w' K) / d, a sum of n + 1 squared exponentials over the grid. Such a sum is so
smooth that it is known everywhere from its values at a few dozen Chebyshev nodes an axis: those are one small matrix
product, (nodes x n) times (n x nodes), and two more carry them to the cells. All is in float64 and as near as that: the
number of nodes follows from the bound on the error of interpolation (Trefethen, Approximation Theory and Approximation
Practice, 2013, theorem 8.2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from he3.frames import FloatArray
from he3.gp import GaussianProcess
from he3.kernels import Float32Array, SquaredExponential
from he3.rowsolving import solve_rows
from he3.tiles import Tile, TiledGrid

_ROUNDING = 2.0**-53  # of float64: the interpolation of a function of size 1 is off by no more


@dataclass(frozen=True, slots=True, eq=False)
class SmoothAxis:
    """Nodes (m,) [m] along an axis, and the matrix (cells, m) that carries values there to the cells' centres."""

    nodes_m: FloatArray
    to_cells: FloatArray

    @classmethod
    def of(cls, axis_m: FloatArray, length_scale_m: float) -> SmoothAxis:
        """Nodes for squared exponentials of that length scale, wherever they are centred; never more than cells."""
        extent = float(axis_m[-1] - axis_m[0])
        count = _nodes_needed(extent / length_scale_m)
        if count >= len(axis_m):
            return cls(axis_m, np.eye(len(axis_m)))
        angle = np.pi * np.arange(count) / (count - 1)
        nodes = axis_m[0] + extent * 0.5 * (1.0 - np.cos(angle))
        # The barycentric formula with the weights of Chebyshev points (Trefethen 2013, theorem 5.2).
        weights = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
        weights[[0, -1]] *= 0.5
        distance = axis_m[:, None] - nodes
        at_node = distance == 0.0
        to_cells = weights / np.where(at_node, 1.0, distance)
        to_cells /= to_cells.sum(axis=1, keepdims=True)
        hit = at_node.any(axis=1)
        to_cells[hit] = at_node[hit]
        return cls(nodes, to_cells)


def _nodes_needed(lengths: float) -> int:
    """Chebyshev nodes for that many length scales: every ellipse around the axis gives a bound, the best counts."""
    size = np.geomspace(1.01, 1e3, 500)  # sum of the half-axes of the ellipse, if the axis is [-1, 1]
    largest = 0.5 * (lengths / 4.0 * (size - 1.0 / size)) ** 2  # logarithm of |exp(-z^2 / 2)| on it
    degree = (largest + np.log(4.0 / (size - 1.0)) - np.log(_ROUNDING)) / np.log(size)
    return max(int(np.ceil(degree.min())), 1) + 1


class SeparableRows:
    """The two factors of a squared exponential at the samples: on the nodes, east (n, m) and north (n, m)."""

    values_read = 0

    def __init__(self, tiled: TiledGrid, kernel: SquaredExponential) -> None:
        self._tiled = tiled
        self._kernel = kernel
        self._east_axis = SmoothAxis.of(tiled.grid.x_m, kernel.length_scale_m)
        self._north_axis = SmoothAxis.of(tiled.grid.y_m, kernel.length_scale_m)
        self._east = np.empty((0, len(self._east_axis.nodes_m)))
        self._north = np.empty((0, len(self._north_axis.nodes_m)))

    def next_row(self, process: GaussianProcess) -> Callable[[Tile], FloatArray]:
        """The last of the process's n rows as a function of a tile; any before may be new too."""
        return self.next_sum(process.places_m, row_weights(process))

    def next_sum(self, places_m: FloatArray, weights: FloatArray) -> Callable[[Tile], FloatArray]:
        """The sum of weights (n,) times the kernel at places (n, 2) [m], as a function of a tile.

        The places must begin with those of the call before.
        """
        self._know(places_m)
        at_nodes = (self._north * weights[:, None]).T @ self._east
        eastward = at_nodes @ self._east_axis.to_cells.T

        def on_tile(tile: Tile) -> FloatArray:
            values: FloatArray = (self._north_axis.to_cells[tile.rows] @ eastward[:, tile.columns]).ravel()
            return values

        return on_tile

    def rows_anew(self, process: GaussianProcess) -> Callable[[Tile], Iterator[tuple[int, Float32Array]]]:
        """All rows of a process, in place of those known, as a function of a part of a tile: see ``RowsOnGrid``."""
        self._east, self._north = self._east[:0], self._north[:0]
        self._know(process.places_m)
        factor = process.factor.astype(np.float32)
        return lambda part: solve_rows(process, factor, self._tiled.grid, part)

    def fork(self) -> SeparableRows:
        """An independent copy, sharing what neither will change."""
        copy: SeparableRows = object.__new__(SeparableRows)
        copy.__dict__.update(self.__dict__)
        return copy

    def _know(self, places_m: FloatArray) -> None:
        """Bring the factors up to the places; never in place, so that forks may share them."""
        new = places_m[len(self._east) :]
        decay = -0.5 / self._kernel.length_scale_m**2
        east = self._kernel.variance * np.exp(decay * (new[:, :1] - self._east_axis.nodes_m) ** 2)
        north = np.exp(decay * (new[:, 1:] - self._north_axis.nodes_m) ** 2)
        self._east = np.vstack((self._east, east))
        self._north = np.vstack((self._north, north))


def row_weights(process: GaussianProcess) -> FloatArray:
    """Weights (n,) of the kernel at all samples in the last row of V: (-L^-T l, 1) / d."""
    n = len(process) - 1
    weights = np.empty(n + 1)
    weights[:n] = -solve_triangular(
        process.factor[:n, :n], process.factor[n, :n], lower=True, trans=1, check_finite=False
    )
    weights[n] = 1.0
    weights /= process.factor[n, n]
    return weights

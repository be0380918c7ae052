"""Rows of V for the squared exponential, none of which is stored: a product of a function of x and one of y.

With w = L^-T l, a new row is (k_n - w' K) / d, a sum of n + 1 squared exponentials over the grid. On a tile, such a sum
is so smooth that its values at a few Chebyshev nodes per axis determine it: those are one small matrix product,
(nodes x n) times (n x nodes), and two smaller products interpolate them to the cells. New rows are in float64 and
accurate to it: the number of nodes follows from the bound on the interpolation error (Trefethen, Approximation Theory
and Approximation Practice, 2013, theorem 8.2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from he3.posterior.row_solving import row_weights, solve_rows

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.gp import GaussianProcess
    from he3.kernels import SquaredExponential
    from he3.posterior.screening import RowBlock
    from he3.posterior.tiles import RunTasks, Tile, TiledGrid

_INTERPOLATION_ERROR = 2.0**-53  # 1, of a function of size 1: what float64 rounds off


@dataclass(frozen=True, slots=True, eq=False)
class ChebyshevPiece:
    """Chebyshev nodes (m,) [m] on a piece of an axis, and the matrix (cells, m) that interpolates to its cells."""

    nodes_m: FloatArray
    to_cells: FloatArray

    @classmethod
    def of(cls, cells_m: FloatArray, length_scale_m: float) -> ChebyshevPiece:
        """The piece for squared exponentials of that length scale [m], wherever they are centred.

        cells_m: (cells,) ascending coordinates [m]. There are at most as many nodes as cells.
        """
        extent = float(cells_m[-1] - cells_m[0])
        count = _nodes_needed(extent / length_scale_m)
        if count >= len(cells_m):
            return cls(cells_m, np.eye(len(cells_m)))
        order = np.arange(count)
        nodes = cells_m[0] + extent * 0.5 * (1.0 - np.cos(np.pi * order / (count - 1)))
        # Barycentric interpolation with the weights of Chebyshev points (Trefethen 2013, theorem 5.2).
        weights = np.where(order % 2 == 0, 1.0, -1.0)
        weights[[0, -1]] *= 0.5
        distance = cells_m[:, None] - nodes
        coincide = distance == 0.0
        to_cells = weights / np.where(coincide, 1.0, distance)
        to_cells /= to_cells.sum(axis=1, keepdims=True)
        on_node = coincide.any(axis=1)
        to_cells[on_node] = coincide[on_node]
        return cls(nodes, to_cells)


def _nodes_needed(lengths: float) -> int:
    """Chebyshev nodes for an interval of that many length scales: the least that any Bernstein ellipse asks for."""
    size = np.geomspace(1.01, 1e3, 500)  # sum of the half-axes of the ellipse, if the axis is [-1, 1]
    largest = 0.5 * (lengths / 4.0 * (size - 1.0 / size)) ** 2  # logarithm of |exp(-z^2 / 2)| on it
    degree = (largest + np.log(4.0 / (size - 1.0)) - np.log(_INTERPOLATION_ERROR)) / np.log(size)
    return max(int(np.ceil(degree.min())), 1) + 1


class _AxisFactors:
    """The factor of a squared exponential along one axis, at the nodes of every piece of it."""

    def __init__(self, cells_m: FloatArray, slices: list[slice], length_scale_m: float) -> None:
        self._decay = -0.5 / length_scale_m**2
        pieces = [ChebyshevPiece.of(cells_m[cells], length_scale_m) for cells in slices]
        ends = np.cumsum([len(piece.nodes_m) for piece in pieces]).tolist()
        self._nodes_m = np.concatenate([piece.nodes_m for piece in pieces])
        self._pieces = {
            cells.start: (slice(end - len(piece.nodes_m), end), piece.to_cells)
            for cells, piece, end in zip(slices, pieces, ends, strict=True)
        }

    def at_nodes(self, coordinate_m: FloatArray) -> FloatArray:
        """The factor (n, nodes) between samples (n,) [m] and all nodes."""
        factor: FloatArray = np.exp(self._decay * (coordinate_m[:, None] - self._nodes_m) ** 2)
        return factor

    def piece(self, cells: slice) -> tuple[slice, FloatArray]:
        """The range of nodes of the piece that begins where ``cells`` does, and its interpolation matrix (cells, m)."""
        return self._pieces[cells.start]


class SeparableRows:
    """The two factors of a squared exponential at the samples, (n, nodes) each; it stores and reads no rows."""

    values_read = 0

    def __init__(self, tiled: TiledGrid, kernel: SquaredExponential, dtype: np.dtype[Any]) -> None:
        """No rows yet. dtype: of the rows that ``recompute`` yields."""
        self._tiled = tiled
        self._kernel = kernel
        self._dtype = dtype
        self._tile_rows = [list(tiles) for _, tiles in groupby(tiled.tiles, key=lambda tile: tile.rows.start)]
        self._eastward = _AxisFactors(
            tiled.grid.x_m, [tile.columns for tile in self._tile_rows[0]], kernel.length_scale_m
        )
        self._northward = _AxisFactors(
            tiled.grid.y_m, [tiles[0].rows for tiles in self._tile_rows], kernel.length_scale_m
        )
        self._clear()

    def next_row(self, process: GaussianProcess, run_tasks: RunTasks) -> FloatArray:
        """The last of the process's n rows, (cells,) in tile order, in float64."""
        return self.weighted_sum(process.places_m, row_weights(process), run_tasks)

    def weighted_sum(self, places_m: FloatArray, weights: FloatArray, run_tasks: RunTasks) -> FloatArray:
        """Sum (cells,), in tile order, of the kernel at places (n, 2) [m] times weights (n,).

        The places must begin with those of the call before.
        """
        self._extend(places_m)
        east = self._east
        north = self._north * (self._kernel.variance * weights)[:, None]
        total = np.empty(self._tiled.cells)

        def sum_tile_row(tiles: Sequence[Tile]) -> None:
            rows, to_rows = self._northward.piece(tiles[0].rows)
            at_nodes = to_rows @ (north[:, rows].T @ east)
            for tile in tiles:
                columns, to_columns = self._eastward.piece(tile.columns)
                np.matmul(at_nodes[:, columns], to_columns.T, out=total[tile.cells].reshape(tile.shape))

        run_tasks(partial(sum_tile_row, tiles) for tiles in self._tile_rows)
        return total

    def recompute(self, process: GaussianProcess) -> Callable[[Tile], Iterator[tuple[int, RowBlock]]]:
        """All rows of a process, replacing those known, as a function of a part of a tile: see ``RowSource``."""
        self._clear()
        self._extend(process.places_m)
        factor = process.factor.astype(self._dtype)
        return lambda part: solve_rows(process, factor, self._tiled.grid, part)

    def _clear(self) -> None:
        nowhere = np.empty(0)
        self._east, self._north = self._eastward.at_nodes(nowhere), self._northward.at_nodes(nowhere)

    def _extend(self, places_m: FloatArray) -> None:
        """Bring the factors up to the places (n, 2) [m]."""
        new = places_m[len(self._east) :]
        self._east = np.vstack((self._east, self._eastward.at_nodes(new[:, 0])))
        self._north = np.vstack((self._north, self._northward.at_nodes(new[:, 1])))

"""The grid cut into rectangular tiles, and the order of its cells by tile.

Cells that are processed together are stored together: a tile's values fit into a core's cache, and one number per
tile bounds how much a distant sample matters there. Arrays over cells in tile order are flat, ``(..., cells)``, and
the cells of a tile are consecutive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from he3.frames import FloatArray, SiteGrid

Scalar = TypeVar("Scalar", bound=np.generic)

# cells, longest edge of a tile. A float32 row of V on a tile is then 64 kB, long enough to be read at full memory
# speed. On tiles of 64 cells it is not; on tiles of 250 too many rows matter somewhere [measured].
TILE_EDGE = 128


@dataclass(frozen=True, slots=True)
class Tile:
    """A rectangle of the grid: its row and column ranges, and its range of cells in tile order, row by row."""

    number: int
    rows: slice
    columns: slice
    cells: slice

    @property
    def shape(self) -> tuple[int, int]:
        return _slice_length(self.rows), _slice_length(self.columns)

    @property
    def size(self) -> int:
        rows, columns = self.shape
        return rows * columns

    def parts(self, cells: int) -> Iterator[Tile]:
        """The tile cut into strips of whole rows with about ``cells`` cells each, all with the tile's number."""
        rows, columns = self.shape
        height = max(1, cells // columns)
        for first in range(0, rows, height):
            last = min(first + height, rows)
            yield Tile(
                self.number,
                slice(self.rows.start + first, self.rows.start + last),
                self.columns,
                slice(self.cells.start + first * columns, self.cells.start + last * columns),
            )


Task = Callable[[], None]
RunTasks = Callable[[Iterable[Task]], None]
"""Runs all tasks, in any order and possibly on several threads, and returns when all are done."""


@dataclass(frozen=True, slots=True)
class TiledGrid:
    """A grid and its tiles: all of about the same size, none with an edge longer than ``edge`` cells."""

    grid: SiteGrid
    edge: int = TILE_EDGE
    tiles: tuple[Tile, ...] = field(init=False)

    def __post_init__(self) -> None:
        tiles: list[Tile] = []
        for rows in _even_slices(self.grid.rows, self.edge):
            for columns in _even_slices(self.grid.columns, self.edge):
                first = tiles[-1].cells.stop if tiles else 0
                count = (rows.stop - rows.start) * (columns.stop - columns.start)
                tiles.append(Tile(len(tiles), rows, columns, slice(first, first + count)))
        object.__setattr__(self, "tiles", tuple(tiles))

    @property
    def cells(self) -> int:
        return self.grid.rows * self.grid.columns

    def tile_near(self, place_m: FloatArray) -> Tile:
        """The tile that contains the place (2,) [m], or that is nearest to it along each axis."""
        column, row = (place_m / self.grid.resolution_m).astype(np.intp)
        row, column = np.clip((row, column), 0, (self.grid.rows - 1, self.grid.columns - 1))
        return next(tile for tile in self.tiles if row < tile.rows.stop and column < tile.columns.stop)

    def in_tile_order(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Values (cells, ...) given in the order of ``array.ravel()``, reordered by tile."""
        on_grid = values.reshape(*self.grid.shape, *values.shape[1:])
        ordered = np.empty_like(values)
        for tile in self.tiles:
            ordered[tile.cells] = on_grid[tile.rows, tile.columns].reshape(-1, *values.shape[1:])
        return ordered

    def on_grid(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Values (cells,) given in tile order, as an array [row, column]."""
        array = np.empty(self.grid.shape, dtype=values.dtype)
        for tile in self.tiles:
            array[tile.rows, tile.columns] = values[tile.cells].reshape(tile.shape)
        return array


def _slice_length(of: slice) -> int:
    length: int = of.stop - of.start
    return length


def _even_slices(length: int, edge: int) -> list[slice]:
    """``range(length)`` cut into the fewest slices of at most ``edge``, equal to within one."""
    count = -(-length // edge)
    bounds = [length * i // count for i in range(count + 1)]
    return [slice(first, last) for first, last in pairwise(bounds)]

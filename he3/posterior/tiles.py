"""The grid cut into tiles, and its cells in tile order: a tile's cells follow one another.

What is worked on together should lie together, in memory and on the site: then it stays in cache, and one number can
say for the whole tile how much a far sample matters there. Arrays over cells in tile order are flat, ``(..., cells)``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from he3.frames import SiteGrid

Scalar = TypeVar("Scalar", bound=np.generic)

# Cells at most. A row of V on a tile is then 64 kB, long enough to be read at speed; on tiles of 64 it is not, and on
# tiles of 250 too many rows matter somewhere [measured].
TILE_EDGE = 128


@dataclass(frozen=True, slots=True)
class Tile:
    """A rectangle of the grid: its rows and columns there, its cells in tile order, row by row."""

    number: int
    rows: slice
    columns: slice
    cells: slice

    @property
    def shape(self) -> tuple[int, int]:
        return _length(self.rows), _length(self.columns)

    @property
    def size(self) -> int:
        rows, columns = self.shape
        return rows * columns

    def parts(self, cells: int) -> Iterator[Tile]:
        """The tile cut into whole rows of about that many cells, each a tile with the same number."""
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


Work = Callable[[], None]
ShareOut = Callable[[Iterable[Work]], None]
"""What does all pieces of work: in any order, and on several threads perhaps."""


@dataclass(frozen=True, slots=True)
class TiledGrid:
    """A grid and its tiles, all about the same size, and no edge longer than ``edge`` cells."""

    grid: SiteGrid
    edge: int = TILE_EDGE
    tiles: tuple[Tile, ...] = field(init=False)

    def __post_init__(self) -> None:
        tiles: list[Tile] = []
        for rows in _cut(self.grid.rows, self.edge):
            for columns in _cut(self.grid.columns, self.edge):
                first = tiles[-1].cells.stop if tiles else 0
                count = (rows.stop - rows.start) * (columns.stop - columns.start)
                tiles.append(Tile(len(tiles), rows, columns, slice(first, first + count)))
        object.__setattr__(self, "tiles", tuple(tiles))

    @property
    def cells(self) -> int:
        return self.grid.rows * self.grid.columns

    def in_tile_order(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Values (cells, ...) in the order of ``array.ravel()`` as ones in tile order."""
        on_grid = values.reshape(*self.grid.shape, *values.shape[1:])
        ordered = np.empty_like(values)
        for tile in self.tiles:
            ordered[tile.cells] = on_grid[tile.rows, tile.columns].reshape(-1, *values.shape[1:])
        return ordered

    def on_grid(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Values (cells,) in tile order as ``[row, column]``."""
        array = np.empty(self.grid.shape, dtype=values.dtype)
        for tile in self.tiles:
            array[tile.rows, tile.columns] = values[tile.cells].reshape(tile.shape)
        return array


def _length(of: slice) -> int:
    length: int = of.stop - of.start
    return length


def _cut(length: int, edge: int) -> list[slice]:
    count = -(-length // edge)
    bounds = [length * i // count for i in range(count + 1)]
    return [slice(first, last) for first, last in pairwise(bounds)]

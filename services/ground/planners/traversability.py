"""Open ground: which straight legs the rover may drive, exact to the cell.

A leg is free if every cell that it touches is traversable and no point of it lies outside the region. Cells are closed
squares, enlarged by ``TOUCH`` of a cell: a leg along the edge of a cell touches both neighbours, and one through a
corner touches all four. So a leg never passes between two closed cells that meet at a corner, and the result does not
depend on how the rover rounds its coordinates.

Where cells are much larger than the rover, they are enlarged by its radius, too: a leg keeps that far from closed
cells, and the cells beside them stay open. Where cells are small, those beside closed ones are closed themselves
(``services.ground.terrain``).

The check marches along the leg's longer axis, one cell (a slab) at a time. In each slab it tests the few cells that the
leg crosses, and the chessboard distance to the nearest closed cell tells how many slabs it may skip. The result does
not depend on the leg's direction.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from math import floor

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from he3.errors import InvalidInput, NoRoute
from he3.frames import BoolArray, FloatArray, SiteGrid, as_points

TOUCH = 1e-6
"""Distance within which a leg touches a cell [cells]: a thousand times the rounding of a coordinate."""
_EDGE = 0.5 * TOUCH
"""Distance by which a leg may leave the site [cells]: more than ``ROUNDING_CELLS``, and less than ``TOUCH``."""
MOST_MARGIN = 0.2
"""Greatest distance that legs can keep from closed cells [cells]; a leg then crosses three cells of a slab at most."""

SegmentCheck = Callable[[float, float, float, float], bool]
"""Whether the leg from (ax, ay) to (bx, by) [m] is free."""


class OpenGround:
    """The traversable cells of a site, prepared for fast checks of legs. Immutable.

    margin_m: distance that legs keep from closed cells, at most ``MOST_MARGIN`` cells. Raises InvalidInput for more,
    and for another shape than the grid's.
    """

    def __init__(self, grid: SiteGrid, traversable: BoolArray, margin_m: float = 0.0) -> None:
        if traversable.shape != grid.shape:
            raise InvalidInput(f"open ground: expected traversable of shape {grid.shape}, got {traversable.shape}")
        if not 0.0 <= margin_m <= MOST_MARGIN * grid.resolution_m:
            raise InvalidInput(
                f"open ground: expected a margin of 0 to {MOST_MARGIN:g} cells of {grid.resolution_m:g} m, "
                f"got {margin_m:g} m"
            )
        self.grid = grid
        self.margin_m = margin_m
        self._touch = margin_m / grid.resolution_m + TOUCH
        self.open = np.ascontiguousarray(traversable, dtype=np.bool_)
        padded = np.pad(self.open, 1)
        distance = ndimage.distance_transform_cdt(padded, metric="chessboard")[1:-1, 1:-1]
        self.clearance = np.minimum(distance, 255).astype(np.uint8)
        """(rows, columns): chessboard distance to the nearest closed or outside cell [cells]; 0 for a closed cell."""

    def is_open(self, points_m: FloatArray) -> BoolArray:
        """Whether each of the places (N, 2) [m] lies in the region and in a traversable cell, (N,)."""
        xy = as_points(points_m)
        inside = self.grid.contains(xy)
        answer = np.zeros(len(xy), dtype=np.bool_)
        answer[inside] = self.open[self.grid.cells_of(xy[inside])]
        return answer

    def footing(self, start_m: tuple[float, float]) -> tuple[float, float]:
        """The place [m] from which the legs of a rover at the given place begin: usually that place itself.

        Every leg from the edge of a closed cell touches that cell; such a rover first drives to the centre of the cell
        that it is in. Raises NoRoute if that cell is closed, OutsideRegion if there is none.
        """
        here = np.array([start_m], dtype=np.float64)
        rows, columns = self.grid.cells_of(here)
        if not self.open[rows[0], columns[0]]:
            raise NoRoute(f"the rover stands on ground that it may not cross: ({start_m[0]:g}, {start_m[1]:g}) m")
        if self.segments_free(here, here)[0]:
            return float(start_m[0]), float(start_m[1])
        size = self.grid.resolution_m
        return (float(columns[0]) + 0.5) * size, (float(rows[0]) + 0.5) * size

    def connected_to(self, start_m: tuple[float, float]) -> BoolArray:
        """(rows, columns): the open cells connected to the place [m] over shared edges; all False if it is closed."""
        labels = self._components
        row, column = self.grid.cells_of(np.array([start_m]))
        label = labels[row[0], column[0]]
        connected: BoolArray = (labels == label) if label else np.zeros(self.grid.shape, dtype=np.bool_)
        return connected

    @cached_property
    def _components(self) -> NDArray[np.int32]:
        """(rows, columns): a number above 0 for each set of open cells that are connected over shared edges."""
        labels: NDArray[np.int32] = ndimage.label(self.open)[0]
        return labels

    def segments_free(self, a_m: FloatArray, b_m: FloatArray) -> BoolArray:
        """Whether each leg from a (N, 2) to b (N, 2) [m] is free, (N,)."""
        a, b = as_points(a_m), as_points(b_m)
        if a.shape != b.shape:
            raise InvalidInput(f"expected as many ends as starts of legs, got {a.shape} and {b.shape}")
        p, q = a / self.grid.resolution_m, b / self.grid.resolution_m
        steep = np.abs(q[:, 1] - p[:, 1]) > np.abs(q[:, 0] - p[:, 0])
        # The longer axis comes first: x for flat legs, and y for steep ones.
        p[steep], q[steep] = p[steep][:, ::-1], q[steep][:, ::-1]
        return _march(self.clearance, steep, p, q, self._touch)

    def segment_check(self) -> SegmentCheck:
        """A function that checks one leg, for planners that make tens of thousands of checks per second."""
        return _scalar_check(self.grid, self.clearance.tobytes(), self.clearance.T.tobytes(), self._touch)


def open_ground(grid: SiteGrid, traversable: BoolArray, margin_m: float) -> OpenGround:
    """The open ground of those cells (rows, columns). It is kept: planners and checks ask for the same one each round.

    Raises InvalidInput as ``OpenGround`` does.
    """
    if traversable.shape != grid.shape:
        raise InvalidInput(f"open ground: expected traversable of shape {grid.shape}, got {traversable.shape}")
    return _open_ground(grid, np.ascontiguousarray(traversable, dtype=np.bool_).tobytes(), margin_m)


@lru_cache(maxsize=4)
def _open_ground(grid: SiteGrid, traversable: bytes, margin_m: float) -> OpenGround:
    return OpenGround(grid, np.frombuffer(traversable, dtype=np.bool_).reshape(grid.shape), margin_m)


def _march(clearance: NDArray[np.uint8], steep: BoolArray, p: FloatArray, q: FloatArray, touch: float) -> BoolArray:
    """Whether each leg from p (N, 2) to q (N, 2) [cells], longer axis first, touches only open cells, (N,).

    clearance: (rows, columns). steep: (N,), whether the longer axis is that of the rows. touch: by how much cells are
    enlarged [cells].
    """
    rows, columns = int(clearance.shape[0]), int(clearance.shape[1])
    n, m = np.where(steep, rows, columns), np.where(steep, columns, rows)
    inside: BoolArray = (np.minimum(p, q) >= -_EDGE) & (np.maximum(p, q) <= np.column_stack((n, m)) + _EDGE)
    free = inside[:, 0] & inside[:, 1]
    forward = (p[:, 0] <= q[:, 0])[:, None]
    low, high = np.where(forward, p, q), np.where(forward, q, p)
    x0, x1, y0 = low[:, 0], high[:, 0], low[:, 1]
    extent = x1 - x0
    s = (high[:, 1] - y0) / np.where(extent > 0.0, extent, 1.0)
    i = np.maximum(np.floor(x0 - touch), 0.0).astype(np.intp)
    last = np.minimum(np.floor(x1 + touch), n - 1).astype(np.intp)
    cells = clearance.reshape(-1)
    # Cells between neighbours along the longer axis, and across it.
    along, across = np.where(steep, columns, 1), np.where(steep, 1, columns)
    alive, going = np.arange(len(p)), free & (i <= last)
    while True:
        if not going.all():  # few legs end at any one slab
            alive, i, last, m = alive[going], i[going], last[going], m[going]
            x0, x1, y0, s, along, across = x0[going], x1[going], y0[going], s[going], along[going], across[going]
        if not alive.size:
            return free
        ya = y0 + s * (np.minimum(np.maximum(x0, i - touch), x1) - x0)
        yb = y0 + s * (np.maximum(np.minimum(x1, i + 1 + touch), x0) - x0)
        first = np.maximum(np.floor(np.minimum(ya, yb) - touch), 0.0).astype(np.intp)
        final = np.minimum(np.floor(np.maximum(ya, yb) + touch), m - 1).astype(np.intp)
        at = i * along + first * across
        room = cells[at].astype(np.intp)
        width = final - first
        # A slab of a leg no steeper than one cell a cell crosses at most three enlarged cells.
        blocked = (room == 0) | (cells[at + np.minimum(width, 1) * across] == 0) | (cells[at + width * across] == 0)
        free[alive[blocked]] = False
        i = i + np.maximum(room - width, 1)
        going = ~blocked & (i <= last)


def _scalar_check(grid: SiteGrid, by_row: bytes, by_column: bytes, touch: float) -> SegmentCheck:
    rows, columns, scale, edge = grid.rows, grid.columns, 1.0 / grid.resolution_m, _EDGE

    def free(ax: float, ay: float, bx: float, by: float) -> bool:
        x0, y0, x1, y1 = ax * scale, ay * scale, bx * scale, by * scale
        if abs(y1 - y0) > abs(x1 - x0):
            x0, y0, x1, y1 = y0, x0, y1, x1
            n, m, clearance = rows, columns, by_row
        else:
            n, m, clearance = columns, rows, by_column
        if x0 > x1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        if x0 < -edge or x1 > n + edge or y0 < -edge or y1 < -edge or y0 > m + edge or y1 > m + edge:
            return False
        slope = (y1 - y0) / (x1 - x0) if x1 > x0 else 0.0
        slab, last = max(floor(x0 - touch), 0), min(floor(x1 + touch), n - 1)
        # Tens of thousands of legs a plan: conditions cost less than calls, and int() rounds down from 0 on.
        while slab <= last:
            low = x0 if slab - touch < x0 else slab - touch
            high = slab + 1 + touch if slab + 1 + touch < x1 else x1
            ya = y0 + slope * ((low if low < x1 else x1) - x0)
            yb = y0 + slope * ((high if high > x0 else x0) - x0)
            if ya > yb:
                ya, yb = yb, ya
            first, final = int(ya - touch) if ya > touch else 0, int(yb + touch)
            if final >= m:
                final = m - 1
            at = slab * m + first
            room = clearance[at]
            if not room:
                return False
            if final > first:
                if not clearance[at + 1] or not clearance[at + final - first]:
                    return False
                room -= final - first
            slab += room if room > 1 else 1
        return True

    return free

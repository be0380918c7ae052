"""Ways round obstacles: complete over the cells, then drawn taut.

A search over the open cells (eight neighbours, a diagonal only between two open cells) finds a way wherever there is
one, be it one cell wide, but is up to 8 % longer than it need be, since it knows eight directions only. Drawing it
taut, over checked legs of any direction, takes most of that back.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from he3.errors import NoRoute
from he3.frames import FloatArray, as_points, path_length

if TYPE_CHECKING:
    from services.ground.planners.traversability import OpenGround

SHORTENING_PASSES = 4
SHORTENING_SPACING_CELLS = 4.0
"""Between passes, corners may move along the legs by so many cells."""
SHORTENING_MIN_GAIN = 1e-3
"""A pass that shortens the way by a smaller share than this is the last."""
_NEIGHBOURS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2.0**0.5), (1, -1, 2.0**0.5))  # rows, columns, cells


class RouteFinder:
    """Ways over open ground. Making one costs some tens of milliseconds on 500 x 500 cells, a search about as much."""

    def __init__(self, ground: OpenGround) -> None:
        self.ground = ground
        cells = np.arange(ground.open.size, dtype=np.int32).reshape(ground.open.shape)
        rows, columns = ground.open.shape
        begins, ends, lengths = [], [], []
        for down, right, length in _NEIGHBOURS:
            here = (slice(0, rows - down), slice(max(0, -right), columns - max(0, right)))
            there = (slice(down, rows), slice(max(0, right), columns - max(0, -right)))
            passable = ground.open[here] & ground.open[there]
            if down and right:
                beside = (here[0], there[1]), (there[0], here[1])
                passable &= ground.open[beside[0]] & ground.open[beside[1]]
            begins.append(cells[here][passable])
            ends.append(cells[there][passable])
            lengths.append(np.full(len(begins[-1]), length * ground.grid.resolution_m))
        begin, end, length_m = (np.concatenate(parts) for parts in (begins, ends, lengths))
        both = np.concatenate((begin, end)), np.concatenate((end, begin))
        self._graph = csr_array((np.tile(length_m, 2), both), shape=(cells.size, cells.size))

    def distances_from(self, place_m: tuple[float, float]) -> FloatArray:
        """Length (rows, columns) [m] of the way over cells from the place [m] to each cell's centre; inf without one.

        At most 8 % above the shortest way. Raises NoRoute if the place is not on open ground.
        """
        cell, lead_m = self._cell_of(np.array([place_m]))
        lengths = dijkstra(self._graph, indices=cell[0])
        field: FloatArray = lengths.reshape(self.ground.open.shape) + lead_m[0]
        return field

    def between(self, places_m: FloatArray) -> FloatArray:
        """Lengths (n, n) [m] of the ways over cells between places (n, 2) [m]; inf where there is none.

        At most 8 % (and two half cells) above the shortest. Raises NoRoute if one of them is not on open ground.
        """
        places = as_points(places_m)
        cells, leads_m = self._cell_of(places)
        lengths = np.empty((len(places), len(places)))
        for i, cell in enumerate(cells):
            lengths[i] = dijkstra(self._graph, indices=cell)[cells] + leads_m[i] + leads_m
        np.fill_diagonal(lengths, 0.0)
        return lengths

    def route(self, begin_m: tuple[float, float], end_m: tuple[float, float]) -> FloatArray:
        """A taut free polyline (K, 2) [m] from one place to the other. Raises NoRoute if there is none."""
        ends = np.array([begin_m, end_m], dtype=np.float64)
        cells, _ = self._cell_of(ends)
        if self.ground.segments_free(ends[:1], ends[1:])[0]:
            return ends
        lengths, before = dijkstra(self._graph, indices=cells[1], return_predecessors=True)
        if not np.isfinite(lengths[cells[0]]):
            raise NoRoute(
                f"no traversable way leads from ({begin_m[0]:g}, {begin_m[1]:g}) to ({end_m[0]:g}, {end_m[1]:g}) m"
            )
        chain = [int(cells[0])]
        while chain[-1] != cells[1]:
            chain.append(int(before[chain[-1]]))
        row, column = np.divmod(np.array(chain), self.ground.grid.columns)
        centres = (np.column_stack((column, row)) + 0.5) * self.ground.grid.resolution_m
        return shortened_path(self.ground, np.vstack((ends[0], centres, ends[1])))

    def _cell_of(self, places: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Flat index (n,) of each place's cell, and how far [m] its centre is. Raises NoRoute for one that is not
        open."""
        rows, columns = self.ground.grid.cells_of(places)
        free = self.ground.segments_free(places, places)
        if not free.all():
            x, y = places[int(np.argmin(free))]
            raise NoRoute(f"expected a place on open ground, got ({x:g}, {y:g}) m")
        centres = (np.column_stack((columns, rows)) + 0.5) * self.ground.grid.resolution_m
        return rows * self.ground.grid.columns + columns, np.hypot(*(places - centres).T)


def shortened_path(ground: OpenGround, path_m: FloatArray) -> FloatArray:
    """A free polyline [m] between the same ends as the free polyline (K, 2), no longer, with the slack taken out."""
    best = path = as_points(path_m)
    for attempt in range(SHORTENING_PASSES):
        path = _keep_visible(ground, path)[::-1]  # from either end in turn: greed at one end is undone from the other
        shorter = path_length(path) < path_length(best) * (1.0 - SHORTENING_MIN_GAIN)
        if path_length(path) <= path_length(best):
            best = path if attempt % 2 else path[::-1]
        if not shorter and attempt:
            break
        path = _subdivided(path, SHORTENING_SPACING_CELLS * ground.grid.resolution_m)
    return _keep_visible(ground, best)


def _keep_visible(ground: OpenGround, path: FloatArray) -> FloatArray:
    """The polyline with only those vertices from which the last of the next ones that can be seen is taken."""
    kept, at, last = [0], 0, len(path) - 1
    while at < last:
        ahead = path[at + 1 :]
        seen = ground.segments_free(np.broadcast_to(path[at], ahead.shape), ahead)
        seen[0] = True  # a leg of the polyline itself
        at += 1 + int(np.flatnonzero(seen)[-1])
        kept.append(at)
    return path[kept]


def _subdivided(path: FloatArray, spacing_m: float) -> FloatArray:
    """The same polyline with vertices added, no two further apart than that."""
    parts = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.hypot(*(b - a)) / spacing_m)))
        parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.vstack(parts)

"""Paths around obstacles: a complete search over the cells, then shortened.

The search over the open cells (eight neighbours, a diagonal only between two open cells) finds a path wherever there is
one, even one cell wide. With eight directions only, it is up to 8 % longer than the shortest path. Shortening it over
free legs of any direction removes most of that.
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

SHORTENING_PASSES = 4  # 1, at most
SHORTENING_SPACING_CELLS = 4.0  # cells between the vertices that are inserted into legs before a further pass
SHORTENING_MIN_GAIN = 1e-3  # 1, share of the path; a pass that shortens it by less is the last
_NEIGHBOURS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2.0**0.5), (1, -1, 2.0**0.5))  # rows, columns, cells


class RouteFinder:
    """Paths over open ground. On 500 x 500 cells, making the graph and each search take some tens of milliseconds."""

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
        """Length (rows, columns) [m] of the path over cells from the place [m] to each cell's centre; inf without one.

        At most 8 % above the shortest path. Raises NoRoute if the place is not on open ground.
        """
        cell, lead_m = self._cell_of(np.array([place_m]))
        lengths = dijkstra(self._graph, indices=cell[0])
        field: FloatArray = lengths.reshape(self.ground.open.shape) + lead_m[0]
        return field

    def route(self, begin_m: tuple[float, float], end_m: tuple[float, float]) -> FloatArray:
        """A free, shortened polyline (K, 2) [m] from one place to the other. Raises NoRoute if there is none."""
        found = self._routes(end_m, np.array([begin_m], dtype=np.float64))[0]
        if found is None:
            raise _no_route(begin_m, end_m)
        return found[::-1]

    def routes(self, begin_m: tuple[float, float], ends_m: FloatArray) -> list[FloatArray]:
        """A free, shortened polyline (K, 2) [m] from a place to each of others (n, 2) [m], by one search.

        Raises NoRoute if there is none to one of them.
        """
        found = []
        for end, route in zip(as_points(ends_m).tolist(), self._routes(begin_m, ends_m), strict=True):
            if route is None:
                raise _no_route(begin_m, (end[0], end[1]))
            found.append(route)
        return found

    def _routes(self, begin_m: tuple[float, float], ends_m: FloatArray) -> list[FloatArray | None]:
        begin, ends = np.array([begin_m], dtype=np.float64), as_points(ends_m)
        cells, _ = self._cell_of(np.vstack((begin, ends)))
        straight = self.ground.segments_free(np.repeat(begin, len(ends), axis=0), ends)
        if straight.all():
            return [np.vstack((begin, end)) for end in ends]
        lengths, before = dijkstra(self._graph, indices=cells[0], return_predecessors=True)
        found: list[FloatArray | None] = []
        for end, cell, is_straight in zip(ends, cells[1:].tolist(), straight, strict=True):
            if not np.isfinite(lengths[cell]):
                found.append(None)
                continue
            chain = [cell]
            while chain[-1] != cells[0]:
                chain.append(int(before[chain[-1]]))
            row, column = np.divmod(np.array(chain), self.ground.grid.columns)
            centres = (np.column_stack((column, row)) + 0.5) * self.ground.grid.resolution_m
            way = np.vstack((begin, end)) if is_straight else np.vstack((end, centres, begin))
            found.append(way if is_straight else shortened_path(self.ground, way)[::-1])
        return found

    def _cell_of(self, places: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Flat index (n,) of each place's cell, and its distance (n,) [m] from that cell's centre.

        Raises NoRoute for a place that is not on open ground.
        """
        rows, columns = self.ground.grid.cells_of(places)
        free = self.ground.segments_free(places, places)
        if not free.all():
            x, y = places[int(np.argmin(free))]
            raise NoRoute(f"expected a place on open ground, got ({x:g}, {y:g}) m")
        centres = (np.column_stack((columns, rows)) + 0.5) * self.ground.grid.resolution_m
        return rows * self.ground.grid.columns + columns, np.hypot(*(places - centres).T)


def _no_route(begin_m: tuple[float, float], end_m: tuple[float, float]) -> NoRoute:
    return NoRoute(f"no traversable path leads from ({begin_m[0]:g}, {begin_m[1]:g}) to ({end_m[0]:g}, {end_m[1]:g}) m")


def shortened_path(ground: OpenGround, path_m: FloatArray) -> FloatArray:
    """A free polyline [m] with the ends of the free polyline (K, 2) [m], shortened over free legs; never longer."""
    best = path = as_points(path_m)
    for attempt in range(SHORTENING_PASSES):
        path = _keep_visible(ground, path)[
            ::-1
        ]  # from each end in turn: what is greedy from one end is not from the other
        shorter = path_length(path) < path_length(best) * (1.0 - SHORTENING_MIN_GAIN)
        if path_length(path) <= path_length(best):
            best = path if attempt % 2 else path[::-1]
        if not shorter and attempt:
            break
        path = subdivided(path, SHORTENING_SPACING_CELLS * ground.grid.resolution_m)
    return _keep_visible(ground, best)


def _keep_visible(ground: OpenGround, path: FloatArray) -> FloatArray:
    """The polyline without the vertices that a free leg skips: from each kept vertex to the last visible one."""
    kept, at, last = [0], 0, len(path) - 1
    while at < last:
        ahead = path[at + 1 :]
        seen = ground.segments_free(np.broadcast_to(path[at], ahead.shape), ahead)
        seen[0] = True  # the polyline's own leg
        at += 1 + int(np.flatnonzero(seen)[-1])
        kept.append(at)
    return path[kept]


def subdivided(path: FloatArray, spacing_m: float) -> FloatArray:
    """The same polyline with vertices inserted, so that none are farther apart than ``spacing_m``."""
    parts = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.hypot(*(b - a)) / spacing_m)))
        parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.vstack(parts)

"""The cheapest way between two places over terrain: never costlier than the line given, and over no steeper cell.

A path of cost C is no longer than C, so all ways that are as cheap as the given one lie in the ellipse of that length
around both ends. In it three searches follow each other, and the cheapest of all ways is taken: the given line; the
cheapest path over a lattice of cells (Dijkstra, sixteen directions), with every detour of it left out that a straight
leg makes unnecessary; and OMPL's informed RRT*, whose tree begins with the best way found so far.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from he3.frames import FloatArray, path_length
from services.ground.planners.polyline import arc_lengths
from services.ground.planners.traversability import OpenGround
from services.ground.planners.trees import cheaper_path

if TYPE_CHECKING:
    from he3.driving_cost import TerrainCost
    from he3.frames import IntArray

TREE_ITERATIONS: Final = 200
"""Iterations of RRT* for each leg, beside those that take in the way found so far."""
LEAST_SAVING: Final = 1e-3
"""Share of the cost above that of a level straight leg below which nothing is searched."""
LATTICE_NODES: Final = 40
"""Lattice nodes along the longer side of the ellipse, at most."""
KNOTS: Final = 40
"""Vertices of a way between which straight legs are tried."""
_DIRECTIONS: Final = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
"""Rows and columns from a lattice node to half of its sixteen neighbours."""
_JOIN_NODES: Final = 2.3
"""Distance of the lattice nodes that the ends are joined to, in lattice spacings."""


def cheapest_ways(
    ground: OpenGround, cost: TerrainCost, path_m: FloatArray, stops_m: FloatArray, seed: int
) -> FloatArray:
    """The polyline (K, 2) [m] through the same stops (k,), given as distances along the path [m], each leg cheapest.

    The path (K, 2) [m] is free; what follows its last stop stays as it is.
    """
    pieces = cut(path_m, stops_m)
    ways = [
        piece if number == len(stops_m) else cheapest_way(ground, cost, piece, seed + number)
        for number, piece in enumerate(pieces)
    ]
    return np.vstack([ways[0], *(way[1:] for way in ways[1:])])


def cut(path_m: FloatArray, at_m: FloatArray) -> list[FloatArray]:
    """The pieces (K, 2) [m] of a polyline between its start, distances (k,) along it, ascending [m], and its end."""
    along = arc_lengths(path_m)
    at = np.minimum(at_m, along[-1])
    places = np.column_stack([np.interp(at, along, path_m[:, axis]) for axis in (0, 1)])
    pieces, begin_m, begin = [], 0.0, path_m[0]
    for end_m, end in zip(at, places, strict=True):
        within = path_m[(along > begin_m) & (along < end_m)]
        pieces.append(np.vstack((begin, within, end)))
        begin_m, begin = float(end_m), end
    rest = path_m[along > begin_m]
    return [*pieces, np.vstack((begin, rest))] if len(rest) else pieces


def cheapest_way(
    ground: OpenGround, cost: TerrainCost, given_m: FloatArray, seed: int, iterations: int = TREE_ITERATIONS
) -> FloatArray:
    """A free polyline (K, 2) [m] between the ends of the free one given; never costlier or steeper than that one."""
    ends = given_m[[0, -1]]
    distance, limit = path_length(ends), cost.of_legs(given_m[:-1], given_m[1:]).sum()
    if not distance > 0.0 or limit <= distance * (1.0 + LEAST_SAVING):
        return given_m
    search = _search(ground, cost, given_m, float(limit))
    best = search.given_m
    for found in (search.over_lattice(), None):
        if found is None and iterations > 0:
            found = cheaper_path(search.ground, search.cost, best, iterations=iterations, seed=seed)
        if found is not None:
            found = search.straightened(found)
            best = min((best, found), key=search.cost_of)
    best = best + search.corner_m
    best[[0, -1]] = ends
    free = bool(ground.segments_free(best[:-1], best[1:]).all())
    return best if free and cost.of_path(best) < cost.of_path(given_m) else given_m


@dataclass(frozen=True, slots=True)
class _Search:
    """The ground within the ellipse, in a frame of its own."""

    ground: OpenGround
    cost: TerrainCost
    given_m: FloatArray
    limit: float
    """Symmetric cost of the given line [level m]."""
    corner_m: FloatArray
    """Origin of the frame (2,) [m]."""

    def cost_of(self, path_m: FloatArray) -> float:
        """Symmetric cost of the polyline (K, 2) [level m]."""
        return float(self.cost.of_legs(path_m[:-1], path_m[1:]).sum())

    def over_lattice(self) -> FloatArray | None:
        """The cheapest polyline (K, 2) [m] over lattice nodes; None if none is free."""
        ground, cell_m = self.ground, self.ground.grid.resolution_m
        stride = max(1, ceil(max(ground.grid.shape) / LATTICE_NODES))
        numbers = np.full(tuple(ceil(cells / stride) for cells in ground.grid.shape), -1, dtype=np.intp)
        lattice = np.argwhere(numbers < 0)
        places: FloatArray = (lattice[:, ::-1].astype(np.float64) * stride + 0.5) * cell_m
        begin, end = self.given_m[0], self.given_m[-1]
        reach = np.hypot(*(places - begin).T) + np.hypot(*(places - end).T)
        inside = (reach <= self.limit) & ground.is_open(places)
        lattice, places = lattice[inside], places[inside]
        if not len(places):
            return None
        numbers[lattice[:, 0], lattice[:, 1]] = np.arange(len(places))
        nodes = np.vstack((places, begin, end))
        first, second = self._edges(numbers, nodes, stride * cell_m)
        free = ground.segments_free(nodes[first], nodes[second])
        first, second = first[free], second[free]
        graph = csr_array(
            (self.cost.of_legs(nodes[first], nodes[second]), (first, second)), shape=(len(nodes), len(nodes))
        )
        costs, before = dijkstra(graph, directed=False, indices=len(nodes) - 2, return_predecessors=True)
        if not np.isfinite(costs[-1]):
            return None
        chain = [len(nodes) - 1]
        while chain[-1] != len(nodes) - 2:
            chain.append(int(before[chain[-1]]))
        return nodes[chain[::-1]]

    @staticmethod
    def _edges(numbers: IntArray, nodes: FloatArray, spacing_m: float) -> tuple[IntArray, IntArray]:
        """Pairs of nodes that may be joined: lattice neighbours, and each end with the lattice nodes around it."""
        rows, columns = numbers.shape
        firsts, seconds = [], []
        for up, right in _DIRECTIONS:
            here = numbers[: max(rows - up, 0), max(0, -right) : columns - max(0, right)]
            there = numbers[up:, max(0, right) : columns - max(0, -right)]
            both = (here >= 0) & (there >= 0)
            firsts.append(here[both])
            seconds.append(there[both])
        for end in (len(nodes) - 2, len(nodes) - 1):
            near = np.flatnonzero(np.hypot(*(nodes[:-2] - nodes[end]).T) <= _JOIN_NODES * spacing_m)
            firsts.append(np.full(len(near), end))
            seconds.append(near)
        return np.concatenate(firsts), np.concatenate(seconds)

    def straightened(self, path_m: FloatArray) -> FloatArray:
        """The cheapest polyline through some of the vertices (K, 2) [m], its ends among them, over free legs."""
        if len(path_m) > KNOTS:
            path_m = path_m[np.unique(np.linspace(0, len(path_m) - 1, KNOTS).round().astype(int))]
        first, second = np.triu_indices(len(path_m), 1)
        costs = np.full((len(path_m), len(path_m)), np.inf)
        free = self.ground.segments_free(path_m[first], path_m[second])
        costs[first[free], second[free]] = self.cost.of_legs(path_m[first[free]], path_m[second[free]])
        best, before = np.full(len(path_m), np.inf), np.zeros(len(path_m), dtype=np.intp)
        best[0] = 0.0
        for vertex in range(1, len(path_m)):
            through = best[:vertex] + costs[:vertex, vertex]
            before[vertex] = int(np.argmin(through))
            best[vertex] = through[before[vertex]]
        if not np.isfinite(best[-1]):
            return self.given_m
        chain = [len(path_m) - 1]
        while chain[-1]:
            chain.append(int(before[chain[-1]]))
        return path_m[chain[::-1]]


def _search(ground: OpenGround, cost: TerrainCost, given_m: FloatArray, limit: float) -> _Search:
    """The search in the box around the ellipse, without the cells that are steeper than the given line."""
    grid, size = ground.grid, ground.grid.resolution_m
    begin, end = given_m[0], given_m[-1]
    squared = float(((end - begin) ** 2).sum())
    # The half-axes of the box around an ellipse with these foci and that sum of distances.
    half = 0.5 * np.sqrt((end - begin) ** 2 + max(limit**2 - squared, 0.0)) + size
    middle = 0.5 * (begin + end)
    low = np.maximum(np.floor((middle - half) / size), 0).astype(int)
    high = np.minimum(np.ceil((middle + half) / size), (grid.columns, grid.rows)).astype(int)
    rows, columns = slice(low[1], high[1]), slice(low[0], high[0])
    inner = cost.window(rows, columns)
    open_cells = ground.open[rows, columns] & (inner.slope_deg <= cost.steepest_deg(given_m))
    corner = low * size
    inner_ground = OpenGround(inner.grid, open_cells, ground.margin_m)
    return _Search(inner_ground, inner, given_m - corner, limit, corner.astype(np.float64))

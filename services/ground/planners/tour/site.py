"""The site of a tour: reachable cells, the nearest reachable cell of each, lengths of legs, and the area."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from he3.errors import NoRoute
from he3.frames import path_length
from services.ground.planners.routes import RouteFinder
from services.ground.planners.tour.legs import LegTable, consecutive_lengths, leg_table
from services.ground.planners.traversability import OpenGround

if TYPE_CHECKING:
    from he3.driving_cost import TerrainCost
    from he3.frames import FloatArray, SiteGrid
    from he3.i_optimal_design import FieldNodes

LANDMARKS = 3
"""Places from which the distances to all cells are computed, as bounds on legs that walls make long."""


@dataclass(frozen=True, slots=True)
class Site:
    """The ground of a design, and the start of its tour."""

    ground: OpenGround
    nodes: FieldNodes
    start_m: FloatArray
    """(2,) [m], a place from which legs begin: see ``OpenGround.footing``."""
    nearest_reachable: NDArray[np.int32]
    """(2, rows, columns): row and column of the reachable cell nearest to each cell."""
    component: int
    """Label of the connected component that the rover is in."""
    cost: TerrainCost | None = None
    """What legs cost; None: their length."""

    def snap_to_reachable(self, places_m: FloatArray) -> FloatArray:
        """The places (n, 2) [m], each unreachable one replaced by the centre of the nearest reachable cell."""
        grid = self.ground.grid
        size = grid.resolution_m
        columns = np.clip((places_m[:, 0] / size).astype(np.intp), 0, grid.columns - 1)
        rows = np.clip((places_m[:, 1] / size).astype(np.intp), 0, grid.rows - 1)
        to_row, to_column = self.nearest_reachable[0, rows, columns], self.nearest_reachable[1, rows, columns]
        stays = (to_row == rows) & (to_column == columns) & grid.contains(places_m)
        if self.ground.margin_m:
            stays[stays] = self.ground.segments_free(places_m[stays], places_m[stays])
        centres = (np.column_stack((to_column, to_row)) + 0.5) * size
        return np.where(stays[:, None], places_m, centres)

    def snap_to_cell_centres(self, places_m: FloatArray) -> FloatArray:
        """Snapped places (n, 2) [m], each at the centre of its cell, away from the edges of other cells."""
        rows, columns = self.ground.grid.cells_of(self.snap_to_reachable(places_m))
        cells = np.column_stack((columns, rows)).astype(np.float64)
        centres: FloatArray = (cells + 0.5) * self.ground.grid.resolution_m
        return centres

    def legs(self, places_m: FloatArray) -> LegTable:
        """The legs between places (n, 2) [m], all reachable."""
        return leg_table(self.ground, places_m, self._length_bounds, self.cost)

    def leg_lengths(self, stops_m: FloatArray) -> FloatArray:
        """Lengths (n - 1,) of the legs from each reachable stop (n, 2) [m] to the next, as ``legs`` has them."""
        return consecutive_lengths(self.ground, stops_m, self._length_bounds, self.cost)

    def way_cost(self, path_m: FloatArray) -> float:
        """Length of the polyline (K, 2) [m], or its symmetric cost [level m]."""
        if self.cost is None:
            return path_length(path_m)
        return float(self.cost.of_legs(path_m[:-1], path_m[1:]).sum())

    def _length_bounds(self, places_m: FloatArray) -> FloatArray:
        """Lower bounds (n, n) [m] on path lengths: differences of the places' distances from the landmarks."""
        grid = self.ground.grid
        rows, columns = grid.cells_of(places_m)
        fields = _landmark_distances(grid, self.ground.open.tobytes(), self.ground.margin_m, self.component)
        at = np.stack([field[rows, columns] for field in fields])
        bounds: FloatArray = np.abs(at[:, :, None] - at[:, None, :]).max(axis=0)
        return bounds

    @property
    def area_m2(self) -> float:
        """Area that is reachable and of interest [m^2]; less interest counts as less area."""
        grid = self.ground.grid
        rows, columns = np.arange(grid.rows)[:, None], np.arange(grid.columns)[None, :]
        reachable = float(
            np.count_nonzero((self.nearest_reachable[0] == rows) & (self.nearest_reachable[1] == columns))
        )
        # The effective number of cells of unequal weights: (sum w)^2 / sum w^2.
        weights = self.nodes.weights
        of_interest = float(weights.sum() ** 2 / (weights * weights).sum()) * self.nodes.spacing_m**2
        return min(reachable * grid.resolution_m**2, of_interest)


def reachable_site(
    grid: SiteGrid,
    traversable: NDArray[np.bool_],
    margin_m: float,
    start_m: tuple[float, float],
    nodes: FieldNodes,
    cost: TerrainCost | None = None,
) -> Site:
    """The site reachable from the start [m]. Raises NoRoute if the rover is walled in or on closed ground.

    margin_m: distance that legs keep from closed cells.
    """
    cells = traversable.astype(np.bool_).tobytes()
    ground, labels = _connected_components(grid, cells, margin_m)
    start = np.array(ground.footing(start_m))
    row, column = grid.cells_of(start[None])
    component = int(labels[row[0], column[0]])
    return Site(ground, nodes, start, _nearest_reachable(grid, cells, margin_m, component), component, cost)


@lru_cache(maxsize=4)
def _connected_components(grid: SiteGrid, traversable: bytes, margin_m: float) -> tuple[OpenGround, NDArray[np.int32]]:
    """Open ground, and the component label (rows, columns) of each open cell. Cached."""
    ground = OpenGround(grid, np.frombuffer(traversable, dtype=np.bool_).reshape(grid.shape), margin_m)
    return ground, ndimage.label(ground.open)[0]


@lru_cache(maxsize=4)
def _nearest_reachable(grid: SiteGrid, traversable: bytes, margin_m: float, component: int) -> NDArray[np.int32]:
    """Row and column (2, rows, columns) of the component's cell nearest to each cell. Cached.

    Raises NoRoute if the component is a single cell, in which a rover is walled in.
    """
    _, labels = _connected_components(grid, traversable, margin_m)
    within = labels == component
    if np.count_nonzero(within) < 2:
        row, column = np.argwhere(within)[0]
        x, y = (column + 0.5) * grid.resolution_m, (row + 0.5) * grid.resolution_m
        raise NoRoute(f"walled in at ({x:g}, {y:g}) m: no other cell is reachable from there")
    return np.asarray(ndimage.distance_transform_edt(~within, return_distances=False, return_indices=True))


@lru_cache(maxsize=2)
def _landmark_distances(grid: SiteGrid, traversable: bytes, margin_m: float, component: int) -> tuple[FloatArray, ...]:
    """Lengths (rows, columns) [m] of the paths from each landmark to each cell of the component. Cached.

    Landmarks are ends of the longest paths. The lengths bound those between all pairs of places (Goldberg & Harrelson
    2005); along a corridor the bound is exact but for the eight directions of the paths.
    """
    ground, labels = _connected_components(grid, traversable, margin_m)
    within = labels == component
    routes = RouteFinder(ground)
    row, column = np.argwhere(within)[0]
    nearest = np.full(grid.shape, np.inf)
    fields = []
    for _ in range(LANDMARKS + 1):
        field = routes.distances_from(((column + 0.5) * grid.resolution_m, (row + 0.5) * grid.resolution_m))
        fields.append(np.where(within, field, 0.0))
        # The first field, from an arbitrary cell, only serves to find the landmarks.
        nearest = np.minimum(nearest, fields[-1]) if len(fields) > 1 else fields[-1]
        row, column = np.unravel_index(int(np.argmax(np.where(within, nearest, -1.0))), grid.shape)
        if len(fields) == 1:
            nearest = np.full(grid.shape, np.inf)
    return tuple(fields[1:])

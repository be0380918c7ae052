"""The shortest path between two places of a tour, searched in a window around them first, then everywhere."""

from __future__ import annotations

import numpy as np

from he3.errors import NoRoute
from he3.frames import FloatArray, SiteGrid
from services.ground.planners.routes import RouteFinder
from services.ground.planners.traversability import OpenGround

WINDOW_MARGINS = (0.75, 3.0)
"""Margins of the windows around two places, in multiples of their distance, before the whole site is searched."""
MIN_WINDOW_MARGIN_CELLS = 20.0


def shortest_path(ground: OpenGround, begin_m: FloatArray, end_m: FloatArray) -> FloatArray:
    """A free, shortened polyline (K, 2) [m] from one place (2,) [m] to the other. Raises NoRoute if there is none.

    A path found in a window is accepted if every path that leaves the window is longer; otherwise the search is
    repeated in the next window.
    """
    distance = float(np.hypot(*(end_m - begin_m)))
    ends = np.array([begin_m, end_m])
    for share in WINDOW_MARGINS:
        margin_m = max(share * distance, MIN_WINDOW_MARGIN_CELLS * ground.grid.resolution_m)
        try:
            path = _path_in_window(ground, ends, margin_m)
        except NoRoute:
            continue
        if float(np.hypot(*np.diff(path, axis=0).T).sum()) <= distance + 2.0 * margin_m:
            return path
    return RouteFinder(ground).route((begin_m[0], begin_m[1]), (end_m[0], end_m[1]))


def _path_in_window(ground: OpenGround, ends_m: FloatArray, margin_m: float) -> FloatArray:
    """The polyline (K, 2) [m] between two ends (2, 2) [m] within a margin around them. Raises NoRoute."""
    grid, size = ground.grid, ground.grid.resolution_m
    low = np.maximum(np.floor((ends_m.min(axis=0) - margin_m) / size), 0).astype(int)
    high = np.minimum(np.ceil((ends_m.max(axis=0) + margin_m) / size), (grid.columns, grid.rows)).astype(int)
    window = ground.open[low[1] : high[1], low[0] : high[0]]
    corner = low * size
    begin, end = ends_m - corner
    inner = OpenGround(SiteGrid(window.shape[0], window.shape[1], size), window, ground.margin_m)
    path = RouteFinder(inner).route((begin[0], begin[1]), (end[0], end[1]))
    path += corner
    path[[0, -1]] = ends_m
    return path

"""Places that cover a rectangle without any model of the field: lawn-mower rows, a hexagonal lattice, chance."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from he3.frames import BoolArray, FloatArray, SiteGrid
from he3.tsp import short_tour


def boustrophedon(samples: int, width_m: float, height_m: float) -> FloatArray:
    """Places (samples, 2) [m] in rows from south to north, driven eastward and westward by turns."""
    return _rows(samples, width_m, height_m, max(1, round(math.sqrt(samples * height_m / width_m))), 0.0)


def hexagonal(samples: int, width_m: float, height_m: float) -> FloatArray:
    """The same with the rows shifted by half a spacing by turns, and as far apart as in a lattice of triangles."""
    count = max(1, round(math.sqrt(samples * height_m / (width_m * math.sqrt(0.75)))))
    return _rows(samples, width_m, height_m, count, 0.25)


def _rows(samples: int, width_m: float, height_m: float, count: int, shift: float) -> FloatArray:
    count = min(count, samples)
    places = []
    for row in range(count):
        members = samples * (row + 1) // count - samples * row // count
        along = (np.arange(members) + 0.5 + shift * (-1) ** row) / members * width_m
        places.append(np.column_stack((along[:: (-1) ** row], np.full(members, (row + 0.5) / count * height_m))))
    return np.vstack(places)


def at_random(
    samples: int, grid: SiteGrid, open_cells: BoolArray, start_m: tuple[float, float], seed: int
) -> FloatArray:
    """Places (samples, 2) [m], each anywhere on open ground with equal probability, in the order of a short tour."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x7A4D]))
    rows, columns = np.nonzero(open_cells)
    chosen = rng.integers(len(rows), size=samples)
    places = (np.column_stack((columns, rows))[chosen] + rng.uniform(size=(samples, 2))) * grid.resolution_m
    stops = np.vstack((start_m, places))
    order = short_tour(np.hypot(*(stops[:, None] - stops[None]).transpose(2, 0, 1)))
    return stops[order[1:]]


def moved_onto(places_m: FloatArray, grid: SiteGrid, open_cells: BoolArray) -> FloatArray:
    """The centres (n, 2) [m] of the open cells in which the places (n, 2) [m] lie, or of those nearest to them.

    At the edge of a cell a leg would touch its neighbour, which may be closed.
    """
    inside = np.clip(places_m, 0.0, np.nextafter([grid.width_m, grid.height_m], 0.0))
    rows, columns = grid.cells_of(inside)
    places = (np.column_stack((columns, rows)) + 0.5) * grid.resolution_m
    closed = ~open_cells[rows, columns]
    if closed.any():
        centres = (np.argwhere(open_cells)[:, ::-1] + 0.5) * grid.resolution_m
        places[closed] = centres[cKDTree(centres).query(inside[closed])[1]]
    return places

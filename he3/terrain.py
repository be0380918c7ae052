"""Terrain: slope, relief, and where a rover may drive.

The rule for traversability is the paper's. Arrays are [row, column] = [y, x], row 0 in the south.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from he3 import constants
from he3.errors import InvalidInput

if TYPE_CHECKING:
    from he3.frames import BoolArray, FloatArray, SiteGrid

_SQUARE = np.ones((3, 3), dtype=np.bool_)


def slope_deg(elevation_m: FloatArray, resolution_m: float) -> FloatArray:
    """Steepest slope [deg] at each cell of an elevation (rows, columns) [m], by central differences."""
    _expect_map("elevation", elevation_m, least=2)
    north, east = np.gradient(elevation_m, resolution_m)
    slope: FloatArray = np.degrees(np.arctan(np.hypot(north, east)))
    return slope


def hillshade(
    elevation_m: FloatArray, resolution_m: float, azimuth_deg: float = 315.0, altitude_deg: float = 45.0
) -> FloatArray:
    """Brightness (rows, columns), 0 to 1, of that elevation [m] under parallel light: the cosine of its angle to the
    normal of the ground, 0 on the far side.

    azimuth_deg: where the light comes from, clockwise from north; altitude_deg: above the horizon.
    """
    _expect_map("elevation", elevation_m, least=2)
    north, east = np.gradient(elevation_m, resolution_m)
    azimuth, altitude = np.radians(azimuth_deg), np.radians(altitude_deg)
    towards = np.sin(altitude) - np.cos(altitude) * (np.sin(azimuth) * east + np.cos(azimuth) * north)
    shade: FloatArray = np.clip(towards / np.sqrt(1.0 + north**2 + east**2), 0.0, 1.0)
    return shade


def relief_m(elevation_m: FloatArray, resolution_m: float, window_m: float = constants.RELIEF_WINDOW_M) -> FloatArray:
    """Height [m] of each cell above the mean of the square window around it, (rows, columns).

    window_m: side of the window [m]. Beyond the array's edge the ground is continued point-symmetrically, so that a
    plane has no relief anywhere. Where the ground beyond the edge is known, pass a margin of half a window and cut it
    off afterwards. Raises InvalidInput for a window smaller than two cells.
    """
    _expect_map("elevation", elevation_m, least=2)
    half = round(window_m / resolution_m / 2)
    if half < 1:
        raise InvalidInput(f"expected a relief window of at least two cells of {resolution_m} m, got {window_m} m")
    padded = elevation_m
    remaining = half
    while remaining > 0:  # an odd reflection reaches no further than the array's width
        pad = min(remaining, min(padded.shape) - 1)
        padded = np.pad(padded, pad, mode="reflect", reflect_type="odd")
        remaining -= pad
    mean = ndimage.uniform_filter(padded - padded.mean(), size=2 * half + 1, mode="nearest") + padded.mean()
    inner = (slice(half, half + elevation_m.shape[0]), slice(half, half + elevation_m.shape[1]))
    relief: FloatArray = elevation_m - mean[inner]
    return relief


def traversable(
    slope: FloatArray, relief: FloatArray, slope_limit_deg: float = constants.ROVER_SLOPE_NOMINAL_DEG
) -> BoolArray:
    """Whether a rover may enter each cell, (rows, columns), by slope [deg] and relief [m] of the same shape.

    Obstacles are slopes over the limit, hollows deeper than 1.5 standard deviations of relief, and hummocks higher than
    that if each covers less than 5 % of the region (a larger rise is landscape). A 3 x 3 morphological closing fills
    gaps and cracks between obstacles.
    """
    _expect_map("slope", slope)
    if slope.shape != relief.shape:
        raise InvalidInput(f"expected slope and relief of one shape, got {slope.shape} and {relief.shape}")
    threshold = max(constants.RELIEF_SIGMAS * float(relief.std()), constants.RELIEF_FLOOR_M)
    obstacles = (slope > slope_limit_deg) | (relief < -threshold) | _small_patches(relief > threshold)
    framed = np.pad(
        obstacles, 2, mode="edge"
    )  # without the frame, the closing would open obstacles at the region's edge
    closed: BoolArray = ndimage.binary_closing(framed, structure=_SQUARE)[2:-2, 2:-2]
    return ~closed


def reachable(open_cells: BoolArray, grid: SiteGrid, start_m: tuple[float, float]) -> BoolArray:
    """The open cells, (rows, columns), that are connected to a place [m] over shared cell edges.

    No cell is set if the place itself is closed. Raises OutsideRegion if the region does not contain it.
    """
    rows, columns = grid.cells_of(np.array([start_m], dtype=np.float64))
    labels, _ = ndimage.label(open_cells)
    label = labels[rows[0], columns[0]]
    if label == 0:
        return np.zeros_like(open_cells)
    connected: BoolArray = labels == label
    return connected


def _small_patches(mask: BoolArray) -> BoolArray:
    """The mask without its patches that cover 5 % of the region or more."""
    labels, count = ndimage.label(mask, structure=_SQUARE)
    cells = np.bincount(labels.ravel(), minlength=count + 1)
    small = cells < constants.HUMMOCK_MAX_FRACTION * mask.size
    small[0] = False
    kept: BoolArray = small[labels]
    return kept


def _expect_map(name: str, values: FloatArray, least: int = 1) -> None:
    if values.ndim != 2 or min(values.shape) < least:
        raise InvalidInput(f"expected {name} (rows, columns) of at least {least} x {least}, got {values.shape}")
    if not bool(np.isfinite(values).all()):
        raise InvalidInput(f"expected finite {name}, got NaN or infinity")

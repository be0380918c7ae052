"""Samples a raster at the site's cells: read the window, average where cells are larger than pixels, then bicubic.

Nothing beyond the raster's edge or inside its holes is invented: a cell without all of its 4 x 4 pixels is refused,
unless the recipe asks for holes to be filled, which are then marked.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import ndimage

from he3.errors import InvalidInput
from he3.frames import BoolArray, FloatArray, IntArray
from he3.nodata import cells_where
from he3.terrain import slope_deg
from services.mission.region_build.geo import rasterio
from services.mission.region_build.projection import SitePlane, transformer
from services.mission.region_build.sources import MAX_WINDOW_PIXELS, Source

_PADDING: Final = 12  # pixels around; a cubic spline's coefficients depend on those farther off by 0.27^12 = 1e-7
_PADDING_BLOCKS: Final = 6  # of averaged pixels, where cells are larger than pixels: 0.27^6 = 4e-4
_SIDE: Final = math.isqrt(MAX_WINDOW_PIXELS)  # pixels, side of a window up to which it is padded with blocks
_SUPPORT: Final = 2  # pixels around that bicubic interpolation needs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sampled:
    """A layer on the site's cells, row 0 south, with facts about its sampling."""

    values: FloatArray
    filled: BoolArray
    """Cells that rest on holes, which are filled."""
    source_slope_deg: FloatArray | None
    """For elevation: the slope [deg] of the raster itself in the pixels that each cell touches."""
    pixel_m: float
    """Size of a pixel on the ground [m], northward."""
    window: str
    sha256: str


def sample(source: Source, plane: SitePlane, margin: int = 0, *, slopes: bool = False) -> Sampled:
    """The raster at the centres of the cells and ``margin`` cells around them.

    Raises InvalidInput if the raster does not surround them, or has holes there that are not to be filled.
    """
    rows, columns, (row, column, height, width) = needed(source, plane, margin)
    values = source.read(row, column, height, width)
    where = f"rows {row} to {row + height - 1}, columns {column} to {column + width - 1}"
    checksum = source.sha256 or hashlib.sha256(values.astype("<f8").tobytes()).hexdigest()
    # From here on, rows and columns are of the window, counted from its first pixel's centre.
    rows, columns = rows - row - 0.5, columns - column - 0.5
    step = _pixels_a_cell(rows, columns)
    pixel_m = plane.grid.resolution_m / step[0], plane.grid.resolution_m / step[1]
    steep = source_slopes(values, pixel_m, rows, columns) if slopes else None
    factors = _pixels_a_block(step)
    values = _averaged(values, factors)
    rows, columns = (rows + 0.5) / factors[0] - 0.5, (columns + 0.5) / factors[1] - 0.5
    missing = np.isnan(values)
    touched = ndimage.binary_dilation(missing, np.ones((4, 4), dtype=np.bool_), origin=(-1, -1))
    near = np.clip(np.floor(rows).astype(np.intp), 0, None), np.clip(np.floor(columns).astype(np.intp), 0, None)
    holes: BoolArray = touched[np.minimum(near[0], touched.shape[0] - 1), np.minimum(near[1], touched.shape[1] - 1)]
    if holes.any() and not (source.table.fill_holes or source.table.mask_holes):
        raise InvalidInput(
            f"{source.name}: layer {source.layer}: expected values everywhere in the site, got missing ones below "
            f"{cells_where(holes)}; fill_holes = true fills and marks them"
        )
    if missing.any():
        values = _filled(values, missing, source)
    fine = ndimage.map_coordinates(values, np.stack((rows, columns)), order=3, mode="mirror")
    return Sampled(values=fine, filled=holes, source_slope_deg=steep, pixel_m=pixel_m[0], window=where, sha256=checksum)


def needed(source: Source, plane: SitePlane, margin: int) -> tuple[FloatArray, FloatArray, tuple[int, int, int, int]]:
    """Rows and columns of the cells in the raster, and the window (row, column, rows, columns) that they need.

    Raises InvalidInput if the raster does not surround the site.
    """
    x, y = plane.centres(margin)
    east, north = transformer(plane.crs, source.crs).transform(x, y)
    if not (np.isfinite(east).all() and np.isfinite(north).all()):
        raise InvalidInput(f"{source.name}: expected a projection that holds the site, got places outside of it")
    rows, columns = source.pixels(east, north)
    columns = _unwrapped(columns, source)
    return rows, columns, _window(source, rows, columns)


def _unwrapped(columns: FloatArray, source: Source) -> FloatArray:
    """The columns without the jump of a full circle at the antimeridian, and within the raster if possible."""
    if source.period is None:
        return columns
    middle = float(columns[columns.shape[0] // 2, columns.shape[1] // 2])
    columns = columns - source.period * np.round((columns - middle) / source.period)
    return columns - source.period * math.floor(middle / source.period)


def _window(source: Source, rows: FloatArray, columns: FloatArray) -> tuple[int, int, int, int]:
    """(row, column, rows, columns) of the pixels that are needed, with padding as far as the raster reaches."""
    bounds = []
    factors = _pixels_a_block(_pixels_a_cell(rows, columns))
    axes = (("rows", rows, source.rows, factors[0]), ("columns", columns, source.columns, factors[1]))
    for axis, places, count, factor in axes:
        low, high = float(places.min()) - 0.5, float(places.max()) - 0.5  # in pixels' centres
        first, last = math.floor(low + 1e-6) - _SUPPORT + 1, math.ceil(high - 1e-6) + _SUPPORT - 1
        endless = axis == "columns" and source.is_global
        if not endless and (first < 0 or last > count - 1):
            raise InvalidInput(
                f"{source.name}: layer {source.layer}: expected a raster that surrounds the site by "
                f"{_SUPPORT - 1} pixel, {axis} {first} to {last}, got 0 to {count - 1}"
            )
        if endless and last - first > count:
            raise InvalidInput(f"{source.name}: layer {source.layer}: expected a site on one side of the pole in a "
                               f"cylindrical raster, got one around it")  # fmt: skip
        blocks = min(_PADDING_BLOCKS * factor, (_SIDE - last + first) // 2) if factor > 1 else 0
        padding = max(_PADDING, blocks)
        first, last = first - padding, last + padding
        if not endless:
            first, last = max(first, 0), min(last, count - 1)
        bounds.append((first, last - first + 1))
    return bounds[0][0], bounds[1][0], bounds[0][1], bounds[1][1]


def _pixels_a_cell(rows: FloatArray, columns: FloatArray) -> tuple[float, float]:
    """How many pixels, stacked along the raster's rows and columns, are as long as a cell, in the middle of the site.

    A raster may be rotated against the site, as a polar one is by its longitude: the length of a pixel on the ground
    follows from the inverse of the derivatives of row and column in the cell's two directions.
    """
    r, c = rows.shape[0] // 2, rows.shape[1] // 2
    found = [[places[r, c] - places[r - 1, c], places[r, c] - places[r, c - 1]] for places in (rows, columns)]
    (of_row, of_column) = np.linalg.norm(np.linalg.inv(np.array(found)), axis=0)  # cells a pixel
    return 1.0 / float(of_row), 1.0 / float(of_column)


def _pixels_a_block(step: tuple[float, float]) -> tuple[int, int]:
    """Pixels, down and across, that are averaged before they are resampled. step: pixels a cell."""
    return max(1, int(step[0] + 1e-6)), max(1, int(step[1] + 1e-6))


def _averaged(values: FloatArray, factors: tuple[int, int]) -> FloatArray:
    """Means over blocks, so that cells larger than pixels show no aliases; a block with a missing value is missing."""
    if factors == (1, 1):
        return values
    rows, columns = values.shape[0] // factors[0], values.shape[1] // factors[1]
    cut = values[: rows * factors[0], : columns * factors[1]]
    blocks: FloatArray = cut.reshape(rows, factors[0], columns, factors[1]).mean(axis=(1, 3))
    return blocks


def source_slopes(
    values: FloatArray, pixel_m: tuple[float, float], rows: FloatArray, columns: FloatArray
) -> FloatArray:
    """Slope [deg] of the raster itself at each cell: the steepest of all pixels that the cell touches.

    A path may lead through any part of a cell, so the pixel at its centre is not enough.
    """
    known = np.where(np.isnan(values), np.nanmean(values) if np.isfinite(values).any() else 0.0, values)
    square = known if abs(pixel_m[0] / pixel_m[1] - 1) < 1e-3 else None
    if square is not None:
        slope = slope_deg(known, pixel_m[0])
    else:
        down, right = np.gradient(known, pixel_m[0], pixel_m[1])
        slope = np.degrees(np.arctan(np.hypot(down, right)))
    reach = _extent(rows) / 2, _extent(columns) / 2
    # Windows of this size at both ends of a cell's extent cover it, and reach no further than the pixels it touches.
    size = tuple(max(1, math.ceil(2 * half - 1e-6)) for half in reach)
    steepest = ndimage.maximum_filter(slope, size=size, mode="nearest", origin=tuple(-(n // 2) for n in size))
    found: FloatArray = np.zeros(rows.shape)
    for r in _ends(rows, reach[0], size[0], slope.shape[0]):
        for c in _ends(columns, reach[1], size[1], slope.shape[1]):
            found = np.maximum(found, steepest[r, c])
    return found


def _extent(places: FloatArray) -> float:
    """How many pixels a cell in the middle of the site extends over along one axis, its corners included."""
    r, c = places.shape[0] // 2, places.shape[1] // 2
    return float(abs(places[r, c] - places[r - 1, c]) + abs(places[r, c] - places[r, c - 1]))


def _ends(places: FloatArray, reach: float, size: int, count: int) -> tuple[IntArray, IntArray]:
    """First pixels of the window at the beginning and of the one at the end of each cell's extent along one axis."""
    first = np.rint(places - reach + 1e-6).astype(np.intp)
    last = np.rint(places + reach - 1e-6).astype(np.intp) - size + 1
    return np.clip(first, 0, count - 1), np.clip(last, 0, count - 1)


def _filled(values: FloatArray, missing: BoolArray, source: Source) -> FloatArray:
    """The values with their holes filled from the edges of these, by GDAL's inverse distances."""
    if missing.all():
        raise InvalidInput(f"{source.name}: layer {source.layer}: expected values in the site, got missing ones alone")
    rasterio()
    from rasterio.fill import fillnodata

    middle = float(np.nanmean(values))
    data = np.where(missing, 0.0, values - middle).astype(np.float32)
    reach = float(max(values.shape))
    filled = fillnodata(data, mask=(~missing).astype(np.uint8), max_search_distance=reach)
    return np.where(missing, filled.astype(np.float64) + middle, values)

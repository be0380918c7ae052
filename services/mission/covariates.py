"""The prior mean of a scenario: what is known from orbit, as layers over the region whose weights are to be learned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from he3.constants import MOON_RADIUS_M
from he3.errors import InvalidInput
from he3.frames import FloatArray
from he3.hyperprior import MEAN_PPB, MEAN_STD_PPB
from he3.nodata import cells_where, far_off, undeclared
from he3.reference import METRES_PER_DEGREE, Region
from he3.trend import GAIN_STD, UNSURE_GAIN_STD, CovariateTrend, covariate_trend, orbital_trend, split_by_scale
from services.mission.npy import mapped_array
from services.mission.scenario import Scenario
from services.mission.tiff import NotPlain, facts_of, read_tiff

REGION_LAYERS: Final = ("orbital_ppb", "elevation_m", "slope_deg")
"""Layers that every region has, which a scenario may name; the reference field is none of them."""


def trend_of(scenario: Scenario, region: Region) -> CovariateTrend | None:
    """The trend of that scenario over its region; None for an unknown constant alone. Raises InvalidInput."""
    layers = split_by_scale(covariates(scenario.ground.covariates, region), region.grid, scenario.samples)
    if scenario.ground.prior == "orbital":
        gain_std = GAIN_STD if scenario.ground.hyperparameters == "ml" else UNSURE_GAIN_STD
        return orbital_trend(region.grid, region.orbital_ppb, gain_std, covariates=layers)
    return covariate_trend(region.grid, layers, MEAN_PPB, MEAN_STD_PPB, split=True) if len(layers) else None


def covariates(names: Sequence[str], region: Region) -> FloatArray:
    """The layers (k, rows, columns) of these names, row 0 south.

    A name is one of ``REGION_LAYERS``, or a raster of the region's cells: .npy with row 0 south, or .tif with row 0
    north. Raises InvalidInput, in one line, for a name that is neither, and for a raster of another shape or with cells
    without a value: not finite, the file's no-data value, or a number that marks missing values in any unit; also for
    one with a few cells far beyond all others, which would be all that the layer shows, and for one that has one value
    everywhere, as the heights of a region that has none. A .tif that says where it lies has to lie on these cells, as
    far as the region says where it lies itself: by its projection, by latitude and longitude for a raster in degrees,
    else by the size of a cell.
    """
    layers = np.empty((len(names), *region.grid.shape))
    for number, name in enumerate(names):
        values = getattr(region, name) if name in REGION_LAYERS else _raster(name, region)
        if values.shape != region.grid.shape or values.dtype.kind not in "iuf":
            raise InvalidInput(
                f"covariate {name}: expected numbers of shape {region.grid.shape}, as the region, got {values.dtype} "
                f"of shape {values.shape}"
            )
        if not np.isfinite(values).all():
            raise InvalidInput(f"covariate {name}: expected a value on every cell, got NaN or infinity")
        marks = None if name in REGION_LAYERS else undeclared(values, np.ones(values.shape, dtype=np.bool_))
        if marks is not None:
            raise InvalidInput(
                f"covariate {name}: expected a value on every cell, got {marks.number:g}, which marks missing values, "
                f"in {cells_where(marks.where)}"
            )
        if name not in REGION_LAYERS and (broken := far_off(values)).any():
            others = values[~broken]
            raise InvalidInput(
                f"covariate {name}: expected values as the others, {others.min():g} to {others.max():g}, got "
                f"{values[broken][0]:g} in {cells_where(broken)}: such values hide what the others show; mend or clip "
                "them"
            )
        if values.size and values.min() == values.max():
            raise InvalidInput(
                f"covariate {name}: expected values that differ from cell to cell, got {values.flat[0]:g} on all cells"
            )
        layers[number] = values
    return layers


def _raster(name: str, region: Region) -> NDArray[Any]:
    path = Path(name)
    if path.suffix.lower() not in (".npy", ".tif", ".tiff"):
        raise InvalidInput(f"covariate {name}: expected {', '.join(REGION_LAYERS)}, or a file .npy or .tif")
    if not path.is_file():
        raise InvalidInput(f"covariate {name}: expected a file, found none")
    values: NDArray[Any]
    if path.suffix.lower() != ".npy":
        try:
            values = read_tiff(path)[::-1]
            facts = facts_of(path)
            _expect_no_holes(name, values, facts.no_data, facts.masked)
            if facts.place is not None:
                _expect_here(name, facts.place, facts.degrees, region)
            return values
        except NotPlain as error:
            raise InvalidInput(f"covariate {name}: expected a plain GeoTIFF, got {error}") from None
    try:
        return mapped_array(path)
    except InvalidInput as error:
        raise InvalidInput(f"covariate {name}: expected an array that NumPy reads, got {error}") from None


def _expect_no_holes(name: str, values: NDArray[Any], no_data: float | None, masked: bool) -> None:
    """Raises InvalidInput if cells (rows, columns) have the file's no-data value, or if a mask may hide some."""
    if masked:
        raise InvalidInput(
            f"covariate {name}: expected a value on every cell, got a raster with a mask of such without"
        )
    if no_data is None:
        return
    # As the raster's own type rounds it: -3.4028226550889045e38 is no float32.
    rounded = np.asarray(no_data).astype(values.dtype) if values.dtype.kind == "f" else no_data
    holes: NDArray[np.bool_] = np.asarray(values == rounded)
    if holes.any():
        raise InvalidInput(
            f"covariate {name}: expected a value on every cell, got none (the raster's no-data value, {no_data:g}) in "
            f"{cells_where(holes)}"
        )


def _expect_here(name: str, place: tuple[float, float, float, float], degrees: bool, region: Region) -> None:
    """Raises InvalidInput for a raster that is not north up, or cannot have the region's cells by what its file says.

    place: (x, y) of the outer north-west corner, width and height of a pixel, in degrees or in a projection.
    """
    x, y, width, height = place
    if not height > 0.0:
        raise InvalidInput(f"covariate {name}: expected a raster with row 0 in the north, got another one")
    if region.origin_x_m is None or region.origin_y_m is None:
        if degrees:
            _expect_corner(name, x, y, region)
        _expect_cells(name, width, height, y if degrees else None, region)
        return
    cell, west, north = region.grid.resolution_m, region.origin_x_m, region.origin_y_m + region.grid.height_m
    if max(abs(x - west), abs(y - north)) > cell / 2 or max(abs(width - cell), abs(height - cell)) > 0.01 * cell:
        raise InvalidInput(
            f"covariate {name}: expected the region's own cells, of {cell:g} m from ({west:.10g}, {north:.10g}) m on "
            f"in its projection, got cells of {width:.6g} x {height:.6g} from ({x:.10g}, {y:.10g}) on"
        )


def _expect_cells(name: str, width: float, height: float, north_deg: float | None, region: Region) -> None:
    """Raises InvalidInput for pixels that are not as large as the cells of a region without a projection, within 1 %.

    north_deg: of the raster's north edge, if its pixels are in degrees. In metres, their projection is not known. They
    may be those of the ground, of IAU_2015:30110, or of the polar stereographic projection that is true at the pole, as
    in layers that `he3 map save` writes.
    """
    grid, latitude = region.grid, region.origin_lat_deg
    cell = grid.resolution_m
    if north_deg is not None:
        middle = math.radians(north_deg) - grid.height_m / 2 / MOON_RADIUS_M
        width, height = (math.radians(size) * MOON_RADIUS_M for size in (width * math.cos(middle), height))
    sizes = [(cell, cell)]
    if north_deg is None and latitude is not None:
        middle = math.radians(latitude) + grid.height_m / 2 / MOON_RADIUS_M
        polar = cell * 2.0 / (1.0 + abs(math.sin(middle)))
        sizes += [(cell / math.cos(middle), cell), (polar, polar)]
    if not any(abs(width / wide - 1.0) <= 0.01 and abs(height / high - 1.0) <= 0.01 for wide, high in sizes):
        raise InvalidInput(
            f"covariate {name}: expected the region's own cells, of {cell:g} m, got cells of {width:.6g} x "
            f"{height:.6g} m"
        )


def _expect_corner(name: str, longitude_deg: float, latitude_deg: float, region: Region) -> None:
    """Raises InvalidInput for a north-west corner more than half a cell from that of a region of known place."""
    if region.origin_lat_deg is None or region.origin_lon_deg is None:
        return
    west, north = region.origin_lon_deg, region.origin_lat_deg + region.grid.height_m / METRES_PER_DEGREE
    off_lon = (longitude_deg - west + 180.0) % 360.0 - 180.0
    east_m = off_lon * METRES_PER_DEGREE * math.cos(math.radians(north))
    north_m = (latitude_deg - north) * METRES_PER_DEGREE
    if max(abs(east_m), abs(north_m)) > region.grid.resolution_m / 2:
        raise InvalidInput(
            f"covariate {name}: expected a raster whose north-west corner lies at {north:.6f} N {west:.6f} E, as the "
            f"region's, got {latitude_deg:.6f} N {longitude_deg:.6f} E"
        )

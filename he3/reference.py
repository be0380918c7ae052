"""The reference field: a finished region from orbital rasters, in the paper's five steps.

  1. a window of coarse FeO, OMAT and elevation (about 59 m a pixel), larger than the region, so that no values beyond
     the data are invented at its edge
  2. georeferenced bicubic resampling onto the region's cells (500 x 500 of 1 m)
  3. perturbation of the measured layers, X' = X (1 + 0.05 g), with unit Gaussian fields g of 25 m correlation length
     that have the layers' own correlation
  4. TiO2' from FeO'
  5. helium-3 from TiO2', OMAT' and the solar wind

Derived layers (TiO2, helium-3, slope, relief, traversability) are always recomputed, never perturbed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from he3 import constants
from he3.errors import InvalidInput
from he3.frames import BoolArray, FloatArray, SiteGrid
from he3.nodata import expect_measured, expect_no_walls
from he3.provenance import LayerOrigin, OriginKind
from he3.randomfield import correlated, layer_correlation, unit_fields
from he3.regolith import RegolithModel
from he3.terrain import relief_m, slope_deg, traversable

METRES_PER_DEGREE = math.radians(1.0) * constants.MOON_RADIUS_M  # m per degree of latitude on the reference sphere
_SURROUND_PIXELS = 2  # pixels that bicubic resampling needs beyond the outermost cell
_DERIVED = (
    LayerOrigin(layer="titanium_wt", kind=OriginKind.DERIVED, source="from FeO"),
    LayerOrigin(layer="he3_ppb", kind=OriginKind.DERIVED, source="from TiO2, OMAT and the solar wind, perturbed"),
    LayerOrigin(layer="slope_deg", kind=OriginKind.DERIVED, source="from elevation"),
    LayerOrigin(layer="traversable", kind=OriginKind.DERIVED, source="from slope and relief"),
)
_ORBITAL_FOOTPRINT_M = METRES_PER_DEGREE / constants.ORBITAL_PIXELS_PER_DEGREE  # m, side of an orbital pixel
_FOOTPRINT_CELLS = 4  # side of the smallest footprint; with that of a cell, the orbital map would be the field itself


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrbitalWindow:
    """A georeferenced window of orbital rasters around a region, in degrees, row 0 in the south.

    iron_wt, maturity, elevation_m: FeO [wt %], OMAT and height [m], each (rows, columns). south_deg and west_deg are
    the outer corner of pixel (0, 0); origin is the region's south-west corner. ``seed`` is the one for which the
    region's published figures hold. Raises InvalidInput for shapes that do not fit and for missing values.
    """

    name: str
    title: str
    provenance: str
    iron_wt: FloatArray
    maturity: FloatArray
    elevation_m: FloatArray
    south_deg: float
    west_deg: float
    pixels_per_degree: float
    origin_lat_deg: float
    origin_lon_deg: float
    solar_wind_flux: float
    seed: int
    layers: tuple[LayerOrigin, ...] = ()
    """Where the rasters come from."""

    def __post_init__(self) -> None:
        shape = self.iron_wt.shape
        for name in ("iron_wt", "maturity", "elevation_m"):
            layer = getattr(self, name)
            if layer.ndim != 2 or layer.shape != shape or min(layer.shape) < 4:
                raise InvalidInput(f"{self.name}: expected {name} (rows, columns) of {shape} and at least 4 x 4, "
                                   f"got {layer.shape}")  # fmt: skip
        expect_measured(f"{self.name}: iron_wt", self.iron_wt, constants.IRON_MIN_WT, constants.IRON_MAX_WT, "wt %")
        expect_measured(f"{self.name}: maturity", self.maturity, constants.OMAT_MIN, constants.OMAT_MAX)
        heights = (constants.ELEVATION_MIN_M, constants.ELEVATION_MAX_M)
        expect_measured(f"{self.name}: elevation_m", self.elevation_m, *heights, "m")
        if not (self.pixels_per_degree > 0 and abs(self.origin_lat_deg) < 89):
            raise InvalidInput(f"{self.name}: expected a positive pixels_per_degree and a latitude within -89..89 deg")
        expect_no_walls(f"{self.name}: elevation_m", self.elevation_m, METRES_PER_DEGREE / self.pixels_per_degree)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Region:
    """A finished region: the ground truth of a site. All maps are (rows, columns) over ``grid``, read-only.

    he3_ppb is the reference field. Where nothing is known of it, ``known`` is False, he3_ppb has the value of the
    nearest known cell, no cell is traversable, and no map is scored. orbital_ppb is the map of an orbiter: coarse,
    resampled, without the variation within its pixels. seed and origin are None for a region given as finished arrays.
    """

    name: str
    title: str
    provenance: str
    grid: SiteGrid
    he3_ppb: FloatArray
    orbital_ppb: FloatArray
    elevation_m: FloatArray
    slope_deg: FloatArray
    traversable: BoolArray
    seed: int | None = None
    origin_lat_deg: float | None = None
    origin_lon_deg: float | None = None
    layers: tuple[LayerOrigin, ...] = ()
    """Where each layer comes from; empty for a region that does not say."""
    crs: str = ""
    """Projection of the site's plane, as a PROJ string; empty if none is known."""
    origin_x_m: float | None = None
    """Of the south-west corner in that projection [m]."""
    origin_y_m: float | None = None
    known: BoolArray | None = None
    """Where the reference field is known; None where it is everywhere."""
    untraversable_fraction: float = field(init=False)

    def __post_init__(self) -> None:
        for name in ("he3_ppb", "orbital_ppb", "elevation_m", "slope_deg", "traversable"):
            layer = getattr(self, name)
            if layer.shape != self.grid.shape:
                raise InvalidInput(f"{self.name}: expected {name} of shape {self.grid.shape}, got {layer.shape}")
            layer.flags.writeable = False
        if self.known is not None:
            if self.known.shape != self.grid.shape or (self.traversable & ~self.known).any():
                raise InvalidInput(f"{self.name}: expected no traversable cell without a reference")
            self.known.flags.writeable = False
        object.__setattr__(self, "untraversable_fraction", float(1.0 - self.traversable.mean()))

    def of_known(self, values: NDArray[np.generic]) -> NDArray[Any]:
        """Those of the values (rows, columns) that lie where the reference field is known, (k,): what is scored."""
        known: NDArray[Any] = values.ravel() if self.known is None else values[self.known]
        return known


def reference(
    window: OrbitalWindow,
    seed: int | None = None,
    *,
    grid: SiteGrid | None = None,
    model: RegolithModel | None = None,
    perturbation: float = constants.PERTURBATION,
    length_m: float = constants.CORRELATION_LENGTH_M,
    slope_limit_deg: float = constants.ROVER_SLOPE_NOMINAL_DEG,
) -> Region:
    """The finished region of a window of orbital rasters and a seed; equal seeds give equal regions.

    seed: None is the window's own. grid: 500 x 500 cells of 1 m by default. perturbation: relative standard deviation
    of the variation within pixels. length_m: its correlation length [m]. Raises InvalidInput if the window does not
    surround the grid by half a relief window and two pixels.
    """
    seed = window.seed if seed is None else seed
    grid = grid or SiteGrid(constants.SITE_CELLS, constants.SITE_CELLS, constants.SITE_RESOLUTION_M)
    model = model or RegolithModel()
    measured = np.stack([window.iron_wt, window.maturity])
    fine = np.stack([resample(window, layer, grid) for layer in measured])
    independent = unit_fields(2, grid.shape, (grid.resolution_m,) * 2, length_m, np.random.default_rng(seed))
    variation = correlated(independent, layer_correlation(measured))
    iron, maturity = fine * (1.0 + perturbation * variation)
    orbital = model.helium3_ppb(model.titanium_wt(window.iron_wt), window.maturity, window.solar_wind_flux)
    margin = math.ceil(constants.RELIEF_WINDOW_M / 2 / grid.resolution_m)
    elevation = resample(window, window.elevation_m, grid, margin)
    slope = _cut(slope_deg(elevation, grid.resolution_m), margin)
    return Region(
        name=window.name,
        title=window.title,
        provenance=window.provenance,
        grid=grid,
        he3_ppb=model.helium3_ppb(model.titanium_wt(iron), maturity, window.solar_wind_flux),
        orbital_ppb=np.maximum(resample(window, orbital, grid), 0.0),
        elevation_m=_cut(elevation, margin),
        slope_deg=slope,
        traversable=traversable(slope, _cut(relief_m(elevation, grid.resolution_m), margin), slope_limit_deg),
        seed=seed,
        origin_lat_deg=window.origin_lat_deg,
        origin_lon_deg=window.origin_lon_deg,
        layers=(*window.layers, *_DERIVED),
    )


def resample(window: OrbitalWindow, layer: FloatArray, grid: SiteGrid, margin: int = 0) -> FloatArray:
    """A layer of the window at the grid's cell centres and ``margin`` cells around them, by bicubic splines.

    The site's plane is the local equirectangular projection: a degree of longitude shrinks with the cosine of the
    latitude of the region's centre, so a pixel that is square in degrees is not square on the ground. Raises
    InvalidInput if the window does not surround these cells by two pixels.
    """
    pixel_deg = 1.0 / window.pixels_per_degree
    middle_lat = window.origin_lat_deg + grid.height_m / 2 / METRES_PER_DEGREE
    metres_per_degree_east = METRES_PER_DEGREE * math.cos(math.radians(middle_lat))
    rows, columns = layer.shape
    north = (window.south_deg + (np.arange(rows) + 0.5) * pixel_deg - window.origin_lat_deg) * METRES_PER_DEGREE
    east = (window.west_deg + (np.arange(columns) + 0.5) * pixel_deg - window.origin_lon_deg) * metres_per_degree_east
    y = (np.arange(-margin, grid.rows + margin) + 0.5) * grid.resolution_m
    x = (np.arange(-margin, grid.columns + margin) + 0.5) * grid.resolution_m
    for axis, pixels, cells in (("north", north, y), ("east", east, x)):
        spare = _SURROUND_PIXELS * (pixels[1] - pixels[0])
        if not (pixels[0] + spare <= cells[0] and cells[-1] <= pixels[-1] - spare):
            raise InvalidInput(
                f"{window.name}: expected a raster window that surrounds {cells[0]:g}..{cells[-1]:g} m {axis} by "
                f"{_SURROUND_PIXELS} pixels, got {pixels[0]:.0f}..{pixels[-1]:.0f} m"
            )
    from scipy.interpolate import RectBivariateSpline  # 0.3 s, and only where a field is made

    fine: FloatArray = RectBivariateSpline(north, east, layer, s=0)(y, x)
    return fine


def orbital_view(he3_ppb: FloatArray, grid: SiteGrid, footprint_m: float = _ORBITAL_FOOTPRINT_M) -> FloatArray:
    """The field (rows, columns) [ppb] as an orbiter with square footprints would map it.

    Block means over footprints of ``footprint_m``, resampled by bicubic splines: for fields given as finished arrays,
    without the coarse map that they were made from. At the edge of the field a footprint covers less of it, and
    nothing is extrapolated. A footprint is at least 4 cells wide, so that the view never is the field that is sought.
    """
    footprint_m = max(footprint_m, _FOOTPRINT_CELLS * grid.resolution_m)
    coarse, centres = he3_ppb, []
    for axis, cells in enumerate(grid.shape):
        blocks = min(cells, max(1, round(cells * grid.resolution_m / footprint_m)))
        edges = np.linspace(0, cells, blocks + 1).round().astype(int)
        coarse = np.add.reduceat(coarse, edges[:-1], axis=axis) / np.expand_dims(np.diff(edges), 1 - axis)
        centres.append((edges[:-1] + edges[1:]) / 2 * grid.resolution_m)
    orders = [min(3, len(c) - 1) for c in centres]
    if min(orders) < 1:
        return np.full(grid.shape, float(he3_ppb.mean()))
    inner = [np.clip(c, k[0], k[-1]) for c, k in zip((grid.y_m, grid.x_m), centres, strict=True)]
    from scipy.interpolate import RectBivariateSpline

    view: FloatArray = RectBivariateSpline(*centres, coarse, kx=orders[0], ky=orders[1], s=0)(*inner)
    return np.clip(view, 0.0, constants.HELIUM3_MAX_PPB)  # beside a step, a spline overshoots


def _cut(values: FloatArray, margin: int) -> FloatArray:
    """The values without ``margin`` cells on each side."""
    return values[margin:-margin, margin:-margin].copy() if margin else values

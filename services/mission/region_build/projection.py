"""The site's plane on the Moon: a projection whose metres at the site are metres on the ground.

Up to 65 deg of latitude it is equirectangular, true to scale at the latitude of the centre, as in `he3.reference`. At
a distance y north of the centre, east-west lengths are off by tan(lat) y / R: 0.1 % at 20 deg and 5 km. Where that is
more than 1 % at an edge of the site, as at 60 deg and 10 km, the plane is stereographic about the centre instead, which
is off by the squared distance from it over 4 R^2: 0.04 % in the corner of a site of 100 km.
Beyond 65 deg it is polar stereographic, true to scale at the centre, about the meridian of the south-west corner,
along which the site's north lies. That is how the map's GeoTIFFs place a polar site, too. A site across a pole has the
meridian of its centre in the middle instead. Lengths are off by cos(lat) / (1 + sin(lat)) y / R: by 0.06 % at 66 deg
and 5 km, by 0.6 % at 50 km. Source: Snyder 1987, USGS Professional Paper 1395, sections 12 and 21.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from he3.constants import MOON_RADIUS_M
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from services.mission.region_build.geo import pyproj

POLAR_DEG: Final = 65.0  # deg, beyond it lunar maps are polar stereographic, as those of the USGS
MAX_SCALE_ERROR: Final = 1e-3  # 1, of the metres of a projection that a recipe gives
MAX_STRETCH: Final = 0.01  # 1, of lengths at the edges of a site in the equirectangular projection
MOON_SPHERE: Final = f"+proj=longlat +R={MOON_RADIUS_M:.0f} +no_defs"


@dataclass(frozen=True, slots=True, kw_only=True)
class SitePlane:
    """The site's cells in a projection. x and y are of the south-west corner [m]."""

    crs: str
    x_m: float
    y_m: float
    grid: SiteGrid
    has_origin: bool
    """Whether latitude and longitude of the corner define the place of the site; not with a projection of the recipe,
    across a pole, or stereographically about the centre."""

    def centres(self, margin: int = 0) -> tuple[FloatArray, FloatArray]:
        """(x, y) [m] in the projection of all cell centres and ``margin`` cells around, each (rows, columns)."""
        grid = self.grid
        x = self.x_m + (np.arange(-margin, grid.columns + margin) + 0.5) * grid.resolution_m
        y = self.y_m + (np.arange(-margin, grid.rows + margin) + 0.5) * grid.resolution_m
        east, north = np.meshgrid(x, y)
        return east, north

    def corner_deg(self) -> tuple[float, float]:
        """Latitude and longitude [deg] of the south-west corner."""
        longitude, latitude = transformer(self.crs, MOON_SPHERE).transform(self.x_m, self.y_m)
        return float(latitude), float(longitude)


def site_plane(latitude_deg: float, longitude_deg: float, grid: SiteGrid, projection: str = "") -> SitePlane:
    """The plane of a site with that centre. projection: a PROJ string or an IAU code from the recipe.

    Raises InvalidInput for a projection that does not hold the centre, or whose metres there are not those of the
    ground within 0.1 %.
    """
    if projection:
        crs, own = projection, True
    elif abs(latitude_deg) <= POLAR_DEG and _stretch(latitude_deg, grid.height_m) > MAX_STRETCH:
        crs, own = about_centre(latitude_deg, longitude_deg), True
    elif abs(latitude_deg) <= POLAR_DEG:
        crs = f"+proj=eqc +lat_ts={latitude_deg!r} +lat_0=0 +lon_0={longitude_deg!r} +R={MOON_RADIUS_M:.0f} +units=m"
        own = False
    else:
        crs, own = _polar(latitude_deg, longitude_deg, grid)
    east, north = transformer(MOON_SPHERE, crs).transform(longitude_deg, latitude_deg)
    if not (math.isfinite(east) and math.isfinite(north)):
        raise InvalidInput(f"projection: expected one that holds the centre, got {projection!r}")
    if projection:
        _expect_metres(crs, float(east), float(north))
    corner = float(east) - grid.width_m / 2, float(north) - grid.height_m / 2
    return SitePlane(crs=crs, x_m=corner[0], y_m=corner[1], grid=grid, has_origin=not own)


def transformer(source: Any, target: Any) -> Any:
    """A transformation of (x, y) between two projections of the Moon; raises InvalidInput for an unknown projection."""
    return pyproj().Transformer.from_crs(_crs(source), _crs(target), always_xy=True)


def _crs(given: Any) -> Any:
    library = pyproj()
    try:
        return library.CRS.from_user_input(given)
    except library.exceptions.ProjError:
        raise InvalidInput(f"expected a projection, got {str(given)[:80]!r}") from None


def about_centre(latitude_deg: float, longitude_deg: float) -> str:
    """The stereographic projection about that place, true to scale there, its y axis along the meridian."""
    return f"+proj=stere +lat_0={latitude_deg!r} +lon_0={longitude_deg!r} +R={MOON_RADIUS_M:.0f} +units=m"


def array_crs(latitude_deg: float, longitude_deg: float, height_m: float) -> str:
    """The projection of an array whose row 0 is north at its centre: equirectangular where that is true to scale."""
    if abs(latitude_deg) > POLAR_DEG or _stretch(latitude_deg, height_m) > MAX_STRETCH:
        return about_centre(latitude_deg, longitude_deg)
    return (
        f"+proj=eqc +lat_ts={latitude_deg!r} +lon_0={longitude_deg!r} +R={MOON_RADIUS_M:.0f} "
        f"+y_0={-math.radians(latitude_deg) * MOON_RADIUS_M!r} +units=m"
    )


def _stretch(latitude_deg: float, height_m: float) -> float:
    """Relative error of east-west lengths at the edge of a site that is farther from the equator, equirectangular."""
    edge = math.radians(abs(latitude_deg)) + height_m / 2 / MOON_RADIUS_M
    return math.cos(math.radians(latitude_deg)) / max(math.cos(edge), 1e-9) - 1.0


def _polar(latitude_deg: float, longitude_deg: float, grid: SiteGrid) -> tuple[str, bool]:
    """The polar stereographic projection, and whether the corner's meridian could not be its middle."""
    hemisphere = math.copysign(1.0, latitude_deg)
    scale = (1.0 + math.sin(math.radians(abs(latitude_deg)))) / 2.0  # of the pole, for a scale of 1 at the centre
    rho = scale * 2.0 * MOON_RADIUS_M * math.tan(math.radians(90.0 - abs(latitude_deg)) / 2.0)
    reach = grid.width_m / 2.0
    across = rho < 2.0 * max(grid.width_m, grid.height_m)
    # The centre lies half a width east of the corner's meridian.
    turn = 0.0 if across else math.degrees(math.asin(reach / rho))
    meridian = longitude_deg - turn
    return (
        f"+proj=stere +lat_0={90.0 * hemisphere:.0f} +lon_0={meridian!r} +k_0={scale!r} +x_0=0 +y_0=0 "
        f"+R={MOON_RADIUS_M:.0f} +units=m"
    ), across


def _expect_metres(crs: str, x_m: float, y_m: float) -> None:
    """Raises InvalidInput unless 100 m of the projection are 100 m on the ground, both ways."""
    back = transformer(crs, MOON_SPHERE)
    longitude, latitude = back.transform([x_m, x_m + 100.0, x_m], [y_m, y_m, y_m + 100.0])
    points = np.radians(np.column_stack((longitude, latitude)))
    unit = np.column_stack(
        (np.cos(points[:, 1]) * np.cos(points[:, 0]), np.cos(points[:, 1]) * np.sin(points[:, 0]), np.sin(points[:, 1]))
    )
    for index in (1, 2):
        ground = MOON_RADIUS_M * float(np.linalg.norm(unit[index] - unit[0]))
        if not abs(ground / 100.0 - 1.0) <= MAX_SCALE_ERROR:
            raise InvalidInput(
                f"projection: expected metres of the ground at the centre, got 100 m that are {ground:.2f} m on it"
            )

"""Where a site lies on the Moon: a projection on the sphere of IAU 2015, in whose metres the site's cells are square.

It is the region's own projection if it gives one. Else it is that in which regions are made: equirectangular, true to
scale at the latitude of the site's middle, up to 65 deg; beyond, polar stereographic, true to scale there, about the
meridian of the south-west corner. A region without a place is left in the site frame. Source: Snyder 1987, USGS
Professional Paper 1395, sections 12 and 21.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from he3.constants import MOON_RADIUS_M
from he3.frames import FloatArray, as_points
from services.mission.region_build.geo import pyproj
from services.mission.region_build.projection import POLAR_DEG, transformer

if TYPE_CHECKING:
    from schemas.maps import MapRegion

GEOGRAPHIC: Final = "IAU_2015:30100"
"""Longitude and latitude on the lunar sphere of 1737.4 km, east positive."""
SITE_FRAME: Final = (
    'LOCAL_CS["site frame: metres east and north of the region\'s south-west corner",UNIT["metre",1],'
    'AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
)


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """The projection of a site, and its south-west corner there [m]."""

    crs: Any
    """A pyproj CRS; None for a site without a place."""
    x_m: float = 0.0
    y_m: float = 0.0
    middle_deg: float = 0.0
    """Longitude of the site's middle, -180 to 180; longitudes continue about it without a jump."""

    @property
    def wkt(self) -> str:
        """The projection as WKT, or the site frame as a local one."""
        return SITE_FRAME if self.crs is None else str(self.crs.to_wkt())

    @property
    def name(self) -> str:
        return "site frame" if self.crs is None else str(self.crs.name)

    def projected(self, points_m: FloatArray) -> FloatArray:
        """Places of the site (N, 2) [m] in the projection, (N, 2) [m]."""
        moved: FloatArray = as_points(points_m) + np.array((self.x_m, self.y_m))
        return moved

    def degrees(self, points_m: FloatArray) -> FloatArray | None:
        """Longitude and latitude (N, 2) [deg] of places of the site (N, 2) [m]; None for a site without a place."""
        if self.crs is None:
            return None
        points = self.projected(points_m)
        longitude, latitude = transformer(self.crs, GEOGRAPHIC).transform(points[:, 0], points[:, 1])
        continued = self.middle_deg + (np.asarray(longitude) - self.middle_deg + 180.0) % 360.0 - 180.0
        return np.column_stack((continued, latitude))


def placed(region: MapRegion) -> Placement:
    """Where that region lies; raises InvalidInput for a projection that PROJ does not know."""
    width, height = region.columns * region.resolution_m, region.rows * region.resolution_m
    if region.crs and region.origin_x_m is not None and region.origin_y_m is not None:
        corner = region.origin_x_m, region.origin_y_m
        found = Placement(_on_the_moon(region.crs, f"site plane of region '{region.name}'"), *corner)
    elif region.origin_lat_deg is not None and region.origin_lon_deg is not None:
        found = _by_origin(region.origin_lat_deg, region.origin_lon_deg, height, region.name)
    else:
        return Placement(None)
    middle = found.projected(np.array([(width / 2, height / 2)]))[0]
    longitude = float(transformer(found.crs, GEOGRAPHIC).transform(*middle)[0])
    return Placement(found.crs, found.x_m, found.y_m, (longitude + 180.0) % 360.0 - 180.0)


def _by_origin(latitude_deg: float, longitude_deg: float, height_m: float, name: str) -> Placement:
    latitude = math.radians(latitude_deg)
    middle = latitude + height_m / 2 / MOON_RADIUS_M
    called = f"site plane of region '{name}'"
    radius = f"+R={MOON_RADIUS_M:.0f} +units=m"
    if abs(math.degrees(middle)) <= POLAR_DEG:
        crs = f"+proj=eqc +lat_ts={math.degrees(middle)!r} +lat_0=0 +lon_0={longitude_deg!r} {radius}"
        return Placement(_on_the_moon(crs, called), 0.0, MOON_RADIUS_M * latitude)
    hemisphere = math.copysign(1.0, middle)
    scale = (1.0 + math.sin(min(abs(middle), math.pi / 2))) / 2.0  # of the pole, for a scale of 1 at the middle
    corner = -hemisphere * scale * 2.0 * MOON_RADIUS_M * math.tan(math.pi / 4 - hemisphere * latitude / 2)
    crs = f"+proj=stere +lat_0={90.0 * hemisphere:.0f} +lon_0={longitude_deg!r} +k_0={scale!r} +x_0=0 +y_0=0 {radius}"
    return Placement(_on_the_moon(crs, called), 0.0, corner)


def _on_the_moon(given: str, name: str) -> Any:
    """That projection on the geographic system of IAU 2015, where it is on the sphere of the same radius."""
    library = pyproj()
    transformer(given, GEOGRAPHIC)  # refuses what PROJ does not know
    crs, moon = library.CRS.from_user_input(given), library.CRS.from_user_input(GEOGRAPHIC)
    own_authority = crs.to_authority(min_confidence=100)
    radii = crs.ellipsoid.semi_major_metre, crs.ellipsoid.semi_minor_metre
    if own_authority is not None or not crs.is_projected or radii != (MOON_RADIUS_M, MOON_RADIUS_M):
        return crs
    return library.crs.ProjectedCRS(conversion=crs.coordinate_operation, geodetic_crs=moon, name=name)

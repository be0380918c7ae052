"""Places of the site on the Moon: latitude and longitude, and the frame that turns with the Moon in the site's frame.

Latitudes and longitudes are planetocentric, east positive, on the sphere of 1737.4 km (IAU_2015:30100). The site's
plane is taken for the projection in which regions are made: equirectangular, true to scale at the latitude of the
site's middle, up to 65 deg; beyond, polar stereographic, true to scale there, about the meridian of the south-west
corner (Snyder 1987, USGS Professional Paper 1395, sections 12 and 21). A region that has another projection differs
from it by what the two projections differ over its size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from he3.constants import MOON_RADIUS_M
from he3.frames import Place

POLAR_DEG: Final = 65.0  # latitude of a site's middle beyond which its plane is polar stereographic

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""x, y, z, w."""


@dataclass(frozen=True, slots=True)
class Site:
    """A site with a place on the Moon."""

    latitude_deg: float
    """Of the south-west corner, as the longitude."""
    longitude_deg: float
    height_m: float
    """Extent northward."""

    def degrees(self, place_m: Place) -> tuple[float, float]:
        """Latitude and longitude [deg] of a place (x, y) [m] of the site."""
        x, y = place_m
        latitude = math.radians(self.latitude_deg)
        middle = latitude + self.height_m / 2 / MOON_RADIUS_M
        if abs(math.degrees(middle)) <= POLAR_DEG:
            east = math.degrees(x / (MOON_RADIUS_M * math.cos(middle)))
            return math.degrees(latitude + y / MOON_RADIUS_M), _turned(self.longitude_deg + east)
        hemisphere = math.copysign(1.0, middle)
        scale = (1.0 + math.sin(min(abs(middle), math.pi / 2))) / 2.0  # of the pole, for a scale of 1 at the middle
        corner = 2.0 * scale * MOON_RADIUS_M * math.tan(math.pi / 4 - hemisphere * latitude / 2)
        south = corner - hemisphere * y  # distance from the pole along the central meridian
        rho = math.hypot(x, south)
        found = hemisphere * (math.pi / 2 - 2.0 * math.atan(rho / (2.0 * scale * MOON_RADIUS_M)))
        return math.degrees(found), _turned(self.longitude_deg + math.degrees(math.atan2(x, south)))

    @property
    def moon_centre_m(self) -> Vector:
        """The Moon's centre in the site's frame [m]: straight below the south-west corner."""
        return 0.0, 0.0, -MOON_RADIUS_M

    @property
    def moon_turn(self) -> Quaternion:
        """The rotation of the Moon's axes (x towards (0, 0), z towards the north pole) in the site's frame.

        East, north and up of the corner follow from the Moon's axes by a turn of 90 deg + longitude about z, and then
        of 90 deg - latitude about the new x; this is the inverse.
        """
        about_z = math.radians(self.longitude_deg + 90.0) / 2
        about_x = math.radians(90.0 - self.latitude_deg) / 2
        cz, sz, cx, sx = math.cos(about_z), math.sin(about_z), math.cos(about_x), math.sin(about_x)
        return -cz * sx, -sz * sx, -sz * cx, cz * cx


def _turned(longitude_deg: float) -> float:
    """The longitude within -180 to 180."""
    return (longitude_deg + 180.0) % 360.0 - 180.0

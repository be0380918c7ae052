"""The size of a raster's pixels on the ground, whatever its projection, its unit of length and its rotation."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

from he3.errors import InvalidInput
from services.mission.region_build.geo import pyproj

MOST_OBLONG: Final = 1.1  # 1, longer over shorter side of pixels that are taken as squares


def ground_pixel_m(path: Path, raster: Any) -> float:
    """Side of a pixel [m] in the middle of an open raster: the square root of its area. 1 if the file does not say it.

    Lengths are those on the ellipsoid of the raster's reference system, without the distortion of a projection. Raises
    InvalidInput for pixels that are no squares there, within 10 %, or whose axes are not perpendicular.
    """
    if raster.crs is None and raster.transform.is_identity:
        return 1.0
    middle = raster.width / 2, raster.height / 2
    a, b, c, d, e, f, *_ = raster.transform
    corners = [(middle[0] + right, middle[1] + down) for right, down in ((0, 0), (1, 0), (0, 1))]
    here, beside, below = ((a * x + b * y + c, d * x + e * y + f) for x, y in corners)
    if raster.crs is None:
        width, height, diagonal = math.dist(here, beside), math.dist(here, below), math.dist(beside, below)
    else:
        crs = pyproj().CRS.from_user_input(raster.crs.to_wkt())
        to_degrees = pyproj().Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
        places = [to_degrees.transform(*place) for place in (here, beside, below)]
        geodesic = crs.get_geod()
        width, height, diagonal = (
            geodesic.inv(*places[one], *places[other])[2] for one, other in ((0, 1), (0, 2), (1, 2))
        )
    sides = sorted((width, height))
    if not (sides[0] > 0.0 and math.isfinite(diagonal)):
        raise InvalidInput(f"{path}: expected pixels that lie on the ground, got {width:g} x {height:g} m")
    if sides[1] > MOST_OBLONG * sides[0] or abs(diagonal / math.hypot(*sides) - 1.0) > MOST_OBLONG - 1.0:
        raise InvalidInput(
            f"{path}: expected square pixels on the ground, got {width:.4g} x {height:.4g} m in its middle: warp "
            "it to a projection that is true to scale there"
        )
    return math.sqrt(width * height)

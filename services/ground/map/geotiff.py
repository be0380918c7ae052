"""Where on the Moon a raster lies, as GeoTIFF tags (OGC 19-008r4) in IAU_2015:30110.

That is the equirectangular projection of the lunar sphere about (0, 0): X = R lon, Y = R lat. Its X stretches with
latitude: a metre on the ground is 1 / cos(lat) of it, and so the cells of a site are not square there.
"""

from __future__ import annotations

import math
from typing import Final

from he3.constants import MOON_RADIUS_M

MODEL_PIXEL_SCALE, MODEL_TIE_POINT, GEO_KEYS, GEO_DOUBLES, GEO_TEXT = 33550, 33922, 34735, 34736, 34737

_PROJECTED: Final = "Moon (2015) - Sphere / Ocentric / Equirectangular, clon = 0"
_GEOGRAPHIC: Final = "Moon (2015) - Sphere / Ocentric"
_SITE: Final = "site frame: metres east and north of the region's south-west corner"
_USER_DEFINED, _METRE, _DEGREE, _EQUIRECTANGULAR, _IN_DOUBLES, _IN_TEXT = 32767, 9001, 9102, 17, GEO_DOUBLES, GEO_TEXT

Tags = dict[int, tuple[str, tuple[float, ...] | tuple[int, ...] | str]]


def tags(
    origin_deg: tuple[float, float] | None, height_m: float, west_m: float, north_m: float, resolution_m: float
) -> Tags:
    """Tag -> (kind, values) of a raster whose north-west corner is (west_m, north_m) in the site frame.

    kind: 'double', 'short' or 'ascii'. height_m: of the whole site, at whose middle a degree of longitude is measured.
    Without an origin the raster is placed in the site frame itself.
    """
    if origin_deg is None:
        return {
            MODEL_PIXEL_SCALE: ("double", (resolution_m, resolution_m, 0.0)),
            MODEL_TIE_POINT: ("double", (0.0, 0.0, 0.0, west_m, north_m, 0.0)),
            **_keys([(1024, _USER_DEFINED), (1025, 1), (1026, _SITE), (3076, _METRE)]),
        }
    lat, lon = origin_deg
    stretch = 1.0 / math.cos(math.radians(lat) + height_m / 2 / MOON_RADIUS_M)
    x = MOON_RADIUS_M * math.radians(lon) + west_m * stretch
    y = MOON_RADIUS_M * math.radians(lat) + north_m
    return {
        MODEL_PIXEL_SCALE: ("double", (resolution_m * stretch, resolution_m, 0.0)),
        MODEL_TIE_POINT: ("double", (0.0, 0.0, 0.0, x, y, 0.0)),
        **_keys(
            [
                (1024, 1),  # projected
                (1025, 1),  # a pixel is an area
                (1026, f"{_PROJECTED} (IAU_2015:30110)"),
                (2048, _USER_DEFINED),
                (2049, _GEOGRAPHIC),
                (2050, _USER_DEFINED),
                (2054, _DEGREE),
                (2056, _USER_DEFINED),
                (2057, MOON_RADIUS_M),
                (2058, MOON_RADIUS_M),
                (3072, _USER_DEFINED),
                (3073, _PROJECTED),
                (3074, _USER_DEFINED),
                (3075, _EQUIRECTANGULAR),
                (3076, _METRE),
                (3078, 0.0),  # standard parallel
                (3082, 0.0),  # false easting
                (3083, 0.0),  # false northing
                (3088, 0.0),  # central meridian
                (3089, 0.0),  # latitude of the centre
            ]
        ),
    }


def _keys(entries: list[tuple[int, int | float | str]]) -> Tags:
    directory: list[int] = [1, 1, 0, len(entries)]
    doubles: list[float] = []
    text = ""
    for key, value in entries:
        if isinstance(value, int):
            directory += [key, 0, 1, value]
        elif isinstance(value, float):
            directory += [key, _IN_DOUBLES, 1, len(doubles)]
            doubles.append(value)
        else:
            directory += [key, _IN_TEXT, len(value) + 1, len(text)]
            text += value + "|"
    found: Tags = {GEO_KEYS: ("short", tuple(directory)), GEO_TEXT: ("ascii", text)}
    if doubles:
        found[GEO_DOUBLES] = ("double", tuple(doubles))
    return found

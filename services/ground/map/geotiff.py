"""Where on the Moon a raster lies, as GeoTIFF tags (OGC 19-008r4) on the lunar sphere of IAU 2015.

It is for the quick download of a layer alone, which the ground answers without an extra; `services.console.map_export`
writes the files for other tools, with GDAL. The tests hold both to the same places.

Up to 65 deg of latitude the raster is in IAU_2015:30110, the equirectangular projection about (0, 0): X = R lon,
Y = R lat. Its X stretches with latitude: a metre on the ground is 1 / cos(lat) of it, and so the cells of a site are
not square there.

Beyond 65 deg, as in the lunar maps of the USGS, it is in a polar stereographic projection, true to scale at the pole.
Its central meridian is that of the site's south-west corner, so that the site's north is the raster's. A place lies
rho = 2 R tan(45 deg - |lat| / 2) from the pole, and a metre on the ground is 2 / (1 + sin |lat|) of the projection's
(Snyder 1987, USGS Professional Paper 1395, section 21, on the sphere with k0 = 1).
"""

from __future__ import annotations

import math
from typing import Final

from he3.constants import MOON_RADIUS_M

MODEL_PIXEL_SCALE, MODEL_TIE_POINT, GEO_KEYS, GEO_DOUBLES, GEO_TEXT = 33550, 33922, 34735, 34736, 34737

POLAR_DEG: Final = 65.0  # latitude of a site's middle beyond which its raster is polar stereographic

_PROJECTED: Final = "Moon (2015) - Sphere / Ocentric / Equirectangular, clon = 0"
_POLAR: Final = "Moon (2015) - Sphere / Ocentric / {} Polar, clon = {:.10g}"
_GEOGRAPHIC: Final = "Moon (2015) - Sphere / Ocentric"
_SITE: Final = "site frame: metres east and north of the region's south-west corner"
_USER_DEFINED, _METRE, _DEGREE, _IN_DOUBLES, _IN_TEXT = 32767, 9001, 9102, GEO_DOUBLES, GEO_TEXT
_POLAR_STEREOGRAPHIC, _EQUIRECTANGULAR = 15, 17

Tags = dict[int, tuple[str, tuple[float, ...] | tuple[int, ...] | str]]
_Entries = list[tuple[int, int | float | str]]


def tags(
    origin_deg: tuple[float, float] | None, height_m: float, west_m: float, north_m: float, resolution_m: float
) -> Tags:
    """Tag -> (kind, values) of a raster whose north-west corner is (west_m, north_m) in the site frame.

    kind: 'double', 'short' or 'ascii'. height_m: of the whole site, at whose middle the projection's scale is taken.
    Without an origin the raster is placed in the site frame itself.
    """
    if origin_deg is None:
        return {
            MODEL_PIXEL_SCALE: ("double", (resolution_m, resolution_m, 0.0)),
            MODEL_TIE_POINT: ("double", (0.0, 0.0, 0.0, west_m, north_m, 0.0)),
            **_keys([(1024, _USER_DEFINED), (1025, 1), (1026, _SITE), (3076, _METRE)]),
        }
    lat, lon = map(math.radians, origin_deg)
    middle = lat + height_m / 2 / MOON_RADIUS_M
    if abs(math.degrees(middle)) > POLAR_DEG:
        return _polar(lat, lon, middle, west_m, north_m, resolution_m)
    stretch = 1.0 / math.cos(middle)
    x = MOON_RADIUS_M * lon + west_m * stretch
    y = MOON_RADIUS_M * lat + north_m
    projection: _Entries = [
        (3075, _EQUIRECTANGULAR),
        (3076, _METRE),
        (3078, 0.0),  # standard parallel
        (3082, 0.0),  # false easting
        (3083, 0.0),  # false northing
        (3088, 0.0),  # central meridian
        (3089, 0.0),  # latitude of the centre
    ]
    return {
        MODEL_PIXEL_SCALE: ("double", (resolution_m * stretch, resolution_m, 0.0)),
        MODEL_TIE_POINT: ("double", (0.0, 0.0, 0.0, x, y, 0.0)),
        **_projected(f"{_PROJECTED} (IAU_2015:30110)", _PROJECTED, projection),
    }


def _polar(lat: float, lon: float, middle: float, west_m: float, north_m: float, resolution_m: float) -> Tags:
    """Tags in the polar stereographic projection; latitude and longitude of the corner, and of the middle [rad]."""
    hemisphere = math.copysign(1.0, middle)
    # A site over the pole lies on both sides of it; the scale is 1 there.
    scale = 2.0 / (1.0 + math.sin(min(abs(middle), math.pi / 2)))
    # On the central meridian north leads towards the north pole, away from the south pole.
    corner = -hemisphere * 2.0 * MOON_RADIUS_M * math.tan(math.pi / 4 - hemisphere * lat / 2)
    name = _POLAR.format("North" if hemisphere > 0 else "South", math.degrees(lon))
    projection: _Entries = [
        (3075, _POLAR_STEREOGRAPHIC),
        (3076, _METRE),
        (3081, 90.0 * hemisphere),  # latitude of the natural origin
        (3082, 0.0),  # false easting
        (3083, 0.0),  # false northing
        (3092, 1.0),  # scale at the natural origin
        (3095, math.degrees(lon)),  # straight vertical longitude from the pole
    ]
    return {
        MODEL_PIXEL_SCALE: ("double", (resolution_m * scale, resolution_m * scale, 0.0)),
        MODEL_TIE_POINT: ("double", (0.0, 0.0, 0.0, west_m * scale, corner + north_m * scale, 0.0)),
        **_projected(name, name, projection),
    }


def _projected(citation: str, name: str, projection: _Entries) -> Tags:
    """The keys of that projection of the lunar sphere, whose own entries begin with its method."""
    return _keys(
        [
            (1024, 1),  # projected
            (1025, 1),  # a pixel is an area
            (1026, citation),
            (2048, _USER_DEFINED),
            (2049, _GEOGRAPHIC),
            (2050, _USER_DEFINED),
            (2054, _DEGREE),
            (2056, _USER_DEFINED),
            (2057, MOON_RADIUS_M),
            (2058, MOON_RADIUS_M),
            (3072, _USER_DEFINED),
            (3073, name),
            (3074, _USER_DEFINED),
            *projection,
        ]
    )


def _keys(entries: _Entries) -> Tags:
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

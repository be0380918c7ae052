"""Fields of Foxglove's messages, as `schemas.encoded` takes them: times, poses, colours, lines, grids, clouds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from he3.colour_maps import table
from services.mission.mission_time import SECOND

if TYPE_CHECKING:
    from he3.frames import Place
    from services.mission.mission_time import MissionTime

Fields = dict[str, Any]
Colour = tuple[float, float, float, float]
"""Red, green, blue, opacity: 0 to 1."""

SITE: Final = "site"
"""The site frame: x east, y north, z up, metres from the region's south-west corner."""
UNTURNED: Final[Fields] = {"w": 1.0}
LINE_STRIP, LINE_LOOP = 0, 1
UINT8, FLOAT32 = 1, 7

WHITE: Final[Colour] = (1.0, 1.0, 1.0, 1.0)


def timestamp(time: MissionTime) -> Fields:
    """A mission time [ns]."""
    return {"seconds": time // SECOND, "nanos": time % SECOND}


def pose(place_m: Place = (0.0, 0.0), up_m: float = 0.0, turn: Fields = UNTURNED) -> Fields:
    """A place of the site, so high over its plane."""
    return {"position": {"x": place_m[0], "y": place_m[1], "z": up_m}, "orientation": turn}


def heading(heading_deg: float) -> Fields:
    """The rotation whose x axis points to that heading, clockwise from north."""
    half = math.radians(90.0 - heading_deg) / 2
    return {"z": math.sin(half), "w": math.cos(half)}


def colour(value: Colour) -> Fields:
    """The colour."""
    return dict(zip("rgba", value, strict=True))


def shade(value: float, low: float, high: float, name: str) -> Colour:
    """The colour of a value in that colour map, whose ends are `low` and `high`."""
    share = (value - low) / (high - low) if high > low else 0.5
    red, green, blue = table(name)[round(255 * min(max(share, 0.0), 1.0))]
    return float(red) / 255, float(green) / 255, float(blue) / 255, 1.0


def entity(name: str, made_at: MissionTime, about: Mapping[str, object] | None = None, **primitives: Any) -> Fields:
    """A thing in the site's scene, which replaces an earlier one of that name. about: facts on it, for a reader."""
    metadata = [{"key": key, "value": str(value)} for key, value in (about or {}).items()]
    return {"timestamp": timestamp(made_at), "frame_id": SITE, "id": name, "metadata": metadata, **primitives}


def line(places_m: Iterable[Place], up_m: float, shown: Colour, thickness_m: float, kind: int = LINE_STRIP) -> Fields:
    """A line through those places; its thickness is in metres of the site."""
    return {
        "type": kind,
        "pose": pose(),
        "thickness": thickness_m,
        "points": [{"x": x, "y": y, "z": up_m} for x, y in places_m],
        "color": colour(shown),
    }


def sphere(place_m: Place, diameter_m: float, shown: Colour) -> Fields:
    """A ball on the plane."""
    size = {"x": diameter_m, "y": diameter_m, "z": diameter_m}
    return {"pose": pose(place_m, diameter_m / 2), "size": size, "color": colour(shown)}


def text(words: str, place_m: Place, up_m: float, shown: Colour) -> Fields:
    """Words that face the viewer, in a size that does not depend on the distance."""
    return {
        "pose": pose(place_m, up_m), "billboard": True, "font_size": 14.0, "scale_invariant": True,
        "color": colour(shown), "text": words,
    }  # fmt: skip


def grid(made_at: MissionTime, columns: int, cell_m: float, field: str, kind: int, values: bytes) -> Fields:
    """A layer of the map: `values` row by row from the south-west corner, of a field of that name and type."""
    size = 1 if kind == UINT8 else 4
    return {
        "timestamp": timestamp(made_at), "frame_id": SITE, "pose": pose(), "column_count": columns,
        "cell_size": {"x": cell_m, "y": cell_m}, "row_stride": columns * size, "cell_stride": size,
        "fields": [{"name": field, "offset": 0, "type": kind}], "data": values,
    }  # fmt: skip


def cloud(made_at: MissionTime, places_m: Sequence[Place], up_m: float, field: str, values: Sequence[float]) -> Fields:
    """Points with a value each, of a field of that name."""
    points = np.empty((len(places_m), 4), dtype="<f4")
    points[:, :2], points[:, 2], points[:, 3] = places_m, up_m, values
    names = ("x", "y", "z", field)
    return {
        "timestamp": timestamp(made_at), "frame_id": SITE, "pose": pose(), "point_stride": 16,
        "fields": [{"name": name, "offset": 4 * place, "type": FLOAT32} for place, name in enumerate(names)],
        "data": points.tobytes(),
    }  # fmt: skip

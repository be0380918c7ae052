"""Samples, paths and areas as tables with a geometry: GeoPackage, GeoJSON and CSV.

The GeoPackage is in the projection of the rasters, GeoJSON in longitude and latitude of the Moon. Both have the metres
of the site in their attributes.
"""

from __future__ import annotations

import csv
import io
import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from he3.errors import He3Error
from he3.frames import FloatArray, path_length
from services.mission.region_build.geo import pyogrio, pyproj

if TYPE_CHECKING:
    from he3.frames import Place
    from services.console.map_export.contents import MapContents
    from services.console.map_export.placement import Placement

Shape = Literal["Point", "LineString", "Polygon"]
JSON_CRS: Final = {"type": "name", "properties": {"name": "urn:ogc:def:crs:IAU_2015::30100"}}
"""Longitude and latitude of the Moon: without it a reader takes coordinates for those of the Earth."""
_CODES: Final[Mapping[Shape, int]] = {"Point": 1, "LineString": 2, "Polygon": 3}


@dataclass(frozen=True, slots=True, eq=False)
class FeatureTable:
    """Features of one kind. places_m: the corners of each, (N, 2) [m] in the site frame; polygons are not closed."""

    name: str
    shape: Shape
    places_m: Sequence[FloatArray]
    columns: Mapping[str, Sequence[Any]]
    """Attribute -> its value for each feature."""


def feature_tables(contents: MapContents, placement: Placement) -> list[FeatureTable]:
    """Samples, driven and planned path, keep-out areas, areas of interest, and the outline of the site."""
    grid, track = contents.grid, contents.track
    corners = [(0.0, 0.0), (grid.width_m, 0.0), (grid.width_m, grid.height_m), (0.0, grid.height_m)]
    tables = [_samples(contents, placement)]
    for name, path in (("driven_path", track.driven_path_m), ("planned_path", track.planned_path_m)):
        lines = [_points(path)] if len(path) > 1 else []
        tables.append(_with_metres(name, "LineString", lines, {"length_m": [path_length(line) for line in lines]}))
    keep_outs = [_points(area.polygon_m) for area in track.keep_outs]
    tables.append(_with_metres("keep_outs", "Polygon", keep_outs, {"area_id": [a.area_id for a in track.keep_outs]}))
    interests = [_points(area.polygon_m) for area in track.interests]
    columns: dict[str, list[Any]] = {
        "area_id": [a.area_id for a in track.interests],
        "weight": [a.weight for a in track.interests],
    }
    tables.append(_with_metres("interest_areas", "Polygon", interests, columns))
    site: dict[str, list[Any]] = {"region": [contents.region.title], "provenance": [contents.region.provenance],
            "revision": [contents.revision]}  # fmt: skip
    tables.append(_with_metres("site", "Polygon", [_points(corners)], site))
    return tables


def _samples(contents: MapContents, placement: Placement) -> FeatureTable:
    samples = contents.track.samples
    places = _points([(sample.x_m, sample.y_m) for sample in samples])
    degrees = placement.degrees(places)
    where = {} if degrees is None else {"lon_deg": degrees[:, 0].tolist(), "lat_deg": degrees[:, 1].tolist()}
    columns: dict[str, list[Any]] = {
        "sample_id": [s.sample_id for s in samples],
        "round": [s.round for s in samples],
        **where,
        "x_m": [s.x_m for s in samples],
        "y_m": [s.y_m for s in samples],
        "depth_m": [s.depth_m for s in samples],
        "helium3_ppb": [s.helium3_ppb for s in samples],
        "noise_std_ppb": [s.noise_std_ppb for s in samples],
        "measured_at": [utc(s.measured_at) for s in samples],
        "measured_at_ns": [s.measured_at for s in samples],
        "driven_m": [s.driven_m for s in samples],
    }
    return FeatureTable("samples", "Point", [place[None, :] for place in places], columns)


def _with_metres(
    name: str, shape: Shape, places_m: Sequence[FloatArray], columns: Mapping[str, Sequence[Any]]
) -> FeatureTable:
    """A table whose attribute `site_m` has the corners in the site frame, as 'x y, x y, ...'."""
    metres = [", ".join(f"{x:.10g} {y:.10g}" for x, y in places) for places in places_m]
    return FeatureTable(name, shape, places_m, {**columns, "site_m": metres})


def write_geopackage(path: Path, tables: Sequence[FeatureTable], placement: Placement) -> None:
    """Write a GeoPackage with a layer a table, in the projection of the rasters."""
    library = pyogrio()
    for number, table in enumerate(tables):
        shapes = [_wkb(table.shape, placement.projected(places)) for places in table.places_m]
        try:
            library.raw.write(
                str(path), geometry=np.array(shapes, dtype=object),
                field_data=[_column(values, name) for name, values in table.columns.items()],
                fields=list(table.columns), geometry_type=table.shape, crs=_crs(placement), layer=table.name,
                driver="GPKG", append=number > 0,
            )  # fmt: skip
        except (library.errors.DataSourceError, library.errors.DataLayerError, library.errors.FeatureError) as error:
            raise He3Error(f"{path}: cannot write the layer {table.name}: {error}") from None


def geojson(table: FeatureTable, placement: Placement) -> str | None:
    """The table as GeoJSON in longitude and latitude of the Moon; None for a site without a place."""
    features = []
    for index, places in enumerate(table.places_m):
        degrees = placement.degrees(places)
        if degrees is None:
            return None
        properties = {name: values[index] for name, values in table.columns.items()}
        geometry = {"type": table.shape, "coordinates": _coordinates(table.shape, degrees)}
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    if placement.crs is None:
        return None
    document = {"type": "FeatureCollection", "name": table.name, "crs": JSON_CRS, "features": features}
    return json.dumps(document, ensure_ascii=False, allow_nan=False)


def as_csv(table: FeatureTable) -> str:
    """The attributes of the table, a line a feature."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows(zip(*table.columns.values(), strict=True))
    return stream.getvalue()


def utc(time_ns: int) -> str:
    """A mission time, as 2030-01-01T06:00:00.123Z; the rest of its nanoseconds is cut off."""
    return f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%Y-%m-%dT%H:%M:%S}.{time_ns // 10**6 % 1000:03}Z"


def _points(places: Sequence[Place]) -> FloatArray:
    return np.array(places, dtype=np.float64).reshape(-1, 2)


def _crs(placement: Placement) -> str:
    """The projection as text, without its code: OGR holds a code's axes for those of another system."""
    if placement.crs is None:
        return placement.wkt
    document = placement.crs.to_json_dict()
    document.pop("id", None)
    return str(pyproj().CRS.from_json_dict(document).to_wkt())


def _column(values: Sequence[Any], name: str) -> Any:
    if not values:
        return np.array([], dtype=_EMPTY.get(name.rsplit("_", 1)[-1], object))
    return np.array(values, dtype=object if isinstance(values[0], str) else None)


_EMPTY: Final[Mapping[str, type]] = {"m": np.float64, "ppb": np.float64, "deg": np.float64, "ns": np.int64,
                                     "round": np.int64, "weight": np.float64}  # fmt: skip
"""Type of a column without values, by the end of its name."""


def _wkb(shape: Shape, points: FloatArray) -> bytes:
    """Well-known binary, little-endian (OGC 06-103r4, section 8)."""
    head = struct.pack("<BI", 1, _CODES[shape])
    if shape == "Point":
        return head + points.astype("<f8").tobytes()
    if shape == "Polygon":
        points = np.vstack((points, points[:1]))
        head += struct.pack("<I", 1)
    return head + struct.pack("<I", len(points)) + points.astype("<f8").tobytes()


def _coordinates(shape: Shape, points: FloatArray) -> Any:
    if shape == "Point":
        return points[0].tolist()
    return points.tolist() if shape == "LineString" else [[*points.tolist(), points[0].tolist()]]

"""The STAC item of an export: what its files are, where they lie, and where each layer comes from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from services.console.map_export.contents import SIMULATION_ONLY
from services.console.map_export.rasters import NO_DATA, statistics
from services.mission.region_build.geo import pystac
from services.mission.region_build.projection import POLAR_DEG, transformer

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from services.console.map_export.contents import MapContents, RasterLayer
    from services.console.map_export.placement import Placement

EXTENSIONS: Final = (
    "https://stac-extensions.github.io/projection/v2.0.0/schema.json",
    "https://stac-extensions.github.io/file/v2.1.0/schema.json",
    "https://stac-extensions.github.io/ssys/v1.1.1/schema.json",
)
MEDIA_TYPES: Final = {
    ".tif": "image/tiff; application=geotiff; profile=cloud-optimized", ".qml": "application/xml",
    ".gpkg": "application/geopackage+sqlite3", ".geojson": "application/geo+json", ".csv": "text/csv",
    ".xml": "application/xml",
}  # fmt: skip
_PLAIN_TIFF: Final = "image/tiff; application=geotiff"
_EDGE_PLACES: Final = 9  # a side, so that the outline follows the parallels
_SHA256: Final = "1220"  # prefix of a SHA-256 as a multihash


@dataclass(frozen=True, slots=True)
class Asset:
    """One file of the export, relative to its folder."""

    file: str
    title: str
    role: str
    """data, style or metadata."""
    layer: RasterLayer | None = None


def stac_item(contents: MapContents, placement: Placement, folder: Path, assets: Sequence[Asset]) -> str:
    """The STAC item of the files in that folder, as JSON."""
    library = pystac()
    moment = datetime.fromtimestamp(contents.mission_time_ns / 1e9, UTC)
    geometry, bbox = footprint(contents, placement)
    item = library.Item(
        id=f"{contents.mission}-{contents.revision}", geometry=geometry, bbox=bbox, datetime=moment,
        properties=_properties(contents, placement), stac_extensions=list(EXTENSIONS),
    )  # fmt: skip
    for asset in assets:
        path = folder / asset.file
        suffix = path.suffix
        media = _PLAIN_TIFF if asset.file.startswith("pds4/") and suffix == ".tif" else MEDIA_TYPES[suffix]
        fields = {"file:size": path.stat().st_size, "file:checksum": _SHA256 + _sha256(path)}
        if asset.layer is not None:
            fields |= _of_layer(asset.layer)
        key = asset.file.replace("/", "-").replace(".", "-")
        item.add_asset(
            key,
            library.Asset(f"./{asset.file}", asset.title, media_type=media, roles=[asset.role], extra_fields=fields),
        )
    return json.dumps(item.to_dict(include_self_link=False), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def footprint(contents: MapContents, placement: Placement) -> tuple[dict[str, Any] | None, list[float] | None]:
    """The outline of the site in longitude and latitude, and its bounding box; None for a site without a place.

    The box of a site across the antimeridian begins east of where it ends (RFC 7946, 5.2). A site that holds a pole has
    all longitudes.
    """
    grid = contents.grid
    share = np.linspace(0.0, 1.0, _EDGE_PLACES)[:-1]
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)])
    edge = np.vstack([a + share[:, None] * (b - a) for a, b in pairwise(corners)])
    degrees = placement.degrees(edge * (grid.width_m, grid.height_m))
    if degrees is None:
        return None, None
    (west, south), (east, north) = degrees.min(axis=0), degrees.max(axis=0)
    pole = _pole_inside(contents, placement, degrees)
    if pole is not None:
        west, east, south, north = -180.0, 180.0, min(south, pole), max(north, pole)
        ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
        return {"type": "Polygon", "coordinates": [ring]}, [west, float(south), east, float(north)]
    ring = [*degrees.tolist(), degrees[0].tolist()]
    box = [_turned(float(west)), float(south), _turned(float(east)), float(north)]
    return {"type": "Polygon", "coordinates": [ring]}, box


def _properties(contents: MapContents, placement: Placement) -> dict[str, Any]:
    grid, region = contents.grid, contents.region
    what = f"Helium-3 map of mission '{contents.mission}'"
    found: dict[str, Any] = {
        "title": f"{what}, revision {contents.revision}",
        "description": f"{what} in region '{region.title}', from {len(contents.track.samples)} samples. "
        f"{_measurements(contents)} {region.provenance}",
        "gsd": grid.resolution_m, "ssys:targets": ["Moon"], "ssys:target_class": "satellite",
        "proj:code": None, "proj:shape": list(grid.shape),
        "proj:transform": [grid.resolution_m, 0.0, placement.x_m, 0.0, -grid.resolution_m,
                           placement.y_m + grid.height_m],
        "proj:bbox": [placement.x_m, placement.y_m, placement.x_m + grid.width_m, placement.y_m + grid.height_m],
        "he3:mission": contents.mission, "he3:revision": contents.revision, "he3:samples": len(contents.track.samples),
        "he3:mission_time_ns": contents.mission_time_ns, "he3:software": contents.software,
        "he3:simulated": contents.simulated, "he3:region": region.name, "he3:region_provenance": region.provenance,
        "he3:region_layers": [layer.model_dump(exclude_defaults=True) for layer in region.layers],
        "he3:frame": placement.name, "he3:notes": list(contents.notes),
    }  # fmt: skip
    if placement.crs is not None:
        found |= {"proj:wkt2": placement.wkt, "proj:projjson": json.loads(placement.crs.to_json())}
    return found


def _measurements(contents: MapContents) -> str:
    return "All measurements are simulated." if contents.simulated else "The mission has no reference field."


def _of_layer(layer: RasterLayer) -> dict[str, Any]:
    band: dict[str, Any] = {
        "name": layer.name, "description": layer.title, "data_type": layer.values.dtype.name, "unit": layer.unit,
        "statistics": statistics(layer),
    }  # fmt: skip
    if not layer.classes:
        band["nodata"] = NO_DATA
    found: dict[str, Any] = {"bands": [band], "he3:provenance": {"kind": layer.kind, "source": layer.source}}
    if layer.simulation_only:
        found["he3:label"] = SIMULATION_ONLY
    return found


def _pole_inside(contents: MapContents, placement: Placement, outline_deg: FloatArray) -> float | None:
    """Latitude of the pole that lies in the site; None if there is none."""
    if np.abs(outline_deg[:, 1]).max() < POLAR_DEG:
        return None
    pole = float(np.copysign(90.0, outline_deg[0, 1]))
    x, y = transformer("IAU_2015:30100", placement.crs).transform(placement.middle_deg, pole)
    grid = contents.grid
    inside = 0.0 <= x - placement.x_m <= grid.width_m and 0.0 <= y - placement.y_m <= grid.height_m
    return pole if inside else None


def _turned(longitude_deg: float) -> float:
    """The longitude within -180 to 180."""
    return longitude_deg if -180.0 <= longitude_deg <= 180.0 else (longitude_deg + 180.0) % 360.0 - 180.0


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def tags_of(contents: MapContents, layer: RasterLayer) -> Mapping[str, str]:
    """The metadata of a layer's raster: what it is, where it comes from, and of which map it is a part."""
    region = contents.region
    found = {
        "TIFFTAG_IMAGEDESCRIPTION": f"{layer.title} [{layer.unit}], mission '{contents.mission}', "
        f"revision {contents.revision}, {len(contents.track.samples)} samples",
        "TIFFTAG_SOFTWARE": f"he3-seeker {contents.software}",
        "MISSION": contents.mission, "REVISION": str(contents.revision), "SAMPLES": str(len(contents.track.samples)),
        "MISSION_TIME": datetime.fromtimestamp(contents.mission_time_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "MEASUREMENTS": _measurements(contents), "REGION": region.title, "REGION_PROVENANCE": region.provenance,
        "PROVENANCE_KIND": layer.kind, "PROVENANCE": layer.source,
    }  # fmt: skip
    found |= {f"REGION_LAYER_{each.layer.upper()}": f"{each.kind}: {each.source}" for each in region.layers}
    if layer.simulation_only:
        found["LABEL"] = SIMULATION_ONLY
    return found

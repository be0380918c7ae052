"""Rasters with PDS4 labels: an uncompressed GeoTIFF, as the standard asks for, and its label, both made by GDAL."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.sax.saxutils import escape

from he3.errors import He3Error
from services.console.map_export.rasters import opened
from services.mission.region_build.geo import rasterio

if TYPE_CHECKING:
    from services.console.map_export.contents import MapContents, RasterLayer
    from services.console.map_export.placement import Placement

BUNDLE: Final = "urn:nasa:pds:he3_seeker"
"""Beginning of the logical identifiers. An archive gives its own bundle a name; this one stands for it until then."""

_TARGET: Final = {"TARGET": "Moon", "TARGET_TYPE": "Satellite"}


def write_pds4(
    folder: Path, contents: MapContents, layer: RasterLayer, placement: Placement, tags: Mapping[str, str]
) -> tuple[str, str]:
    """Write the label and the raster of a layer into the folder, and return the names of both files."""
    library = rasterio()
    label, raster = folder / f"{layer.name}.xml", folder / f"{layer.name}.tif"
    mission = contents.mission
    facts = {
        "LOGICAL_IDENTIFIER": f"{BUNDLE}:maps:{mission}_{contents.revision}_{layer.name}",
        "TITLE": f"{layer.title}, mission {mission}, revision {contents.revision}; {layer.kind}: {layer.source}",
        "INVESTIGATION_AREA_NAME": f"he3-seeker mission {mission}",
        "INVESTIGATION_AREA_LID_REFERENCE": f"{BUNDLE}:investigation:{mission}",
        "OBSERVING_SYSTEM_NAME": "he3-seeker rover and ground station" + (", simulated" if contents.simulated else ""),
    }  # fmt: skip
    # rasterio passes options on in capitals, so the texts are put into the label afterwards.
    holders = {f"VAR_{name}": f"@{name}@" for name in facts}
    holders |= {f"VAR_{name}": fact.upper() for name, fact in _TARGET.items()}  # GDAL makes an identifier of them
    try:
        with opened(layer, placement, contents.grid, tags) as source:
            library.shutil.copy(source, str(label), driver="PDS4", IMAGE_FORMAT="GEOTIFF", **holders)
    except library.errors.RasterioError as error:
        raise He3Error(f"{label}: cannot write the label: {error}") from None
    text = label.read_text(encoding="utf-8")
    for fact in _TARGET.values():
        text = text.replace(f">{fact.upper()}<", f">{fact}<")
    for name, fact in facts.items():
        text = text.replace(f"@{name}@", escape(fact))
    label.write_text(text, encoding="utf-8")
    return label.name, raster.name

"""The folder of an export: all files are written beside it first, and take their places when all are there."""

from __future__ import annotations

import json
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from he3.errors import InvalidInput
from services.console.map_export.catalogue import Asset, stac_item, tags_of
from services.console.map_export.pds4 import write_pds4
from services.console.map_export.placement import placed
from services.console.map_export.rasters import geotiff
from services.console.map_export.styles import qgis_style
from services.console.map_export.vectors import as_csv, feature_tables, geojson, write_geopackage
from services.mission.region_build.geo import pyogrio, pyproj, pystac, rasterio
from services.runtime.files.lock import FileLock
from services.runtime.files.output import failed, write_output

if TYPE_CHECKING:
    from services.console.map_export.contents import MapContents
    from services.console.map_export.placement import Placement

ITEM: Final = "item.json"
"""The STAC item, which names all other files."""
GEOPACKAGE: Final = "map.gpkg"
NO_PLACE: Final = (
    "the region has no place on the Moon: rasters and GeoPackage are in metres of the site, without GeoJSON"
)
_LOCK: Final = ".lock"
_OWN: Final = re.compile(r"(pds4/)?[a-z0-9_]+\.(tif|qml|gpkg|geojson|csv|xml)")
"""Names of the files of an export."""

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written."""

    folder: Path
    files: tuple[str, ...]
    """Names in the folder; the last one is the STAC item."""
    revision: int
    samples: int
    frame: str
    """Name of the projection, or that it is the site frame."""
    notes: tuple[str, ...]
    """One line on each part that is left out."""


class ExportFolder:
    """A folder that this process alone exports to."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def write(self, contents: MapContents, *, pds4: bool = False, progress: Progress = lambda line: None) -> Exported:
        """Write the map in place of an earlier one. pds4: rasters with PDS4 labels as well.

        Raises He3Error, in one line, if that fails; an earlier export is then as it was.
        """
        placement = placed(contents.region)
        scratch = self.folder / f".export-{secrets.token_hex(8)}"
        try:
            scratch.mkdir()
            assets = _write_files(contents, placement, scratch, pds4, progress)
            (scratch / ITEM).write_text(stac_item(contents, placement, scratch, assets), encoding="utf-8")
            files = (*(asset.file for asset in assets), ITEM)
            self._put_in_place(scratch, files)
        except OSError as error:
            raise failed(f"{self.folder}: cannot write the map", error) from None
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
        notes = contents.notes if placement.crs is not None else (*contents.notes, NO_PLACE)
        samples = len(contents.track.samples)
        return Exported(self.folder, files, contents.revision, samples, placement.name, notes)

    def _put_in_place(self, scratch: Path, files: tuple[str, ...]) -> None:
        for name in earlier_files(self.folder):
            if name not in files:
                (self.folder / name).unlink(missing_ok=True)
        for name in files:  # the item comes last: what it names is there
            target = self.folder / name
            target.parent.mkdir(exist_ok=True)
            (scratch / name).replace(target)
            target.with_name(f"{target.name}.aux.xml").unlink(missing_ok=True)  # statistics that a reader has kept


@contextmanager
def export_folder(folder: Path) -> Iterator[ExportFolder]:
    """The folder, made and reserved for this process.

    Raises InvalidInput for a folder with other files than those of an earlier export or one in use, He3Error if it
    cannot be made, or if the extra ``geo`` is missing.
    """
    for library in (rasterio, pyproj, pyogrio, pystac):
        library()
    if folder.exists() and not folder.is_dir():
        raise InvalidInput(f"{folder}: expected a folder, got a file")
    try:
        others = sorted(each.name for each in folder.iterdir()) if folder.is_dir() else []
        others = [name for name in others if name != _LOCK and not name.startswith(".export-")]
        if others and _earlier_item(folder) is None:
            raise InvalidInput(
                f"{folder}: expected an empty folder or that of an earlier export, got one with {others[0]}"
            )
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise failed(f"{folder}: cannot make the folder", error) from None
    try:
        with FileLock(folder / _LOCK, f"{folder}: expected a folder that no other export writes to"):
            yield ExportFolder(folder)
    finally:
        with suppress(OSError):  # it holds an export, unless that was refused
            folder.rmdir()


def earlier_files(folder: Path) -> tuple[str, ...]:
    """Names of the files that an earlier export left in the folder, without its item."""
    item = _earlier_item(folder)
    hrefs = [] if item is None else [str(asset.get("href", "")) for asset in item["assets"].values()]
    names = (href.removeprefix("./") for href in hrefs)
    return tuple(name for name in names if _OWN.fullmatch(name))


def _earlier_item(folder: Path) -> dict[str, Any] | None:
    """The STAC item of an earlier export; None if there is none."""
    try:
        item: dict[str, Any] = json.loads((folder / ITEM).read_text(encoding="utf-8"))
        is_own = "he3:mission" in item["properties"] and all(isinstance(each, dict) for each in item["assets"].values())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return item if is_own else None


def _write_files(
    contents: MapContents, placement: Placement, scratch: Path, pds4: bool, progress: Progress
) -> list[Asset]:
    assets: list[Asset] = []
    for layer in contents.layers:
        progress(f"writing {layer.name}.tif")
        tags = tags_of(contents, layer)
        write_output(scratch / f"{layer.name}.tif", geotiff(layer, placement, contents.grid, tags))
        write_output(scratch / f"{layer.name}.qml", qgis_style(layer).encode())
        assets.append(Asset(f"{layer.name}.tif", layer.title, "data", layer))
        assets.append(Asset(f"{layer.name}.qml", f"QGIS style of {layer.name}.tif", "style"))
        if pds4:
            (scratch / "pds4").mkdir(exist_ok=True)
            label, raster = write_pds4(scratch / "pds4", contents, layer, placement, tags)
            assets.append(Asset(f"pds4/{label}", f"PDS4 label: {layer.title}", "metadata"))
            assets.append(Asset(f"pds4/{raster}", f"{layer.title}, for its PDS4 label", "data", layer))
    progress(f"writing {GEOPACKAGE}")
    tables = feature_tables(contents, placement)
    write_geopackage(scratch / GEOPACKAGE, tables, placement)
    assets.append(Asset(GEOPACKAGE, "Samples, paths and areas", "data"))
    for table in tables:
        text = geojson(table, placement)
        if text is not None:
            write_output(scratch / f"{table.name}.geojson", text.encode())
            assets.append(Asset(f"{table.name}.geojson", f"{table.name.replace('_', ' ')}", "data"))
    write_output(scratch / "samples.csv", as_csv(tables[0]).encode())
    assets.append(Asset("samples.csv", "Samples as a table", "data"))
    return assets

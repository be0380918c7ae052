"""Writing of a region's folder: GeoTIFFs that the core reads, and ``region.toml``."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from he3.errors import He3Error
from services.mission.region_build.geo import rasterio
from services.mission.region_folder import DOCUMENT, RegionDocument, checked

NO_DATA = -3.4028226550889045e38  # of float32 layers, as in the products of LROC


def write_folder(
    folder: Path,
    document: dict[str, Any],
    layers: Mapping[str, NDArray[Any]],
    crs: str,
    west_north: tuple[float, float],
    cell: float,
    descriptions: Mapping[str, str],
) -> RegionDocument:
    """Write a region's folder, and return its document.

    All is written beside the folder and moved into it at the end, the document last: without it there is no region. If
    something cannot be written, an earlier region stays as it is.

    layers: each (rows, columns), row 0 south. west_north: the outer north-west corner in the projection; cell: size of
    a cell there. ``document`` has a table of each layer without file and checksum, which are filled in.
    """
    tables = {name: dict(table) for name, table in document["layers"].items()}
    for name in layers:
        tables[name]["file"] = f"{name}.tif"
    checked(RegionDocument, {**document, "layers": tables}, folder / DOCUMENT)  # refused before anything is written
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as scratch:
            beside = Path(scratch)
            for name, values in layers.items():
                path = beside / f"{name}.tif"
                write_raster(path, values, crs, west_north, cell, descriptions.get(name, name))
                tables[name]["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
            complete = {**document, "layers": tables}
            (beside / DOCUMENT).write_text(to_toml(complete), encoding="utf-8")
            folder.mkdir(exist_ok=True)
            (folder / DOCUMENT).unlink(missing_ok=True)
            for file in (*(f"{name}.tif" for name in layers), DOCUMENT):
                (beside / file).replace(folder / file)
    except OSError as error:
        raise He3Error(f"{folder}: cannot write the region: {error.strerror or error}") from None
    return checked(RegionDocument, complete, folder / DOCUMENT)


def write_raster(
    path: Path, values: NDArray[Any], crs: str, west_north: tuple[float, float], cell: float, description: str
) -> None:
    """Write one layer (rows, columns), row 0 south, as a deflated GeoTIFF, north up; NaN is its no-data value."""
    library = rasterio()
    data = np.flipud(values)
    data = data.astype(np.uint8) if data.dtype == np.bool_ else data.astype(np.float32)
    if data.dtype == np.float32:  # readers of the GeoTIFF take its no-data value for missing, and NaN for a number
        data = np.where(np.isnan(data), np.float32(NO_DATA), data)
    west, north = west_north
    transform = library.Affine(cell, 0.0, west, 0.0, -cell, north)
    options: dict[str, Any] = {
        "driver": "GTiff", "height": data.shape[0], "width": data.shape[1], "count": 1, "dtype": data.dtype.name,
        "crs": library.crs.CRS.from_string(crs), "transform": transform,
        "compress": "deflate", "blockysize": min(64, data.shape[0]),
    }  # fmt: skip
    if data.dtype == np.float32:
        options["nodata"] = NO_DATA
    try:
        with library.open(path, "w", **options) as target:
            target.write(data, 1)
            target.set_band_description(1, description)
    except library.errors.RasterioError as error:
        raise He3Error(f"{path}: cannot write the raster: {error}") from None


def to_toml(document: Mapping[str, Any]) -> str:
    """A document of strings, numbers, booleans and tables as TOML."""
    return "\n".join(_lines(document, ())) + "\n"


def _lines(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    plain = {key: value for key, value in table.items() if value is not None and not isinstance(value, Mapping)}
    lines = [f"[{'.'.join(path)}]"] if path and plain else []
    lines += [f"{key} = {_value(value)}" for key, value in plain.items()]
    for key, value in table.items():
        if isinstance(value, Mapping):
            inner = _lines(value, (*path, key))
            lines += (["", *inner]) if inner else []
    return lines


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    return json.dumps(str(value), ensure_ascii=False)

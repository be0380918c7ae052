"""Loading of regions: embedded ones by name, others from a folder or an .npz file."""

from __future__ import annotations

import lzma
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from he3.constants import ELEVATION_MAX_M, ELEVATION_MIN_M, HELIUM3_LEAST_PPB, HELIUM3_MAX_PPB
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.nodata import cells_where, expect_measured, expect_no_walls, filled_with_nearest
from he3.reference import OrbitalWindow, Region, orbital_view, reference
from he3.terrain import slope_deg
from he3.vehicle_ground import VehicleLimits, judged
from schemas.maps import MAX_CELLS
from schemas.wire import MAX_POSITION_M
from services.mission.embedded_regions import EMBEDDED
from services.mission.npy import UNREADABLE
from services.mission.region_folder import (
    DOCUMENT,
    WINDOW_LAYERS,
    RegionDocument,
    folder_of,
    is_region_folder,
    read_document,
    read_layer,
)

ROCK_ABUNDANCE: Final = "rock_abundance"
MAX_FILE_BYTES: Final = 512 * 1024 * 1024
MAX_LATITUDE_DEG: Final = 90.0  # deg; beyond 65 deg a site lies in a polar projection, and may hold the pole
MAX_PROVENANCE: Final = 500  # characters
_LAYERS: Final = ("he3_ppb", "orbital_ppb", "elevation_m", "traversable", ROCK_ABUNDANCE)
_FURTHER: Final = ("resolution_m", "provenance", "origin_lat_deg", "origin_lon_deg")

_UNREADABLE: Final = (
    *UNREADABLE, zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, lzma.LZMAError, struct.error,
)  # fmt: skip
"""What zipfile and numpy raise for a file that is damaged, encrypted, or packed in a way that they do not know."""


def load_region(name_or_path: str | Path, seed: int | None = None) -> Region:
    """The finished region of an embedded name (``t1``, ``t2``), of a region's folder or of an .npz file.

    seed: of the variation of a region of kind ``window``, such as an embedded one; None is the region's own, for which
    its published figures hold. Others have one variation and take no seed. An .npz file contains he3_ppb (rows,
    columns) with row 0 in the south, NaN where nothing is known of it, resolution_m, and elevation_m [m] or traversable
    (bool) or both; orbital_ppb, provenance (text), and origin_lat_deg and origin_lon_deg of its south-west corner are
    optional. Without traversable, elevation is judged by a vehicle's limits (``he3.vehicle_ground``), with
    rock_abundance (rows, columns), 0 to 1, where it is given. Raises InvalidInput, in one line with file, key and
    expectation.
    """
    if is_region_folder(name_or_path):
        return _region_from_folder(folder_of(name_or_path), seed)
    path = Path(name_or_path)
    if path.suffix != ".npz":
        raise InvalidInput(
            f"expected a region out of {', '.join(EMBEDDED)}, a region's folder or an .npz file, "
            f"got {str(name_or_path)!r}"
        )
    if seed is not None:
        raise InvalidInput(f"{path}: expected no field seed with a region file, which has one variation; got {seed}")
    return _region_from_file(path)


def load_window(name: str | Path) -> OrbitalWindow:
    """The orbital window of an embedded region or of a folder of kind ``window``, row 0 south."""
    folder = folder_of(name)
    return _window(folder, read_document(folder))


def _window(folder: Path, document: RegionDocument) -> OrbitalWindow:
    window, layers = document.window, {}
    if window is None or document.origin_lat_deg is None or document.origin_lon_deg is None:
        raise InvalidInput(f"{folder / DOCUMENT}: expected a region of kind 'window', got {document.kind!r}")
    for key in WINDOW_LAYERS:
        layers[key] = read_layer(folder, key, document).astype(np.float64, order="C")
        if not np.isfinite(layers[key]).all():
            holes = cells_where(~np.isfinite(layers[key]))
            raise InvalidInput(
                f"{folder / DOCUMENT}: key {key}: expected values everywhere, got missing ones in {holes}"
            )
    return OrbitalWindow(
        name=document.name,
        title=document.title,
        provenance=document.provenance,
        **layers,
        south_deg=window.north_deg - layers["iron_wt"].shape[0] / window.pixels_per_degree,
        west_deg=window.west_deg,
        pixels_per_degree=window.pixels_per_degree,
        origin_lat_deg=document.origin_lat_deg,
        origin_lon_deg=document.origin_lon_deg,
        solar_wind_flux=window.solar_wind_flux,
        seed=window.seed,
        layers=document.origins,
    )


def _region_from_folder(folder: Path, seed: int | None) -> Region:
    """The region of a folder; only one of kind ``window`` takes a seed."""
    document = read_document(folder)
    where = folder / DOCUMENT
    if document.kind == "window":
        return reference(_window(folder, document), seed)
    if seed is not None:
        raise InvalidInput(f"{where}: expected no field seed with a region of kind 'site', which has one variation; "
                           f"got {seed}")  # fmt: skip
    arrays: dict[str, NDArray[Any]] = {
        key: read_layer(folder, key, document) for key in document.with_files if key in _LAYERS
    }
    arrays["resolution_m"] = np.asarray(document.resolution_m)
    region = _region(where, arrays)
    return replace(
        region,
        name=document.name,
        title=document.title,
        provenance=document.provenance,
        origin_lat_deg=document.origin_lat_deg,
        origin_lon_deg=document.origin_lon_deg,
        layers=document.origins,
        crs=document.crs,
        origin_x_m=document.origin_x_m,
        origin_y_m=document.origin_y_m,
    )


def _region_from_file(path: Path) -> Region:
    return _region(path, _read_layers(path))


def _region(path: Path, arrays: Mapping[str, NDArray[Any]]) -> Region:
    """The region of checked arrays. path: what a refusal's line begins with."""
    arrays, known = _without_unknown(path, arrays)
    he3 = _layer(path, arrays, "he3_ppb", None, (0.0, HELIUM3_MAX_PPB), "ppb")
    if he3 is None:
        raise InvalidInput(f"{path}: expected key he3_ppb, got {', '.join(sorted(arrays)) or 'no keys'}")
    if 0.0 < (highest := float(he3.max())) < HELIUM3_LEAST_PPB:
        raise InvalidInput(
            f"{path}: key he3_ppb: expected helium-3 in ppb, got at most {highest:.4g}, as in ppm or as a fraction"
        )
    resolution_m = _resolution_m(path, arrays)
    grid = SiteGrid(he3.shape[0], he3.shape[1], resolution_m)
    if max(grid.width_m, grid.height_m) > MAX_POSITION_M:
        raise InvalidInput(f"{path}: expected a site of at most {MAX_POSITION_M / 1000:g} km on a side, got "
                           f"{grid.width_m / 1000:g} x {grid.height_m / 1000:g} km")  # fmt: skip
    elevation = _layer(path, arrays, "elevation_m", he3.shape, (ELEVATION_MIN_M, ELEVATION_MAX_M), "m")
    if elevation is not None:
        expect_no_walls(f"{path}: key elevation_m", elevation, resolution_m)
    open_cells = _open_cells(path, arrays, he3.shape)
    orbital = _layer(path, arrays, "orbital_ppb", he3.shape, (0.0, HELIUM3_MAX_PPB), "ppb")
    latitude, longitude = _origin_deg(path, arrays)
    if elevation is None and open_cells is None:
        raise InvalidInput(f"{path}: expected key elevation_m or traversable, got {', '.join(sorted(arrays))}")
    slope = np.zeros(he3.shape) if elevation is None else slope_deg(elevation, resolution_m)
    rocks = _rock_abundance(path, arrays, he3.shape)
    if open_cells is None:
        assert elevation is not None  # checked above
        open_cells = judged(elevation, resolution_m, VehicleLimits(), slope=slope, rock_abundance=rocks).open_cells
    if known is not None:
        open_cells = open_cells & known
        if not open_cells.any():
            raise InvalidInput(f"{path}: key he3_ppb: expected a value in some open cell, got NaN in all of them")
    return Region(
        name=path.stem,
        title=path.stem,
        provenance=_provenance(path, arrays),
        grid=grid,
        he3_ppb=he3,
        orbital_ppb=orbital_view(he3, grid) if orbital is None else orbital,
        elevation_m=np.zeros(he3.shape) if elevation is None else elevation,
        slope_deg=slope,
        traversable=open_cells,
        origin_lat_deg=latitude,
        origin_lon_deg=longitude,
        known=known,
    )


def _without_unknown(
    path: Path, arrays: Mapping[str, NDArray[Any]]
) -> tuple[Mapping[str, NDArray[Any]], NDArray[np.bool_] | None]:
    """The arrays with he3_ppb everywhere, and where it was known; None if everywhere."""
    field = arrays.get("he3_ppb")
    if field is None or field.dtype.kind != "f" or field.ndim != 2:
        return arrays, None
    try:
        he3, known = filled_with_nearest(field.astype(np.float64))
    except InvalidInput as error:
        raise InvalidInput(f"{path}: key he3_ppb: {error}") from None
    return (arrays, None) if known is None else ({**arrays, "he3_ppb": he3}, known)


def _read_layers(path: Path) -> dict[str, NDArray[Any]]:
    """The known arrays of an .npz file, by key; unknown keys are ignored, and nothing is unpickled."""
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MAX_FILE_BYTES:
            raise InvalidInput(f"{path}: expected at most {MAX_FILE_BYTES} bytes of arrays, got {size}")
        with np.load(path, allow_pickle=False) as arrays:
            layers = {key: arrays[key] for key in arrays.files if key in (*_LAYERS, *_FURTHER)}
    except FileNotFoundError:
        raise InvalidInput(f"{path}: expected a region file, got no such file") from None
    except _UNREADABLE as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"{path}: expected an .npz file of plain numeric arrays, got {error}") from None
    for key, values in layers.items():
        if not isinstance(values, np.ndarray):  # numpy gives the bytes of a member that does not begin as an array
            raise InvalidInput(f"{path}: key {key}: expected an array in numpy's format, got other bytes")
    return layers


def _layer(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    key: str,
    shape: tuple[int, ...] | None,
    bounds: tuple[float, float],
    unit: str,
) -> FloatArray | None:
    """A layer as float64 (rows, columns) without missing values; None if the file does not contain it."""
    layer = _numbers(path, arrays, key, shape)
    if layer is not None:
        expect_measured(f"{path}: key {key}", layer, *bounds, unit)
    return layer


def _numbers(
    path: Path, arrays: Mapping[str, NDArray[Any]], key: str, shape: tuple[int, ...] | None
) -> FloatArray | None:
    """That array as float64 (rows, columns), of that shape if one is given; None if the file does not contain it."""
    values = arrays.get(key)
    if values is None:
        return None
    if values.dtype.kind not in "fiu":
        raise InvalidInput(f"{path}: key {key}: expected real numbers, got dtype {values.dtype}")
    _expect_shape(path, key, values.shape, shape)
    return np.array(values, dtype=np.float64, order="C")


def _open_cells(path: Path, arrays: Mapping[str, NDArray[Any]], shape: tuple[int, ...]) -> NDArray[np.bool_] | None:
    values = arrays.get("traversable")
    if values is None:
        return None
    _expect_shape(path, "traversable", values.shape, shape)
    if values.dtype.kind not in "bui":
        raise InvalidInput(f"{path}: key traversable: expected booleans, got dtype {values.dtype}")
    off = ~np.isin(values, (0, 1))
    if off.any():
        raise InvalidInput(f"{path}: key traversable: expected booleans, got {values[off][0]} in {cells_where(off)}")
    if not bool(values.any()):
        raise InvalidInput(f"{path}: key traversable: expected at least one open cell, got none")
    return values.astype(np.bool_)


def _rock_abundance(path: Path, arrays: Mapping[str, NDArray[Any]], shape: tuple[int, ...]) -> FloatArray | None:
    """Share of each cell under rocks, NaN where it is not known; None if the file does not contain it."""
    rocks = _numbers(path, arrays, ROCK_ABUNDANCE, shape)
    if rocks is None:
        return None
    off = ~(np.isnan(rocks) | ((rocks >= 0.0) & (rocks <= 1.0)))
    if off.any():
        raise InvalidInput(
            f"{path}: key {ROCK_ABUNDANCE}: expected 0 to 1, or NaN where it is not known, got {rocks[off][0]:g} in "
            f"{cells_where(off)}"
        )
    return rocks


def _expect_shape(path: Path, key: str, got: tuple[int, ...], wanted: tuple[int, ...] | None) -> None:
    if wanted is not None and got != wanted:
        raise InvalidInput(f"{path}: key {key}: expected the shape of he3_ppb, {wanted}, got {got}")
    if len(got) != 2 or min(got) < 4:
        raise InvalidInput(f"{path}: key {key}: expected (rows, columns) of at least 4 x 4, got shape {got}")
    if got[0] * got[1] > MAX_CELLS:
        raise InvalidInput(f"{path}: key {key}: expected at most {MAX_CELLS} cells, got {got[0] * got[1]}")


def _provenance(path: Path, arrays: Mapping[str, NDArray[Any]]) -> str:
    """Provenance of the data as stated in the file, with the file's name."""
    values = arrays.get("provenance")
    if values is None:
        return f"given as {path.name}"
    text = str(values.reshape(())) if values.dtype.kind == "U" and values.size == 1 else None
    if text is None or not text.isprintable() or len(text) > MAX_PROVENANCE:
        got = f"dtype {values.dtype} of shape {values.shape}" if text is None else f"{len(text)}: {text[:40]!r}"
        raise InvalidInput(f"{path}: key provenance: expected up to {MAX_PROVENANCE} printable characters, got {got}")
    return f"{text} (from {path.name})" if text else f"given as {path.name}"


def _origin_deg(path: Path, arrays: Mapping[str, NDArray[Any]]) -> tuple[float, float] | tuple[None, None]:
    """Latitude and longitude [deg] of the south-west corner; None if the file does not contain them."""
    latitude = _number(path, arrays, "origin_lat_deg", -MAX_LATITUDE_DEG, MAX_LATITUDE_DEG, "deg")
    longitude = _number(path, arrays, "origin_lon_deg", -360.0, 360.0, "deg")
    if latitude is None and longitude is None:
        return None, None
    if latitude is None or longitude is None:
        raise InvalidInput(f"{path}: expected both of origin_lat_deg and origin_lon_deg or none, got one")
    return latitude, longitude


def _resolution_m(path: Path, arrays: Mapping[str, NDArray[Any]]) -> float:
    resolution = _number(path, arrays, "resolution_m", 0.01, 1000.0, "m")
    if resolution is None:
        raise InvalidInput(f"{path}: expected key resolution_m, got {', '.join(sorted(arrays))}")
    return resolution


def _number(
    path: Path, arrays: Mapping[str, NDArray[Any]], key: str, low: float, high: float, unit: str
) -> float | None:
    """One number within low..high; None if the file does not contain it."""
    values = arrays.get(key)
    if values is None:
        return None
    if values.dtype.kind not in "fiu" or values.size != 1:
        raise InvalidInput(
            f"{path}: key {key}: expected one number [{unit}], got dtype {values.dtype} of shape {values.shape}"
        )
    number = float(values.reshape(()))
    if not low <= number <= high:
        raise InvalidInput(f"{path}: key {key}: expected {low:g} to {high:g} {unit}, got {number}")
    return number

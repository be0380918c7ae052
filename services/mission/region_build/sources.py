"""Rasters of orbital products, read in windows: by GDAL, from files or addresses, and NumPy arrays.

Values are returned as float64 in the unit of their layer, NaN where they are missing. A PDS3 image is opened through
its label. Scale, offset, unit, no-data value and band names are those of the product unless the recipe overrides them.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from he3.constants import MOON_RADIUS_M
from he3.errors import InvalidInput
from he3.frames import BoolArray, FloatArray
from services.mission.npy import mapped_array
from services.mission.region_build.geo import pyproj, rasterio
from services.mission.region_build.plausible import expect_no_marks, expect_plausible
from services.mission.region_build.projection import array_crs
from services.mission.region_build.recipe import GridTable, SourceTable
from services.mission.region_build.units import factor_of

MAX_WINDOW_PIXELS: Final = 64_000_000
MAX_CHECKSUM_BYTES: Final = 256 * 1024 * 1024  # beyond it, the checksum is that of the window
_MISSING_BELOW: Final = -1e30  # no quantity is; covers -3.4e38 in each of its spellings
_PLANET_RADIUS_M: Final = 1_000_000.0  # elevations above it are distances from the Moon's centre
_POSITIVE: Final = ("iron_wt", "maturity")  # layers in which 0 or less marks a missing value, always
_MOST_FLAT: Final = 1e-6  # 1, flattening of the Moon's figure in a raster's projection: 2 m
_EQUATOR_M: Final = 2 * math.pi * MOON_RADIUS_M


@dataclass(slots=True, eq=False)
class Source:
    """An open raster. Columns and rows are counted from the outer edge of the first pixel."""

    name: str
    layer: str
    table: SourceTable
    rows: int
    columns: int
    transform: tuple[float, float, float, float, float, float]
    """(a, b, c, d, e, f): x = a column + b row + c, y = d column + e row + f."""
    crs: Any
    """Projection; None for a raster with a grid in the recipe: x east and y north of its centre [m]."""
    period: float | None
    """Columns around the Moon, in a cylindrical projection."""
    sha256: str
    product_id: str
    reader: Any
    """(row, column, rows, columns) -> values, NaN where missing."""
    unit: str
    """Unit of the recipe or the file; empty if neither says it."""

    def pixels(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows and columns of places in the raster's projection; the first pixel's centre is (0.5, 0.5)."""
        a, b, c, d, e, f = self.transform
        determinant = a * e - b * d
        columns = (e * (x - c) - b * (y - f)) / determinant
        rows = (-d * (x - c) + a * (y - f)) / determinant
        return rows, columns

    @property
    def is_global(self) -> bool:
        """Whether its last column touches its first one, around the Moon."""
        return self.period is not None and abs(self.columns - self.period) < 0.5

    def read(self, row: int, column: int, rows: int, columns: int) -> FloatArray:
        """A window, (rows, columns) float64; a global raster continues across its seam.

        Raises InvalidInput for values that are not possible in this layer, and for a window that is too large.
        """
        if rows * columns > MAX_WINDOW_PIXELS:
            raise InvalidInput(
                f"{self.name}: expected a window of at most {MAX_WINDOW_PIXELS} pixels, got {rows} x {columns}"
            )
        parts, at = [], column
        while at < column + columns:
            first = at % self.columns if self.is_global else at
            width = min(column + columns - at, self.columns - first)
            parts.append(self.reader(row, first, rows, width))
            at += width
        values: FloatArray = np.concatenate(parts, axis=1)
        expect_plausible(self.name, self.layer, values, self.unit)
        return values


@contextlib.contextmanager
def opened(layer: str, table: SourceTable, folder: Path) -> Iterator[Source]:
    """The raster of that layer; raises InvalidInput, in one line, for one that cannot be read or placed."""
    if table.grid is not None:
        yield _array_source(layer, table, folder, table.grid)
        return
    if table.file.endswith(".npy"):
        raise InvalidInput(f"{table.file}: expected a table [layers.{layer}.grid] with the place of the array")
    library = rasterio()
    name = _gdal_name(table.file, folder)
    # Beside a local file there may be its mask, its no-data value or its place; an address is not asked for them.
    beside = "EMPTY_DIR" if name.startswith("/vsi") else "FALSE"
    try:
        with (
            warnings.catch_warnings(),
            library.Env(GDAL_DISABLE_READDIR_ON_OPEN=beside, GDAL_HTTP_TIMEOUT="60", GDAL_CACHEMAX=64),
        ):
            warnings.simplefilter("ignore", library.errors.NotGeoreferencedWarning)
            with library.open(name) as dataset:
                yield _gdal_source(layer, table, dataset, name)
    except library.errors.RasterioError as error:
        raise InvalidInput(f"{table.file}: layer {layer}: expected a raster that GDAL reads, got {error}") from None


def _gdal_name(file: str, folder: Path) -> str:
    if file.startswith(("http://", "https://")):
        return f"/vsicurl/{file}"
    if file.startswith("/vsi"):
        return file
    path = folder / file
    if path.suffix.lower() == ".img":  # GDAL opens the label of a PDS3 image
        for suffix in (".LBL", ".lbl", ".xml"):
            if path.with_suffix(suffix).is_file():
                path = path.with_suffix(suffix)
                break
    if not path.is_file():
        raise InvalidInput(f"{path}: expected a raster, got no such file")
    return str(path)


def _gdal_source(layer: str, table: SourceTable, dataset: Any, name: str) -> Source:
    band = _band(table, dataset, name)
    if dataset.crs is None:
        raise InvalidInput(f"{name}: layer {layer}: expected a georeferenced raster, got one without a projection")
    transform = dataset.transform
    label = _label_text(name)
    scale = dataset.scales[band - 1] if table.scale is None else table.scale
    offset = dataset.offsets[band - 1] if table.offset is None else table.offset
    own_unit = dataset.units[band - 1] or _label_word(label, "UNIT") or ""
    factor, unit = factor_of(Path(name).name, layer, table, own_unit)
    path = Path(name)
    no_data = [*table.no_data, *([] if dataset.nodatavals[band - 1] is None else [dataset.nodatavals[band - 1]])]

    def read(row: int, column: int, rows: int, columns: int) -> FloatArray:
        window = (row, row + rows), (column, column + columns)
        raw = dataset.read(band, window=window)
        return _values(
            path.name, raw, hidden_by_mask(dataset, band, window), layer, table, no_data, scale, offset, factor
        )

    data = [path] if path.is_file() else []
    if data and path.suffix.lower() in (".lbl", ".xml"):
        data = [Path(file) for file in dataset.files if Path(file).suffix.lower() not in (".lbl", ".xml")] or data
    crs = pyproj().CRS.from_user_input(dataset.crs.to_wkt())
    source = Source(
        name=Path(name).name, layer=layer, table=table, rows=dataset.height, columns=dataset.width,
        transform=(transform.a, transform.b, transform.c, transform.d, transform.e, transform.f), crs=crs,
        period=_period(crs, transform.a), sha256=_checksum(data), reader=read, unit=unit,
        product_id=table.product_id or _label_word(label, "PRODUCT_ID"),
    )  # fmt: skip
    _expect_the_moon(source, crs)
    _expect_label_agrees(source, label)
    return source


def hidden_by_mask(dataset: Any, band: int, window: Any = None) -> BoolArray:
    """Pixels (rows, columns) that the mask or the alpha band of an open raster hides, in a window or everywhere."""
    flags = {flag.name for flag in dataset.mask_flag_enums[band - 1]}
    alpha = next((number for number, of in enumerate(dataset.colorinterp, start=1) if of.name == "alpha"), band)
    if alpha != band:  # GDAL itself takes an alpha band of integers alone for a mask
        shown = dataset.read(alpha, window=window)
    elif "per_dataset" in flags:
        shown = dataset.read_masks(band, window=window)
    else:
        (first, last), (left, right) = window or ((0, dataset.height), (0, dataset.width))
        return np.zeros((last - first, right - left), dtype=np.bool_)
    hidden: BoolArray = shown == 0
    return hidden


def _array_source(layer: str, table: SourceTable, folder: Path, grid: GridTable) -> Source:
    path = folder / table.file
    try:
        values = mapped_array(path)
    except FileNotFoundError:
        raise InvalidInput(f"{path}: expected a raster, got no such file") from None
    except InvalidInput as error:
        raise InvalidInput(f"{path}: layer {layer}: expected a plain .npy array, got {error}") from None
    if values.ndim != 2 or values.dtype.kind not in "fiu":
        raise InvalidInput(f"{path}: layer {layer}: expected one array (rows, columns) of real numbers")
    rows, columns = values.shape
    factor, unit = factor_of(path.name, layer, table)
    scale = 1.0 if table.scale is None else table.scale
    offset = table.offset or 0.0

    def read(row: int, column: int, height: int, width: int) -> FloatArray:
        raw = np.asarray(values[row : row + height, column : column + width])
        hidden = np.zeros(raw.shape, dtype=np.bool_)
        return _values(path.name, raw, hidden, layer, table, list(table.no_data), scale, offset, factor)

    cell = grid.resolution_m
    crs = array_crs(grid.centre_lat_deg, grid.centre_lon_deg, rows * cell)
    return Source(
        name=path.name, layer=layer, table=table, rows=rows, columns=columns, sha256=_checksum([path]), reader=read,
        transform=(cell, 0.0, -columns * cell / 2, 0.0, -cell, rows * cell / 2), crs=crs, period=None,
        product_id=table.product_id, unit=unit,
    )  # fmt: skip


def _band(table: SourceTable, dataset: Any, name: str) -> int:
    """The number of the band: by its name where it has one."""
    descriptions = [text or "" for text in dataset.descriptions]
    if isinstance(table.band, str):
        found = [number for number, text in enumerate(descriptions, start=1) if text == table.band]
        if len(found) != 1:
            raise InvalidInput(f"{name}: expected one band named {table.band!r}, got {', '.join(descriptions) or '-'}")
        return found[0]
    if table.band is None and dataset.count != 1:
        raise InvalidInput(f"{name}: expected key band, as there are {dataset.count}: {', '.join(descriptions)}")
    band = table.band or 1
    if band > dataset.count:
        raise InvalidInput(f"{name}: expected a band of 1 to {dataset.count}, got {band}")
    return band


def _values(
    name: str,
    raw: Any,
    hidden: BoolArray,
    layer: str,
    table: SourceTable,
    no_data: list[float],
    scale: float,
    offset: float,
    factor: float,
) -> FloatArray:
    """The values of the numbers ``raw`` of a window, NaN where they are missing. hidden: by a mask or an alpha band."""
    values = raw.astype(np.float64)
    missing = hidden | ~np.isfinite(values) | (values < _MISSING_BELOW)
    for number in no_data:
        # As the raster's own type rounds it: -3.4028226550889045e38 is no float32.
        missing |= raw == np.asarray(number).astype(raw.dtype) if raw.dtype.kind == "f" else values == number
    values = (values * scale + offset) * factor
    # The raster's numbers are scaled before they are compared with 0: with an offset, a number of 0 is a value.
    nothing = 1e-9 * abs(offset * factor)  # a value of 0 after rounding
    if table.zero_is_missing:
        missing |= np.abs(values) <= nothing
    if layer in _POSITIVE:
        missing |= values <= nothing
    expect_no_marks(name, layer, raw, missing)
    if layer == "elevation_m" and (~missing).any() and float(np.median(values[~missing])) > _PLANET_RADIUS_M:
        values -= MOON_RADIUS_M  # the label's offset makes radii of heights
    result: FloatArray = np.where(missing, np.nan, values)
    return result


def _period(crs: Any, pixel: float) -> float | None:
    """Columns around the Moon in a cylindrical raster with pixels of that width."""
    if crs.is_geographic:
        return 360.0 / abs(pixel)
    operation = crs.coordinate_operation
    if operation is None or "equi" not in operation.method_name.lower().replace("plate car", "equi"):
        return None
    if "cylindrical" not in operation.method_name.lower() and "equirect" not in operation.method_name.lower():
        return None
    parallel = next((item.value for item in operation.params if "standard parallel" in item.name.lower()), 0.0)
    return _EQUATOR_M * math.cos(math.radians(parallel)) / abs(pixel)


def _expect_the_moon(source: Source, crs: Any) -> None:
    body = crs.ellipsoid
    radius, minor = (math.nan, math.nan) if body is None else (body.semi_major_metre, body.semi_minor_metre)
    if not abs(radius / MOON_RADIUS_M - 1.0) < 2e-3:
        raise InvalidInput(
            f"{source.name}: expected a raster of the Moon, R about {MOON_RADIUS_M:.0f} m, got {radius:.0f} m"
        )
    # PROJ takes latitudes of an ellipsoid over as those of the sphere, up to 0.07 deg or 2 km off.
    if not abs(minor / radius - 1.0) < _MOST_FLAT:
        raise InvalidInput(
            f"{source.name}: expected latitudes on a sphere, as those of lunar products, got an ellipsoid of "
            f"{radius:.0f} x {minor:.0f} m"
        )


def _label_text(name: str) -> str:
    path = Path(name)
    if path.suffix.lower() != ".lbl":
        return ""
    with path.open("rb") as file:
        return file.read(65536).decode("latin-1")


def _label_word(label: str, key: str) -> str:
    found = re.search(rf"^\s*{key}\s*=\s*\"?([^\"\r\n]+?)\"?\s*$", label, re.MULTILINE)
    return found.group(1).strip() if found else ""


def _expect_label_agrees(source: Source, label: str) -> None:
    """Raises InvalidInput if a PDS3 label's bounds and its projection offsets place the raster differently."""
    words = [_label_word(label, key).split("<")[0].strip() for key in ("MAXIMUM_LATITUDE", "MINIMUM_LATITUDE")]
    if source.period is None or not all(words):
        return
    try:
        north, south = (float(word) for word in words)
    except ValueError:
        return
    _, _, _, _, e, f = source.transform
    top = f if source.crs.is_geographic else math.degrees(f / MOON_RADIUS_M)
    step = e if source.crs.is_geographic else math.degrees(e / MOON_RADIUS_M)
    got = (top - north) / abs(step), (top + step * source.rows - south) / abs(step)
    if max(map(abs, got)) > 0.75:
        raise InvalidInput(
            f"{source.name}: expected offsets that agree with MAXIMUM_LATITUDE and MINIMUM_LATITUDE of the label, "
            f"got {got[0]:+.2f} and {got[1]:+.2f} rows of difference"
        )


def _checksum(files: list[Path]) -> str:
    """Checksum of a single file; empty for several files, or for one that is too large."""
    if len(files) != 1:
        return ""
    found = files[0].stat()
    if found.st_size > MAX_CHECKSUM_BYTES or found.st_blocks * 512 < 0.9 * found.st_size:
        return ""  # large, or fetched in part
    with files[0].open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()

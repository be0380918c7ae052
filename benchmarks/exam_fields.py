"""The fields of the exam: third-party rasters, our embedded regions, and rasters that a user brings.

A field's values are mapped linearly to 0..20 ppb, because the belief's priors are in ppb; all scores are in units of
the field's standard deviation and do not depend on that. A raster with more cells than ``MOST_CELLS`` on a side is
averaged over blocks. A cell without a value is closed ground and is not scored. All other cells are open, but for the
embedded regions, which keep their terrain, and an .npz that a user brings, which keeps its obstacles.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.data_folder import expect_folder, no_raster
from benchmarks.pixel_size import ground_pixel_m
from he3.constants import MOON_RADIUS_M
from he3.errors import InvalidInput
from he3.frames import BoolArray, FloatArray, SiteGrid
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from he3.nodata import cells_where, filled_with_nearest, undeclared
from he3.reference import Region, orbital_view
from services.mission.embedded_regions import EMBEDDED
from services.mission.region_build.sources import hidden_by_mask
from services.mission.regions import load_region

MOST_CELLS = 400
LEAST_CELLS = 16
"""Cells on a side that a field has at most and at least."""
SPAN_PPB = 20.0
NOISE_SHARE = 0.05
"""Standard deviation of the noise, as a share of the field's, where no protocol is published."""
SUFFIXES = (".npy", ".npz", ".tif", ".tiff")
"""Of rasters that a user brings."""

_PAGE: Final = "docs/exam.md"
_HERODOTUS = "leggedrobotics+lunar_planner/user_data/map_data/Herodutus_Mons/clino_feo_tio_plagio.tif"
_WALKER = "opengeostat+pygslib/Exhaustive_set.csv"


@dataclass(frozen=True, slots=True, eq=False)
class ExamField:
    """One field: the region that is surveyed, the cells with a value, and the sensor's noise."""

    name: str
    title: str
    region: Region
    known: BoolArray
    noise_std_ppb: float


@dataclass(frozen=True, slots=True)
class _Source:
    """A published raster, and what its protocol says."""

    title: str
    file: str
    part: str = ""
    """Band or column."""
    cell_m: float | None = 1.0
    """Edge of a cell [m]; None for that of the raster's own reference system."""
    noise: float | None = None
    """Published standard deviation of the noise, in the raster's unit; None if there is none."""


SOURCES = {
    "srtm-n17e073": _Source("SRTM N17E073, grey levels", "Weizhe-Chen+attentive_kernels/N17E073.npy", noise=1.0),
    "srtm-n45w123": _Source("SRTM N45W123, grey levels", "Weizhe-Chen+attentive_kernels/N45W123.npy", noise=1.0),
    "walker-u": _Source("Walker Lake, U", _WALKER, "U"),
    "walker-v": _Source("Walker Lake, V", _WALKER, "V"),
    "herodotus-feo": _Source("Mons Herodotus, FeO", _HERODOTUS, "lk_feo", None),
    "herodotus-tio2": _Source("Mons Herodotus, TiO2", _HERODOTUS, "wac_tio2_gray", None),
    "gld100-taurus": _Source("Taurus-Littrow, heights", "derived/gld100_taurus_littrow_256ppd.tif", "", None),
    "gld100-hadley": _Source("Hadley, heights", "derived/gld100_hadley_256ppd.tif", "", None),
}
"""The third-party fields, by name; files are relative to the folder of data or its subfolder ``real``."""


def names_in(data: Path | None) -> list[str]:
    """All fields that there are: published ones whose file is there, embedded ones, and rasters right in the folder.

    Raises InvalidInput if the folder is none, or has no raster: who names it wants more than our own regions.
    """
    names = _names_in(data)
    if data is not None and names == list(EMBEDDED):
        first = next(iter(SOURCES.values())).file
        own = f"a file {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]} right in it"
        raise no_raster(data, _PAGE, f"{first} nor another that the page names, nor {own}")
    return names


def _names_in(data: Path | None) -> list[str]:
    if data is None:
        return list(EMBEDDED)
    expect_folder(data, _PAGE)
    published = [name for name, source in SOURCES.items() if _file_of(data, source) is not None]
    brought = sorted(path.name for path in data.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
    return [*published, *EMBEDDED, *brought]


def load_field(name: str, data: Path | None, noise_share: float | None = None) -> ExamField:
    """The field of that name, one of `names_in` the folder.

    noise_share: standard deviation of the noise as a share of the field's; None for the field's own. Raises
    InvalidInput, in one line, for a file that is missing or is no field.
    """
    if name in EMBEDDED:
        region = load_region(name)
        std = DEFAULT_NOISE_STD_PPB if noise_share is None else noise_share * float(region.he3_ppb.std())
        return ExamField(name, region.title, region, np.ones(region.grid.shape, dtype=np.bool_), std)
    source = SOURCES.get(name)
    path = None if data is None else _file_of(data, source) if source is not None else data / name
    if path is None or not path.is_file():
        raise InvalidInput(f"exam: expected fields out of {', '.join(_names_in(data))}; got {name!r}")
    if source is None:
        values, cell_m = _raster(path, "")
        ground = load_region(path).traversable if path.suffix.lower() == ".npz" else None
        return _field(path, name, name, values, cell_m or 1.0, None, noise_share, ground)
    values, cell_m = _raster(path, source.part, published=True)
    return _field(path, name, source.title, values, source.cell_m or cell_m or 1.0, source.noise, noise_share)


def _file_of(data: Path, source: _Source) -> Path | None:
    return next((path for path in (data / source.file, data / "real" / source.file) if path.is_file()), None)


def _field(
    path: Path,
    name: str,
    title: str,
    values: FloatArray,
    cell_m: float,
    noise: float | None,
    share: float | None,
    ground: BoolArray | None = None,
) -> ExamField:
    """The field of a raster, row 0 south, NaN where there is no value. noise: published std in the raster's unit.

    ground: the raster's cells that are open, all with a value if None. A block of cells is closed where half of them
    or more are.
    """
    opened = None if ground is None else coarser(ground.astype(np.float64), cell_m)[0] > 0.5
    values, cell_m = coarser(values, cell_m)
    if min(values.shape) < LEAST_CELLS:
        raise InvalidInput(f"{path}: expected at least {LEAST_CELLS} x {LEAST_CELLS} cells, got {values.shape}")
    known = np.isfinite(values)
    if known.sum() < LEAST_CELLS**2:
        raise InvalidInput(f"{path}: expected at least {LEAST_CELLS**2} cells with a value, got {known.sum()}")
    low, high = float(values[known].min()), float(values[known].max())
    if not high > low:
        raise InvalidInput(f"{path}: expected a field that varies, got {low:g} everywhere")
    he3_ppb = (filled_with_nearest(values)[0] - low) * (SPAN_PPB / (high - low))
    std = float(he3_ppb[known].std())
    if share is not None:
        noise_std_ppb = share * std
    else:
        noise_std_ppb = NOISE_SHARE * std if noise is None else noise * SPAN_PPB / (high - low)
    grid = SiteGrid(values.shape[0], values.shape[1], cell_m)
    flat = np.zeros(grid.shape)
    region = Region(
        name=name, title=title, provenance=path.name, grid=grid, he3_ppb=he3_ppb,
        orbital_ppb=orbital_view(he3_ppb, grid), elevation_m=flat, slope_deg=flat.copy(),
        traversable=known.copy() if opened is None else known & opened, known=known,
    )  # fmt: skip
    return ExamField(name, title, region, known, noise_std_ppb)


def coarser(values: FloatArray, cell_m: float) -> tuple[FloatArray, float]:
    """Means over the smallest blocks that leave at most ``MOST_CELLS`` on a side, and the blocks' edge [m].

    Cells without a value (NaN) are left out of the mean; rows and columns that do not fill a block are cut off.
    """
    block = math.ceil(max(values.shape) / MOST_CELLS)
    if block == 1:
        return values, cell_m
    rows, columns = (size // block for size in values.shape)
    blocks = values[: rows * block, : columns * block].reshape(rows, block, columns, block)
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), cell_m * block


def _raster(path: Path, part: str, published: bool = False) -> tuple[FloatArray, float | None]:
    """Values with row 0 south, NaN where there is none, and the edge of a cell [m] if the file says it."""
    reader: Callable[[Path, str], tuple[Any, float | None]]
    reader = {".npy": _npy, ".npz": _npz, ".csv": _csv}.get(path.suffix.lower(), partial(_geotiff, published=published))
    values, cell_m = reader(path, part)
    if values.ndim != 2 or values.dtype.kind not in "iuf":
        raise InvalidInput(f"{path}: expected numbers in rows and columns, got {values.dtype} of shape {values.shape}")
    _expect_no_marks(path, values, np.abs(values.astype(np.float64)) < 1e30)
    finite = values.astype(np.float64)
    finite[~(np.abs(finite) < 1e30)] = np.nan  # infinities and the "no data" of many products
    return finite, cell_m


def _expect_no_marks(path: Path, values: NDArray[Any], known: NDArray[np.bool_]) -> None:
    """Raises InvalidInput if numbers among the known ones mark missing values, which the file does not say."""
    marks = undeclared(values, known)
    if marks is not None:
        raise InvalidInput(
            f"{path}: expected values as the others, got {marks.number:g}, which marks missing values, in "
            f"{cells_where(marks.where)}; a GeoTIFF names its no-data value, an array has NaN"
        )


def _npy(path: Path, _part: str) -> tuple[NDArray[Any], None]:
    try:
        return np.load(path, allow_pickle=False), None
    except (OSError, ValueError, EOFError) as error:
        raise InvalidInput(f"{path}: expected an array that NumPy reads, got {error}") from None


def _npz(path: Path, _part: str) -> tuple[FloatArray, float]:
    region = load_region(path)
    field = region.he3_ppb if region.known is None else np.where(region.known, region.he3_ppb, np.nan)
    return field, region.grid.resolution_m


def _csv(path: Path, part: str) -> tuple[FloatArray, None]:
    """A table with columns X and Y, counted from 1, as Walker Lake has."""
    with path.open(newline="", encoding="utf-8") as lines:
        try:
            table = [(int(row["X"]), int(row["Y"]), float(row[part])) for row in csv.DictReader(lines)]
        except (KeyError, ValueError, TypeError) as error:
            raise InvalidInput(f"{path}: expected columns X, Y and {part} of numbers, got {error!r}") from None
    if not table:
        raise InvalidInput(f"{path}: expected rows of numbers, got none")
    x, y, v = (np.array(column) for column in zip(*table, strict=True))
    values = np.full((int(y.max()), int(x.max())), np.nan)
    values[y - 1, x - 1] = v
    return values, None


def _geotiff(path: Path, part: str, published: bool = False) -> tuple[FloatArray, float]:
    try:
        import rasterio
    except ImportError:
        raise InvalidInput(f"{path}: expected the extra 'geo' to be installed, which reads GeoTIFF") from None
    try:
        with rasterio.open(path) as raster:
            if part and part not in raster.descriptions:
                raise InvalidInput(f"{path}: expected a band {part}, got {', '.join(map(str, raster.descriptions))}")
            band = 1 + raster.descriptions.index(part) if part else 1
            masked = raster.read(band, masked=True)
            masked[hidden_by_mask(raster, band)] = np.ma.masked
            _expect_no_marks(path, masked.data, ~np.ma.getmaskarray(masked))
            values = masked.astype(np.float64).filled(np.nan)
            upright = raster.transform.is_identity or raster.transform.e <= 0.0  # row 0 north, also where none is said
            if published:  # as in the figures of the documentation: squares as high as the pixels
                degrees = raster.crs is not None and raster.crs.is_geographic
                cell_m = abs(raster.transform.e) * (math.radians(1.0) * MOON_RADIUS_M if degrees else 1.0)
            else:
                cell_m = ground_pixel_m(path, raster)
    except rasterio.errors.RasterioError as error:
        raise InvalidInput(f"{path}: expected a raster that GDAL reads, got {error}") from None
    return values[::-1] if upright else values, cell_m

"""A region as a folder: ``region.toml`` and one GeoTIFF per layer. This module has the document's format and reads it.

Rasters are north up, as GeoTIFFs are; arrays returned here have row 0 in the south. Two kinds of folder exist: a
``site`` has finished maps on the cells of the site, and a ``window`` has coarse orbital rasters, from which
`he3.reference` makes a site. docs/regions.md describes the format.
"""

from __future__ import annotations

import hashlib
import json
import math
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from he3.errors import InvalidInput
from he3.provenance import LayerOrigin, OriginKind
from he3.reference import METRES_PER_DEGREE
from schemas.validation import one_line
from services.mission.embedded_regions import EMBEDDED
from services.mission.layer_units import unit_factor
from services.mission.tiff import NotPlain, TiffFacts, facts_of, read_tiff
from services.mission.toml_files import STEERING, parsed_toml

DOCUMENT: Final = "region.toml"
FORMAT_VERSION: Final = 1
MAX_DOCUMENT_BYTES: Final = 1_000_000
MAX_RASTER_BYTES: Final = 512 * 1024 * 1024
WINDOW_LAYERS: Final = ("iron_wt", "maturity", "elevation_m")

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Words = Annotated[str, Field(max_length=1000, pattern=f"^[^{STEERING}]*$")]
Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-360, le=360)]


class Table(BaseModel):
    """One table of a document: frozen, no unknown keys, finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


T = TypeVar("T", bound=Table)


class LayerTable(Table):
    """One layer: its GeoTIFF in the folder, and where its values come from."""

    file: Name | None = None
    """GeoTIFF in the folder; empty for a layer that is one assumed value or is recomputed."""
    sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")] = ""
    """Checksum of that GeoTIFF; a file with another checksum is refused."""
    kind: Literal["real", "derived", "assumed", "synthetic"]
    source: Annotated[Words, Field(min_length=1)]
    source_file: Words = ""
    source_sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")] = ""
    window: Words = ""
    product_id: Words = ""
    citation: Words = ""

    def origin(self, name: str) -> LayerOrigin:
        """The record of this layer for reports."""
        return LayerOrigin(
            layer=name, kind=OriginKind(self.kind), source=self.source, file=self.source_file or self.file or "",
            sha256=self.source_sha256 or self.sha256, window=self.window, product_id=self.product_id,
            citation=self.citation,
        )  # fmt: skip


class WindowTable(Table):
    """The grid of coarse orbital rasters, in degrees, and the parameters with which a site is made of them."""

    north_deg: Latitude
    west_deg: Longitude
    pixels_per_degree: Annotated[float, Field(gt=0, le=100_000)]
    solar_wind_flux: Annotated[float, Field(gt=0, le=1)]
    seed: Annotated[int, Field(ge=0, lt=2**63)]


class RegionDocument(Table):
    """``region.toml``."""

    format: Literal["he3-region"]
    version: Literal[1]
    kind: Literal["site", "window"]
    name: Name
    title: Annotated[Words, Field(min_length=1, max_length=200)]
    provenance: Annotated[Words, Field(min_length=1)]
    """One line on the whole region, for the reader of a report."""
    resolution_m: Annotated[float, Field(ge=0.01, le=1000)] = 1.0
    origin_lat_deg: Latitude | None = None
    """Latitude and longitude of the south-west corner."""
    origin_lon_deg: Longitude | None = None
    crs: Words = ""
    """Projection of the site's plane, as a PROJ string; its metres are the site's."""
    origin_x_m: float | None = None
    """Place of the south-west corner in that projection [m]."""
    origin_y_m: float | None = None
    window: WindowTable | None = None
    layers: Annotated[dict[Name, LayerTable], Field(min_length=1, max_length=64)]

    @model_validator(mode="after")
    def _is_whole(self) -> RegionDocument:
        if (self.origin_lat_deg is None) != (self.origin_lon_deg is None):
            raise ValueError("expected both of origin_lat_deg and origin_lon_deg or none, got one")
        if (self.kind == "window") != (self.window is not None):
            raise ValueError("expected a table [window] in a region of kind 'window', and in no other")
        wanted: tuple[str, ...] = ("he3_ppb",)
        if self.kind == "window":
            wanted = WINDOW_LAYERS
            if self.origin_lat_deg is None:
                raise ValueError("expected origin_lat_deg and origin_lon_deg in a region of kind 'window'")
        elif not {"elevation_m", "traversable"} & self.with_files.keys():
            raise ValueError("expected a file of layer elevation_m or traversable, got neither")
        for name in wanted:
            if name not in self.with_files:
                raise ValueError(f"expected a file of layer {name}, got layers {', '.join(sorted(self.layers))}")
        return self

    @property
    def with_files(self) -> dict[str, LayerTable]:
        """The layers that have a raster in the folder."""
        return {name: layer for name, layer in self.layers.items() if layer.file is not None}

    @property
    def origins(self) -> tuple[LayerOrigin, ...]:
        """The origin of each layer."""
        return tuple(layer.origin(name) for name, layer in self.layers.items())


def is_region_folder(name_or_path: str | Path) -> bool:
    """Whether that is the name of an embedded region, a folder of a region, or its document."""
    if str(name_or_path) in EMBEDDED:
        return True
    path = Path(name_or_path)
    try:
        return path.name == DOCUMENT or path.is_dir() or (path.suffix == "" and (path / DOCUMENT).is_file())
    except (OSError, ValueError):  # no valid file name
        return False


def folder_of(name_or_path: str | Path) -> Path:
    """The folder of an embedded region or of a path."""
    if str(name_or_path) in EMBEDDED:
        return Path(str(resources.files("services.mission").joinpath("region_data", EMBEDDED[str(name_or_path)])))
    path = Path(name_or_path)
    return path.parent if path.name == DOCUMENT else path


def read_document(folder: Path) -> RegionDocument:
    """The document of a region's folder. Raises InvalidInput, in one line with file, key and expectation."""
    path = folder / DOCUMENT
    return checked(RegionDocument, load_toml(path), path)


def provenance_of(name_or_path: str | Path) -> dict[str, str]:
    """Layer -> its origin in one line, for a recording; of a region in one file, which has no origins, its name and
    checksum.
    """
    if not is_region_folder(name_or_path):
        checksum = file_sha256(name_or_path)
        return {"region": str(name_or_path), **({"file_sha256": checksum} if checksum else {})}
    document = read_document(folder_of(name_or_path))
    return {"region": document.provenance, **{origin.layer: origin.line() for origin in document.origins}}


def file_sha256(name_or_path: str | Path) -> str:
    """SHA-256 of a region in one file; empty without one, and for a folder, whose document has that of each layer."""
    path = Path(name_or_path)
    if is_region_folder(name_or_path) or not path.is_file():
        return ""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def is_recorded(name_or_path: str | Path, recorded: dict[str, str] | None) -> bool:
    """Whether a region is the one whose ``provenance_of`` was recorded; True where no more than a name was recorded."""
    if recorded is None or len(recorded) < 2:
        return True
    if "file_sha256" in recorded:
        return file_sha256(name_or_path) == recorded["file_sha256"]
    return provenance_of(name_or_path) == recorded


def load_toml(path: Path) -> dict[str, Any]:
    """A TOML document; raises InvalidInput for any other file."""
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_DOCUMENT_BYTES + 1)
        if len(content) > MAX_DOCUMENT_BYTES:
            raise InvalidInput(f"{path}: expected a document of at most {MAX_DOCUMENT_BYTES} bytes, got more")
        return parsed_toml(content, path)
    except FileNotFoundError:
        raise InvalidInput(f"{path}: expected a TOML file, got no such file") from None
    except OSError as error:
        raise InvalidInput(f"{path}: cannot read the file: {error.strerror}") from None


def checked(model: type[T], document: dict[str, Any], where: Path) -> T:
    """The validated document; raises InvalidInput with a line that begins with ``where``."""
    try:
        # Through JSON, so that a document is validated as strictly as a message.
        return model.model_validate_json(json.dumps(document, default=str))
    except ValidationError as error:
        raise InvalidInput(f"{where}: {one_line(error)}") from None


def read_layer(folder: Path, name: str, document: RegionDocument) -> NDArray[Any]:
    """The raster of a layer, (rows, columns) with row 0 in the south, in the type of its file.

    Cells of the file's no-data value are NaN. Raises InvalidInput for a raster whose file says that its numbers are not
    the layer's values, or that it does not lie on the region's cells.
    """
    layer = document.layers[name]
    assert layer.file is not None  # the caller asks for layers with files
    path = folder / layer.file
    try:
        size = path.stat().st_size
        if size > MAX_RASTER_BYTES:
            raise InvalidInput(f"{path}: expected at most {MAX_RASTER_BYTES} bytes, got {size}")
        if layer.sha256:
            found = hashlib.sha256(path.read_bytes()).hexdigest()
            if found != layer.sha256:
                raise InvalidInput(
                    f"{path}: layer {name}: expected the sha256 of {DOCUMENT}, {layer.sha256[:16]}..., "
                    f"got {found[:16]}..."
                )
    except FileNotFoundError:
        raise InvalidInput(f"{path}: layer {name}: expected a GeoTIFF, got no such file") from None
    except OSError as error:
        raise InvalidInput(f"{path}: layer {name}: cannot read the raster: {error.strerror}") from None
    try:
        raster = read_tiff(path)
    except NotPlain as plain:
        raster = _read_by_gdal(path, str(plain))
    facts = facts_of(path)
    _expect_values(f"{path}: layer {name}", name, facts)
    _expect_cells(f"{path}: layer {name}", facts, document, raster.shape[0])
    # No-data cells of `traversable` keep their number: 0 is closed, another one is refused as no boolean.
    return np.flipud(raster if name == "traversable" else _with_holes(raster, facts.no_data))


def _with_holes(raster: NDArray[Any], no_data: float | None) -> NDArray[Any]:
    """The raster with NaN in cells of its file's no-data value; unchanged where there are none."""
    if no_data is None or math.isnan(no_data):
        return raster
    # As the raster's own type rounds it: -3.4028226550889045e38 is no float32.
    holes = raster == (np.asarray(no_data).astype(raster.dtype) if raster.dtype.kind == "f" else no_data)
    return np.where(holes, np.nan, raster) if holes.any() else raster


def _expect_values(where: str, name: str, facts: TiffFacts) -> None:
    """Raises InvalidInput if a file says that its numbers are not values in the unit of that layer."""
    if (facts.scale, facts.offset) != (1.0, 0.0):
        raise InvalidInput(
            f"{where}: expected values, got numbers with scale {facts.scale:g} and offset {facts.offset:g}"
        )
    if unit_factor(name, facts.unit) not in (None, 1.0):
        raise InvalidInput(f"{where}: expected values in the unit of the layer, got {facts.unit!r}")
    if facts.masked:
        raise InvalidInput(f"{where}: expected NaN or a no-data value in cells without a value, got a mask")


def _expect_cells(where: str, facts: TiffFacts, document: RegionDocument, rows: int) -> None:
    """Raises InvalidInput if a file places its raster of so many rows elsewhere than on the document's cells."""
    if facts.place is None:
        return
    x, y, width, height = facts.place
    if not (width > 0.0 and height > 0.0):
        raise InvalidInput(f"{where}: expected a raster with row 0 in the north, got another one")
    if document.kind == "window":
        return
    cell, size = document.resolution_m, height * METRES_PER_DEGREE if facts.degrees else height
    if abs(size - cell) > 0.01 * cell:
        raise InvalidInput(f"{where}: expected cells of resolution_m, {cell:g} m, got {size:.6g} m")
    if document.origin_x_m is None or document.origin_y_m is None or not document.crs or facts.degrees:
        return
    west, north = document.origin_x_m, document.origin_y_m + rows * cell
    if max(abs(x - west), abs(y - north)) > cell / 2 or abs(width - cell) > 0.01 * cell:
        raise InvalidInput(
            f"{where}: expected square cells from ({west:.10g}, {north:.10g}) m on, as origin_x_m and origin_y_m say, "
            f"got cells of {width:.6g} x {height:.6g} m from ({x:.10g}, {y:.10g}) m on"
        )


def _read_by_gdal(path: Path, why: str) -> NDArray[Any]:
    try:
        import rasterio
    except ImportError:
        raise InvalidInput(
            f"{why}: expected one plain band, uncompressed or deflated; others need: pip install he3-seeker[geo]"
        ) from None
    try:
        with rasterio.open(path) as source:
            if source.count != 1:
                raise InvalidInput(f"{path}: expected one band, got {source.count}")
            raster: NDArray[Any] = source.read(1)
            return raster
    except rasterio.errors.RasterioError as error:
        raise InvalidInput(f"{path}: expected a GeoTIFF, got {error}") from None

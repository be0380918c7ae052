"""`he3 region fetch`: windows of public products at a site, by range requests, and the region built from them.

Of a GeoTIFF, its directory and the blocks of the window are fetched; of a PDS3 image, its label and the rows of the
window. ``manifest.json`` names for each product the address, the ETag, the ranges and their checksum. When the command
is run again, what is here is held against it.
"""

from __future__ import annotations

import contextlib
import json
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from he3.errors import He3Error, InvalidInput
from he3.frames import SiteGrid
from services.mission.region_build.build import build_region, margin_cells
from services.mission.region_build.download import Range, RemoteFile
from services.mission.region_build.projection import SitePlane, site_plane
from services.mission.region_build.recipe import Recipe, SourceTable
from services.mission.region_build.sampling import needed
from services.mission.region_build.sites import Product, Site
from services.mission.region_build.sources import opened
from services.mission.region_folder import RegionDocument
from services.mission.tiff import NotPlain, TiffLayout, tiff_layout

MANIFEST: Final = "manifest.json"
_HEAD_BYTES: Final = 64 * 1024  # of a GeoTIFF: directories of overviews, which GDAL looks at
_MAX_LABEL_BYTES: Final = 1_000_000
_ITEM_BYTES: Final = {"8": 1, "16": 2, "32": 4, "64": 8}


def fetch_site(
    site: Site, out: Path, progress: Callable[[str], None] = lambda line: None, timeout_s: float = 30.0
) -> RegionDocument:
    """Fetch what a site needs into the folder ``out``, build its region there, and return its document.

    Raises He3Error in one line if a server cannot be reached or breaks off; a further call continues.
    """
    recipe = site.recipe()
    grid = SiteGrid(recipe.rows, recipe.columns, recipe.resolution_m)
    plane = site_plane(recipe.centre_lat_deg, recipe.centre_lon_deg, grid)
    try:
        out.mkdir(parents=True, exist_ok=True)
        earlier, manifest = _manifest(out), {}
        for product in site.products:
            progress(f"fetching {product.file}")
            file = RemoteFile(product.url, out / product.file, progress, timeout_s)
            if _is_damaged(file, earlier):
                progress(f"{product.file}: other bytes than {MANIFEST} says, fetched anew")
                file.forget()
            if product.label is not None:
                label = RemoteFile(product.label, out / product.label.rsplit("/", 1)[-1], progress, timeout_s)
                _fetch_image(product, file, label, recipe, plane, out)
            else:
                _fetch_geotiff(product, file, recipe, plane, out)
            manifest[product.url] = {
                "file": product.file, "etag": file.etag, "length": file.length, "ranges": file.ranges,
                "sha256_of_ranges": file.checksum(),
            }  # fmt: skip
        (out / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise He3Error(f"{out}: cannot write what is fetched: {error.strerror or error}") from None
    finally:
        with contextlib.suppress(OSError):
            out.rmdir()  # if nothing has arrived
    return build_region(recipe, out, out, progress)


def _manifest(out: Path) -> dict[str, Any]:
    """The manifest of an earlier fetch into that folder, by address; empty if there is none that can be read."""
    try:
        found = json.loads((out / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _is_damaged(file: RemoteFile, manifest: dict[str, Any]) -> bool:
    """Whether the ranges of the manifest are here with other bytes than it says."""
    entry = manifest.get(file.url)
    if not isinstance(entry, dict) or entry.get("ranges") != [list(part) for part in file.ranges]:
        return False  # it says nothing of what is here
    return bool(entry.get("sha256_of_ranges") != file.checksum())


def _fetch_geotiff(product: Product, file: RemoteFile, recipe: Recipe, plane: SitePlane, out: Path) -> None:
    try:
        file.read(0, _HEAD_BYTES)
        layout = tiff_layout(file.read, product.url)
    except NotPlain as plain:
        raise InvalidInput(f"{product.url}: expected a GeoTIFF of one band, got another: {plain}") from None
    for row, column, rows, columns in _windows(product, recipe, plane, out):
        file.need(_of_blocks(layout, row, column, rows, columns))


def _of_blocks(layout: TiffLayout, row: int, column: int, rows: int, columns: int) -> list[Range]:
    # A sparse file's empty blocks have no bytes. Some writers put the length of a block before it: 4 bytes.
    return [
        (max(0, block.offset - 4), block.offset + block.length + 4)
        for block in layout.blocks(row, column, rows, columns)
        if block.length > 0
    ]


def _fetch_image(
    product: Product, file: RemoteFile, label: RemoteFile, recipe: Recipe, plane: SitePlane, out: Path
) -> None:
    text = label.read(0, _MAX_LABEL_BYTES).decode("latin-1")
    file.read(0, 1)  # its length: GDAL wants a file of that length
    try:
        samples, bits = int(_word(text, "LINE_SAMPLES")), _ITEM_BYTES[_word(text, "SAMPLE_BITS")]
        start = _image_start(text)
    except (ValueError, KeyError):
        raise InvalidInput(f"{product.label}: expected a PDS3 label of an image, got other text") from None
    for row, _, rows, _ in _windows(product, recipe, plane, out):
        file.need([(start + row * samples * bits, start + (row + rows) * samples * bits)])


def _windows(product: Product, recipe: Recipe, plane: SitePlane, out: Path) -> list[tuple[int, int, int, int]]:
    """The windows (row, column, rows, columns) that the site needs: two for one across the seam of a global mosaic."""
    table: SourceTable = recipe.layers[product.layer]
    margin = margin_cells(recipe) if product.layer == "elevation_m" else 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # GDAL looks at overviews that are not here
        with opened(product.layer, table, out) as source:
            _, _, (row, column, rows, columns) = needed(source, plane, margin)
            first = column % source.columns if source.is_global else column
            width = min(columns, source.columns - first)
    windows = [(row, first, rows, width)]
    return windows if width == columns else [*windows, (row, 0, rows, columns - width)]


def _image_start(label: str) -> int:
    """Offset of the image's first byte, by the label's pointer: a record, or a byte, counted from one."""
    pointer = _word(label, r"\^IMAGE")
    found = re.search(r",\s*(\d+)\s*(<BYTES>)?", pointer) or re.fullmatch(r"(\d+)\s*(<BYTES>)?", pointer)
    if found is None:
        return 0
    at = int(found[1]) - 1
    return at if found[2] else at * int(_word(label, "RECORD_BYTES"))


def _word(label: str, key: str) -> str:
    found = re.search(rf"^\s*{key}\s*=\s*(.+?)\s*$", label, re.MULTILINE)
    if found is None:
        raise ValueError(key)
    return found[1]

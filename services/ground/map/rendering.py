"""Answers that are not JSON: arrays, pictures and tables, rendered once a revision and kept for equal requests."""

from __future__ import annotations

import io
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from he3.colour_maps import OF_LAYER, shaded
from he3.errors import InvalidInput
from schemas.maps import TABLES, MapAbout, MapBoxQuery, MapFormat, MapLayer, MapLayerQuery
from schemas.topics import MAP_BOX, MAP_LAYER, Topic
from services.ground.map import geotiff
from services.ground.map.history import as_of
from services.ground.map.layers import Cells, box, whole_layer
from services.ground.map.packing import packed
from services.ground.map.service import track
from services.runtime.queries.server import Encoded

if TYPE_CHECKING:
    from schemas.ground import MissionTrack
    from schemas.wire import Wire
    from services.ground.map.snapshot import MapSnapshot

NO_DATA = 42113  # TIFF tag, GDAL's
_FIGURES = (MapFormat.NPY, MapFormat.TIFF, MapFormat.CSV)
MEDIA_TYPES = {
    MapFormat.JSON: "application/json",
    MapFormat.NPY: "application/x-npy",
    MapFormat.PNG: "image/png",
    MapFormat.TIFF: "image/tiff",
    MapFormat.CSV: "text/csv",
    MapFormat.PACKED: "application/octet-stream",
}
MAX_KEPT_BYTES = 32 * 1024 * 1024
ENTRY_BYTES = 4096
"""Memory that a kept answer takes beside its payload: small answers are bounded in number, too."""


class Renderer:
    """Renders for several threads; equal requests of one revision are rendered once."""

    def __init__(self, most_kept_bytes: int = MAX_KEPT_BYTES) -> None:
        self._most = most_kept_bytes
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[Any, ...], Encoded] = OrderedDict()
        self._bytes = 0

    def __call__(self, topic: Topic, request: Wire, snapshot: MapSnapshot) -> Encoded | None:
        """The answer as bytes; None if the answer is a JSON message. Raises He3Error."""
        if topic is MAP_LAYER and isinstance(request, MapLayerQuery):
            if request.layer in TABLES:
                return rendered_table(request, as_of(snapshot, request.as_of))
        elif topic is not MAP_BOX or not isinstance(request, MapBoxQuery):
            return None
        if request.format is MapFormat.JSON:
            return None
        shown = as_of(snapshot, request.as_of)
        key = (shown.revision, request.model_copy(update={"as_of": None}))
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        cells = whole_layer(request, shown) if isinstance(request, MapLayerQuery) else box(request, shown)
        made = rendered(cells, request.format, shown)
        with self._lock:
            if key not in self._kept:
                self._kept[key] = made
                self._bytes += len(made.payload) + ENTRY_BYTES
            while self._bytes > self._most and len(self._kept) > 1:
                self._bytes -= len(self._kept.popitem(last=False)[1].payload) + ENTRY_BYTES
        return made


def rendered(cells: Cells, form: MapFormat, snapshot: MapSnapshot) -> Encoded:
    """The cells in that format, with a description as the attachment.

    In formats from which figures are computed, cells without a reference have no value: NaN. Pictures have one
    everywhere.
    """
    if form in _FIGURES and cells.known is not None:
        cells = replace(cells, values=np.where(cells.known, cells.values, np.float32(np.nan)))
    values = cells.values
    shown = values if cells.known is None else values[np.isfinite(values)]
    about = MapAbout(
        layer=cells.layer,
        format=form,
        rows=values.shape[0],
        columns=values.shape[1],
        resolution_m=cells.resolution_m,
        x_min_m=cells.x_min_m,
        y_min_m=cells.y_min_m,
        unit=cells.unit,
        low=float(shown.min()) if shown.size else 0.0,
        high=float(shown.max()) if shown.size else 0.0,
        revision=snapshot.revision,
        samples=len(snapshot.samples),
        mission_time_ns=snapshot.mission_time_ns,
        threshold_ppb=cells.threshold_ppb,
    )
    writers: dict[MapFormat, Callable[[], bytes]] = {
        MapFormat.NPY: lambda: npy(values),
        MapFormat.PNG: lambda: png(cells, about),
        MapFormat.TIFF: lambda: tiff(cells, snapshot),
        MapFormat.CSV: lambda: csv_of_cells(cells),
        MapFormat.PACKED: lambda: packed(values, about.low, about.high),
    }
    return Encoded(writers[form](), MEDIA_TYPES[form], about.model_dump_json().encode())


def npy(values: NDArray[Any]) -> bytes:
    """The array in NumPy's format."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, values, allow_pickle=False)
    return stream.getvalue()


def png(cells: Cells, about: MapAbout) -> bytes:
    """A picture of the cells, north up; probabilities from 0 to 1, everything else from its lowest to its highest."""
    from PIL import Image

    low, high = (0.0, 1.0) if cells.unit == "1" else (about.low, about.high)
    if cells.layer is MapLayer.ERROR:  # 0 has the colour in the middle
        low, high = -max(-low, high), max(-low, high)
    colours = shaded(cells.values.astype(np.float32), low, high, OF_LAYER[cells.layer.value])
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(colours[::-1])).save(stream, format="PNG")
    return stream.getvalue()


def tiff(cells: Cells, snapshot: MapSnapshot) -> bytes:
    """A GeoTIFF of the cells' values, north up."""
    from PIL import Image, TiffImagePlugin, TiffTags

    rows = cells.values.shape[0]
    site = snapshot.grid
    north = cells.y_min_m + rows * cells.resolution_m
    placed = geotiff.tags(snapshot.origin_deg, site.height_m, cells.x_min_m, north, cells.resolution_m)
    kinds = {"double": TiffTags.DOUBLE, "short": TiffTags.SHORT, "ascii": TiffTags.ASCII}
    directory: Any = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, (kind, content) in placed.items():
        directory.tagtype[tag] = kinds[kind]
        directory[tag] = content
    directory[270] = (
        f"He-3 map, layer {cells.layer.value} [{cells.unit}], revision {snapshot.revision}, "
        f"{len(snapshot.samples)} samples"
    )
    if cells.known is not None:
        directory.tagtype[NO_DATA] = TiffTags.ASCII
        directory[NO_DATA] = "nan"
    stream = io.BytesIO()
    image = Image.fromarray(np.ascontiguousarray(cells.values[::-1]))
    image.save(stream, format="TIFF", tiffinfo=directory)
    return stream.getvalue()


def csv_of_cells(cells: Cells) -> bytes:
    """One line a cell: x and y of its centre [m], and its value with all digits that a float32 has."""
    x = [f"{value:.10g}" for value in cells.x_m]
    lines = [f"x_m,y_m,{_column(cells)}"]
    for y, row in zip(cells.y_m, cells.values.tolist(), strict=True):
        middle = f",{y:.10g},"
        lines.extend(east + middle + f"{value:.9g}" for east, value in zip(x, row, strict=True))
    return ("\n".join(lines) + "\n").encode()


def rendered_table(request: MapLayerQuery, snapshot: MapSnapshot) -> Encoded:
    """Samples, or the paths driven and planned, as JSON or CSV."""
    of_samples = request.layer is MapLayer.SAMPLES
    if request.format is MapFormat.JSON:
        whole: MissionTrack = track(snapshot)
        fields = {"samples"} if of_samples else {"driven_path_m", "planned_path_m", "plan_ends"}
        return Encoded(whole.model_dump_json(include=fields).encode(), MEDIA_TYPES[MapFormat.JSON], b"")
    if request.format is not MapFormat.CSV:
        raise InvalidInput(
            f"map: layer '{request.layer.value}' is a table: expected format json or csv, got {request.format.value}"
        )
    rows: Iterable[tuple[Any, ...]]
    if of_samples:
        head = "sample_id,round,x_m,y_m,depth_m,helium3_ppb,noise_std_ppb,measured_at_ns,driven_m"
        rows = (
            (s.sample_id, s.round, s.x_m, s.y_m, s.depth_m, s.helium3_ppb, s.noise_std_ppb, s.measured_at, s.driven_m)
            for s in snapshot.samples
        )
    else:
        head = "path,x_m,y_m"
        paths = (("driven", snapshot.driven_path_m), ("planned", snapshot.planned_path_m))
        rows = ((name, x, y) for name, path in paths for x, y in path)
    text = "\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n"
    return Encoded(text.encode(), MEDIA_TYPES[MapFormat.CSV], b"")


def _column(cells: Cells) -> str:
    return cells.layer.value + ("" if cells.unit == "1" else f"_{cells.unit}")

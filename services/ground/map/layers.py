"""Layers and parts of layers, computed from one snapshot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from he3.errors import InvalidInput, OutsideRegion
from he3.frames import SiteGrid
from schemas.maps import RASTERS, MapBoxQuery, MapLayer, MapLayerQuery
from services.ground.map.snapshot import MapSnapshot

UNITS = {
    MapLayer.MEAN: "ppb",
    MapLayer.STD: "ppb",
    MapLayer.TRAVERSABLE: "1",
    MapLayer.INFORMATION: "nat",
    MapLayer.EXCEEDANCE: "1",
}
MAX_CELLS = 4_000_000
"""Of one answer: 16 MB of float32, a site of 2 km at 1 m."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A layer or a part of one: float32 or uint8 (rows, columns), row 0 in the south."""

    layer: MapLayer
    values: NDArray[Any]
    resolution_m: float
    x_min_m: float
    y_min_m: float
    threshold_ppb: float | None

    @property
    def unit(self) -> str:
        return UNITS[self.layer]

    @property
    def grid(self) -> SiteGrid:
        return SiteGrid(self.values.shape[0], self.values.shape[1], self.resolution_m)


def whole_layer(request: MapLayerQuery, snapshot: MapSnapshot) -> Cells:
    """The layer, or every `step`-th cell of it from the south-west corner on."""
    check_threshold(request.layer, request.threshold)
    step = request.step
    part = (slice(None, None, step), slice(None, None, step))
    values = _values(request.layer, request.threshold, snapshot, part)
    return Cells(request.layer, values, snapshot.grid.resolution_m * step, 0.0, 0.0, request.threshold)


def box(request: MapBoxQuery, snapshot: MapSnapshot) -> Cells:
    """The part of a layer between those edges: cells of the resolution asked for, each the map's at its centre.

    Raises OutsideRegion for a box that is not within the site, InvalidInput for an empty one or one of too many cells.
    """
    check_threshold(request.layer, request.threshold)
    grid = snapshot.grid
    x, y = (request.x_min, request.x_max), (request.y_min, request.y_max)
    if not (x[0] >= 0 and x[1] <= grid.width_m and y[0] >= 0 and y[1] <= grid.height_m):
        raise OutsideRegion(
            f"map box: expected edges within 0..{grid.width_m:g} m east and 0..{grid.height_m:g} m north, "
            f"got {x[0]:g}..{x[1]:g} and {y[0]:g}..{y[1]:g}"
        )
    if not (x[0] < x[1] and y[0] < y[1]):
        raise InvalidInput(
            f"map box: expected x_min < x_max and y_min < y_max, got {x[0]:g}..{x[1]:g} and {y[0]:g}..{y[1]:g}"
        )
    resolution = request.resolution_m or grid.resolution_m
    # A hair less, so that 0.3 / 0.1 is 3 cells and not 4.
    columns, rows = (max(1, math.ceil((edge[1] - edge[0]) / resolution - 1e-9)) for edge in (x, y))
    if rows * columns > MAX_CELLS or max(rows, columns) > 4096:
        raise InvalidInput(
            f"map box: expected at most {MAX_CELLS} cells and 4096 on a side, got {columns} x {rows}: "
            f"ask for a smaller box or a resolution_m above {resolution:g}"
        )
    part = np.ix_(
        _nearest(y[0], rows, resolution, grid.rows, grid.resolution_m),
        _nearest(x[0], columns, resolution, grid.columns, grid.resolution_m),
    )
    values = _values(request.layer, request.threshold, snapshot, part)
    return Cells(request.layer, values, resolution, x[0], y[0], request.threshold)


def information_nats(std_ppb: Any, noise_std_ppb: float) -> Any:
    """What a measurement tells about the field at its place: 1/2 log(1 + std^2 / noise^2) [nat]."""
    return 0.5 * np.log1p((std_ppb / np.float32(noise_std_ppb)) ** 2)


def exceedance(mean_ppb: Any, std_ppb: Any, threshold_ppb: float) -> Any:
    """Probability that the field is above the threshold, under a normal posterior."""
    return ndtr((mean_ppb - np.float32(threshold_ppb)) / np.maximum(std_ppb, np.float32(1e-12)))


def check_threshold(layer: MapLayer, threshold_ppb: float | None) -> None:
    """Raise InvalidInput unless the layer is a raster and a threshold is given where one is needed, and only there."""
    if layer not in RASTERS:
        raise InvalidInput(
            f"map: layer '{layer.value}' is a table, with no cells: ask earth/map/layer with format=json or csv"
        )
    if (layer is MapLayer.EXCEEDANCE) != (threshold_ppb is not None):
        raise InvalidInput(
            "map: expected threshold= [ppb] with layer exceedance, and only there, "
            f"got {'none' if threshold_ppb is None else f'{threshold_ppb:g}'} with {layer.value}"
        )


def _nearest(start_m: float, count: int, resolution_m: float, cells: int, cell_m: float) -> NDArray[np.intp]:
    centres = start_m + (np.arange(count) + 0.5) * resolution_m
    return np.clip((centres / cell_m).astype(np.intp), 0, cells - 1)


def _values(layer: MapLayer, threshold_ppb: float | None, snapshot: MapSnapshot, part: Any) -> NDArray[Any]:
    if layer is MapLayer.MEAN:
        values = snapshot.mean_ppb[part]
    elif layer is MapLayer.STD:
        values = snapshot.std_ppb[part]
    elif layer is MapLayer.TRAVERSABLE:
        return np.ascontiguousarray(snapshot.traversable[part]).view(np.uint8)
    elif layer is MapLayer.INFORMATION:
        values = information_nats(snapshot.std_ppb[part], snapshot.noise_std_ppb)
    else:
        assert threshold_ppb is not None, "checked at the edge"
        values = exceedance(snapshot.mean_ppb[part], snapshot.std_ppb[part], threshold_ppb)
    return np.ascontiguousarray(values, dtype="<f4")

"""Layers and parts of layers, computed from one snapshot.

Every answer is a raster of square cells, and the value of each is the map's at the centre of the cell: between the
map's own cells nothing is interpolated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, assert_never

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from he3.errors import InvalidInput, NotFound, OutsideRegion
from he3.intervals import normal_levels
from schemas.maps import MAX_CELLS, RASTERS, SIMULATED, TERRAIN, MapBoxQuery, MapLayer, MapLayerQuery
from services.ground.map.region_rasters import RegionRasters, region_rasters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from he3.frames import FloatArray
    from services.ground.map.snapshot import MapSnapshot

UNITS = {
    MapLayer.MEAN: "ppb",
    MapLayer.STD: "ppb",
    MapLayer.TRAVERSABLE: "1",
    MapLayer.INFORMATION: "nat",
    MapLayer.EXCEEDANCE: "1",
    MapLayer.ELEVATION: "m",
    MapLayer.SLOPE: "deg",
    MapLayer.SHADE: "1",
    MapLayer.REFERENCE: "ppb",
    MapLayer.ERROR: "ppb",
}
EDGE_CELLS = 1e-6
"""Tolerance [cells of the map] for rounding: a place this close to an edge, south or west of it, lies on it."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A layer or a part of one: float32 or uint8 (rows, columns), row 0 in the south."""

    layer: MapLayer
    values: NDArray[Any]
    resolution_m: float
    """Side of a cell."""
    x_min_m: float
    """West edge of the first column."""
    y_min_m: float
    """South edge of the first row."""
    threshold_ppb: float | None
    known: NDArray[np.bool_] | None = None
    """Of reference and error: where the reference is known, (rows, columns). None where all values are."""

    @property
    def unit(self) -> str:
        return UNITS[self.layer]

    @property
    def x_m(self) -> FloatArray:
        """(columns,) east coordinates of the centres."""
        return centres(self.x_min_m, self.values.shape[1], self.resolution_m)

    @property
    def y_m(self) -> FloatArray:
        """(rows,) north coordinates of the centres."""
        return centres(self.y_min_m, self.values.shape[0], self.resolution_m)


def whole_layer(request: MapLayerQuery, snapshot: MapSnapshot) -> Cells:
    """The layer, or every `step`-th cell of it from the south-west corner on.

    With a step the cells of the answer are that many times as large, about the same centres: the first ones reach out
    of the site to the south and west.
    """
    check_threshold(request.layer, request.threshold)
    step, cell_m = request.step, snapshot.grid.resolution_m
    part = (slice(None, None, step), slice(None, None, step))
    values = _values(request.layer, request.threshold, snapshot, part)
    edge = 0.5 * (1 - step) * cell_m
    known = _known(request.layer, snapshot, part)
    return Cells(request.layer, values, cell_m * step, edge, edge, request.threshold, known)


def box(request: MapBoxQuery, snapshot: MapSnapshot) -> Cells:
    """The part of a layer between those edges, in cells of the resolution asked for from its south-west corner on.

    They are as many as have their centre in the box. Without a resolution they are as large as the map's, but never
    larger than the box. Raises OutsideRegion for a box that is not within the site, InvalidInput for an empty one, one
    that holds no centre, or one of too many cells.
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
    sides = (x[1] - x[0], y[1] - y[0])
    resolution = request.resolution_m or min(grid.resolution_m, *sides)
    # A centre on the far edge is left out, so that rounding cannot put it outside.
    columns, rows = (math.ceil(side / resolution - 0.5 - EDGE_CELLS) for side in sides)
    if min(rows, columns) < 1:
        raise InvalidInput(
            f"map box: expected a resolution_m below {2 * min(sides):g}, so that the box holds the centre of a cell, "
            f"got {resolution:g}"
        )
    if rows * columns > MAX_CELLS:
        raise InvalidInput(
            f"map box: expected at most {MAX_CELLS} cells, got {columns} x {rows}: "
            f"ask for a smaller box or a resolution_m above {resolution:g}"
        )
    part = np.ix_(
        cell_indices(centres(y[0], rows, resolution), grid.rows, grid.resolution_m),
        cell_indices(centres(x[0], columns, resolution), grid.columns, grid.resolution_m),
    )
    values = _values(request.layer, request.threshold, snapshot, part)
    known = _known(request.layer, snapshot, part)
    return Cells(request.layer, values, resolution, x[0], y[0], request.threshold, known)


def information_nats(std_ppb: Any, noise_std_ppb: float) -> Any:
    """Mutual information of a measurement and the field at its place: 1/2 log(1 + std^2 / noise^2) [nat]."""
    return 0.5 * np.log1p((std_ppb / np.float32(noise_std_ppb)) ** 2)


def exceedance(mean_ppb: Any, std_ppb: Any, threshold_ppb: float, ends: Sequence[Any] | None) -> Any:
    """Probability that the field is above the threshold.

    ends: of the central intervals, in standard deviations from the mean; None for a normal belief.
    """
    below = (np.float32(threshold_ppb) - mean_ppb) / np.maximum(std_ppb, np.float32(1e-12))
    return ndtr(-(below if ends is None else normal_levels(below, ends)))


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


def centres(edge_m: float, count: int, cell_m: float) -> FloatArray:
    """Coordinates of the centres of `count` cells, the first of which begins at the edge."""
    return np.asarray(edge_m + (np.arange(count) + 0.5) * cell_m, dtype=np.float64)


def cell_indices(places_m: FloatArray, cells: int, cell_m: float) -> NDArray[np.intp]:
    """Index of the cell of the map in which each coordinate of the site lies, along an axis of that many cells.

    On an edge between two cells that is the one to the north or east.
    """
    return np.clip((places_m / cell_m + EDGE_CELLS).astype(np.intp), 0, cells - 1)


def _region(layer: MapLayer, snapshot: MapSnapshot) -> RegionRasters:
    """The rasters of the region, if that layer exists in this mission; raises NotFound."""
    if layer in SIMULATED and snapshot.score is None:
        raise NotFound(f"map: there is no layer {layer.value}: this mission has no reference field to compare with")
    found = region_rasters(snapshot)
    if layer in TERRAIN and not found.has_terrain:
        raise NotFound(f"map: there is no layer {layer.value}: the region has no elevation")
    return found


def _known(layer: MapLayer, snapshot: MapSnapshot, part: Any) -> NDArray[np.bool_] | None:
    known = _region(layer, snapshot).known if layer in SIMULATED else None
    return None if known is None else known[part]


def _values(layer: MapLayer, threshold_ppb: float | None, snapshot: MapSnapshot, part: Any) -> NDArray[Any]:
    match layer:
        case MapLayer.MEAN:
            values = snapshot.mean_ppb[part]
        case MapLayer.STD:
            values = snapshot.std_ppb[part]
        case MapLayer.TRAVERSABLE:
            return np.ascontiguousarray(snapshot.traversable[part]).view(np.uint8)
        case MapLayer.INFORMATION:
            values = information_nats(snapshot.std_ppb[part], snapshot.noise_std_ppb)
        case MapLayer.EXCEEDANCE:
            assert threshold_ppb is not None, "checked at the edge"
            values = exceedance(snapshot.mean_ppb[part], snapshot.std_ppb[part], threshold_ppb, snapshot.ends_at(part))
        case MapLayer.ELEVATION:
            values = _region(layer, snapshot).elevation_m[part]
        case MapLayer.SLOPE:
            values = _region(layer, snapshot).slope_deg[part]
        case MapLayer.SHADE:
            values = _region(layer, snapshot).shade[part]
        case MapLayer.REFERENCE:
            values = _region(layer, snapshot).reference_ppb[part]
        case MapLayer.ERROR:
            values = snapshot.mean_ppb[part] - _region(layer, snapshot).reference_ppb[part]
        case MapLayer.SAMPLES | MapLayer.PLAN:
            raise AssertionError(f"layer '{layer.value}' is a table; checked at the edge")
        case _:
            assert_never(layer)
    return np.ascontiguousarray(values, dtype="<f4")

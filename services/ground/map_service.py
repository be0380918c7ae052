"""Answers to operators' queries of the live map, each a pure function of the request and one snapshot."""

from __future__ import annotations

from base64 import b64encode

import numpy as np

from he3.errors import InvalidInput, OutsideRegion
from schemas.ground import MissionTrack
from schemas.maps import MapLayer, MapLayerQuery, MapPoint, MapPointQuery, MapRaster, MapScore
from schemas.topics import MAP_LAYER, MAP_POINT, MAP_SCORE, TRACK, Topic
from schemas.wire import Wire
from services.ground.snapshot import MapSnapshot

MAP_TOPICS: tuple[Topic, ...] = (MAP_POINT, MAP_LAYER, MAP_SCORE, TRACK)
"""The topics that are answered from a snapshot, by whichever thread holds one."""

_UNITS = {MapLayer.MEAN: "ppb", MapLayer.STD: "ppb", MapLayer.TRAVERSABLE: "1"}


def answer(topic: Topic, request: Wire, snapshot: MapSnapshot | None) -> Wire:
    """The reply to a request of one of the topics in `MAP_TOPICS`.

    Raises InvalidInput, or OutsideRegion for a place that the region does not contain, each with one line.
    """
    if snapshot is None:
        raise InvalidInput("map: there is none yet; ask again when the ground has begun")
    if topic is MAP_POINT and isinstance(request, MapPointQuery):
        return point(request, snapshot)
    if topic is MAP_LAYER and isinstance(request, MapLayerQuery):
        return layer(request, snapshot)
    if topic is MAP_SCORE:
        return score(snapshot)
    if topic is TRACK:
        return track(snapshot)
    raise InvalidInput(f"map: expected a query of {', '.join(known.name for known in MAP_TOPICS)}, got {topic.name}")


def point(request: MapPointQuery, snapshot: MapSnapshot) -> MapPoint:
    """The posterior at the centre of the cell that holds the place: cells are not interpolated between."""
    grid = snapshot.grid
    x, y = request.x, request.y
    if not (0.0 <= x <= grid.width_m and 0.0 <= y <= grid.height_m):
        raise OutsideRegion(
            f"map: expected a place within 0..{grid.width_m:g} m east and 0..{grid.height_m:g} m north, "
            f"got ({x:g}, {y:g})"
        )
    row = min(int(y / grid.resolution_m), grid.rows - 1)
    column = min(int(x / grid.resolution_m), grid.columns - 1)
    return MapPoint(
        x_m=x,
        y_m=y,
        mean_ppb=snapshot.mean_ppb.item(row, column),
        std_ppb=snapshot.std_ppb.item(row, column),
        traversable=snapshot.traversable.item(row, column),
        revision=snapshot.revision,
        samples=len(snapshot.samples),
        mission_time_ns=snapshot.mission_time_ns,
    )


def layer(request: MapLayerQuery, snapshot: MapSnapshot) -> MapRaster:
    """A layer, or every `step`-th cell of it from the south-west corner on, as little-endian numbers in base64."""
    whole = {
        MapLayer.MEAN: snapshot.mean_ppb,
        MapLayer.STD: snapshot.std_ppb,
        MapLayer.TRAVERSABLE: snapshot.traversable,
    }[request.layer]
    cells = np.ascontiguousarray(whole[:: request.step, :: request.step])
    flags = cells.dtype == np.bool_
    cells = cells.view(np.uint8) if flags else cells.astype("<f4", copy=False)
    return MapRaster(
        layer=request.layer,
        rows=cells.shape[0],
        columns=cells.shape[1],
        resolution_m=snapshot.grid.resolution_m * request.step,
        dtype="|u1" if flags else "<f4",
        data_base64=b64encode(cells.tobytes()).decode("ascii"),
        unit=_UNITS[request.layer],
        revision=snapshot.revision,
        samples=len(snapshot.samples),
        mission_time_ns=snapshot.mission_time_ns,
    )


def score(snapshot: MapSnapshot) -> MapScore:
    """How the map compares with the reference field."""
    if snapshot.score is None:
        raise InvalidInput("map: there is no score: this mission has no reference field to compare with")
    return snapshot.score


def track(snapshot: MapSnapshot) -> MissionTrack:
    """Samples, driven and planned path, and how the score went."""
    return MissionTrack(
        samples=snapshot.samples,
        driven_path_m=snapshot.driven_path_m,
        planned_path_m=snapshot.planned_path_m,
        score_history=snapshot.score_history,
        plan_ends=snapshot.plan_ends,
    )

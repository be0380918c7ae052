"""Answers to operators' queries of the live map, each a pure function of the request and one snapshot."""

from __future__ import annotations

import math
import zlib
from base64 import b64encode
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from he3.cross_validation import cross_validate
from he3.errors import InvalidInput, NotFound, NotReady, OutsideRegion
from he3.intervals import NORMAL_ENDS
from he3.realisations import realisations
from schemas.ground import MissionTrack
from schemas.maps import (
    CrossValidation,
    GradeTonnage,
    GradeTonnageQuery,
    MapBoxQuery,
    MapHistory,
    MapLayerQuery,
    MapPoint,
    MapPointQuery,
    MapRaster,
    MapRealisations,
    MapRegion,
    MapRevision,
    MapScore,
    MapSite,
    PredictedSample,
    RealisationsQuery,
    ResourceEstimate,
    ResourceQuery,
)
from schemas.topics import (
    MAP_BOX,
    MAP_CROSS_VALIDATION,
    MAP_GRADE_TONNAGE,
    MAP_HISTORY,
    MAP_LAYER,
    MAP_POINT,
    MAP_REALISATIONS,
    MAP_REGION,
    MAP_RESOURCE,
    MAP_SCORE,
    TRACK,
    Topic,
)
from services.ground.map.history import as_of, revisions
from services.ground.map.layers import EDGE_CELLS, Cells, box, exceedance, whole_layer
from services.ground.map.resources import estimate, grade_tonnage_curve

if TYPE_CHECKING:
    from schemas.wire import Wire
    from services.ground.map.snapshot import MapSnapshot

MAP_TOPICS: tuple[Topic, ...] = (
    MAP_POINT,
    MAP_LAYER,
    MAP_SCORE,
    MAP_CROSS_VALIDATION,
    MAP_GRADE_TONNAGE,
    MAP_REALISATIONS,
    TRACK,
    MAP_BOX,
    MAP_RESOURCE,
    MAP_HISTORY,
    MAP_REGION,
)
"""The topics that are answered from a snapshot alone, in any thread."""


SLOW_TOPICS: tuple[Topic, ...] = (
    MAP_CROSS_VALIDATION,
    MAP_GRADE_TONNAGE,
    MAP_REALISATIONS,
    MAP_RESOURCE,
)
"""Those whose answers may take seconds."""


def answer(topic: Topic, request: Wire, snapshot: MapSnapshot | None) -> Wire:
    """The reply to a request of one of the topics in `MAP_TOPICS`.

    Raises InvalidInput, OutsideRegion for a place that the region does not contain, NotReady while there is no map, and
    NotFound for a score without a reference field, each with one line.
    """
    if snapshot is None:
        raise NotReady("map: there is none yet; ask again when the ground has begun")
    how = _ANSWERS.get(topic)
    if how is None:
        raise InvalidInput(
            f"map: expected a query of {', '.join(known.name for known in MAP_TOPICS)}, got {topic.name}"
        )
    reply: Wire = how(request, as_of(snapshot, getattr(request, "as_of", None)))
    return reply


def point(request: MapPointQuery, snapshot: MapSnapshot) -> MapPoint:
    """The posterior at the centre of the cell that holds the place; nothing is interpolated."""
    grid = snapshot.grid
    x, y = request.x, request.y
    if not grid.has((x, y)):
        raise OutsideRegion(
            f"map: expected a place within 0..{grid.width_m:g} m east and 0..{grid.height_m:g} m north, "
            f"got ({x:g}, {y:g})"
        )
    row = min(int(y / grid.resolution_m + EDGE_CELLS), grid.rows - 1)
    column = min(int(x / grid.resolution_m + EDGE_CELLS), grid.columns - 1)
    mean, std = snapshot.mean_ppb.item(row, column), snapshot.std_ppb.item(row, column)
    x_m, y_m = ((index + 0.5) * grid.resolution_m for index in (column, row))
    reach = NORMAL_ENDS if snapshot.intervals is None else snapshot.intervals.at(x_m, y_m)
    low_95, low_68, high_68, high_95 = (mean + end * std for end in reach)
    above = None if request.threshold is None else float(exceedance(mean, std, request.threshold, reach))
    return MapPoint(
        x_m=x,
        y_m=y,
        mean_ppb=mean,
        std_ppb=std,
        traversable=snapshot.traversable.item(row, column),
        revision=snapshot.revision,
        samples=len(snapshot.samples),
        mission_time_ns=snapshot.mission_time_ns,
        information_nats=0.5 * math.log1p((std / snapshot.noise_std_ppb) ** 2),
        exceedance=above,
        low_68_ppb=max(0.0, low_68),  # there is no less than no helium-3
        high_68_ppb=max(0.0, high_68),
        low_95_ppb=max(0.0, low_95),
        high_95_ppb=max(0.0, high_95),
    )


def layer(request: MapLayerQuery, snapshot: MapSnapshot) -> MapRaster:
    """A layer, or every `step`-th cell of it from the south-west corner on, as little-endian numbers in base64."""
    return raster(whole_layer(request, snapshot), snapshot)


def part(request: MapBoxQuery, snapshot: MapSnapshot) -> MapRaster:
    """A part of a layer at the resolution asked for, as little-endian numbers in base64."""
    return raster(box(request, snapshot), snapshot)


def raster(cells: Cells, snapshot: MapSnapshot) -> MapRaster:
    """The cells as a message."""
    rows, columns = cells.values.shape
    return MapRaster(
        layer=cells.layer,
        rows=rows,
        columns=columns,
        resolution_m=cells.resolution_m,
        dtype="|u1" if cells.values.dtype == np.uint8 else "<f4",
        data_base64=b64encode(cells.values.tobytes()).decode("ascii"),
        unit=cells.unit,
        revision=snapshot.revision,
        samples=len(snapshot.samples),
        mission_time_ns=snapshot.mission_time_ns,
        x_min_m=cells.x_min_m,
        y_min_m=cells.y_min_m,
        threshold_ppb=cells.threshold_ppb,
    )


def score(snapshot: MapSnapshot) -> MapScore:
    """How the map compares with the reference field."""
    if snapshot.score is None:
        raise NotFound("map: there is no score: this mission has no reference field to compare with")
    return snapshot.score


def cross_validation(snapshot: MapSnapshot) -> CrossValidation:
    """Each sample as the others predict it."""
    process = snapshot.process
    if process is None or not len(process):
        raise NotReady("map cross-validation: there are no samples yet; ask again when there are")
    if len(process) != len(snapshot.samples):
        raise NotReady("map cross-validation: the belief does not have all samples yet; ask again in a moment")
    found = cross_validate(process)
    within_68, within_95 = found.within
    figures = zip(snapshot.samples, found.expected_ppb, found.std_ppb, found.scores, strict=True)
    return CrossValidation(
        rmse_ppb=found.rmse_ppb,
        bias_ppb=found.bias_ppb,
        score_rms=found.score_rms,
        within_68=within_68,
        within_95=within_95,
        samples=tuple(
            PredictedSample(
                sample_id=sample.sample_id,
                x_m=sample.x_m,
                y_m=sample.y_m,
                measured_ppb=sample.helium3_ppb,
                expected_ppb=float(expected),
                std_ppb=float(std),
                score=float(score),
            )
            for sample, expected, std, score in figures
        ),
        revision=snapshot.revision,
        mission_time_ns=snapshot.mission_time_ns,
    )


def curve(request: GradeTonnageQuery, snapshot: MapSnapshot) -> GradeTonnage:
    """How much ground lies above each cut-off, and what it holds."""
    return grade_tonnage_curve(request, snapshot)


def drawn(request: RealisationsQuery, snapshot: MapSnapshot) -> MapRealisations:
    """Fields drawn from the belief; equal queries of one revision have equal answers."""
    if snapshot.process is None:
        raise NotReady("map realisations: there is no belief yet to draw from; ask again in a moment")
    seed = zlib.crc32(f"realisations {snapshot.revision}".encode())
    fields, grid = realisations(snapshot.process, snapshot.grid, request.count, np.random.default_rng(seed))
    return MapRealisations(
        count=request.count,
        rows=grid.rows,
        columns=grid.columns,
        resolution_m=grid.resolution_m,
        data_base64=b64encode(fields.astype("<f4").tobytes()).decode("ascii"),
        revision=snapshot.revision,
        samples=len(snapshot.samples),
        mission_time_ns=snapshot.mission_time_ns,
    )


def track(snapshot: MapSnapshot) -> MissionTrack:
    """Samples, driven and planned path, areas, and the score after each round."""
    return MissionTrack(
        samples=snapshot.samples,
        driven_path_m=snapshot.driven_path_m,
        planned_path_m=snapshot.planned_path_m,
        score_history=snapshot.score_history,
        plan_ends=snapshot.plan_ends,
        keep_outs=snapshot.keep_outs,
        interests=snapshot.interests,
    )


def resource(request: ResourceQuery, snapshot: MapSnapshot) -> ResourceEstimate:
    """Helium-3 in an area."""
    return estimate(request, snapshot)


def history(snapshot: MapSnapshot) -> MapHistory:
    """The site, and the revisions that `as_of` can name."""
    grid = snapshot.grid
    lat, lon = snapshot.origin_deg or (None, None)
    return MapHistory(
        site=MapSite(
            rows=grid.rows,
            columns=grid.columns,
            resolution_m=grid.resolution_m,
            origin_lat_deg=lat,
            origin_lon_deg=lon,
            noise_std_ppb=snapshot.noise_std_ppb,
            provenance=snapshot.provenance,
        ),
        revisions=tuple(
            MapRevision(
                revision=each.revision,
                samples=len(each.samples),
                mission_time_ns=each.mission_time_ns,
                mean_std_ppb=each.mean_std_ppb,
            )
            for each in revisions(snapshot)
        ),
    )


def region(snapshot: MapSnapshot) -> MapRegion:
    """The region under the map."""
    if snapshot.region is None:
        raise NotFound("map: there is no account of the region")
    return snapshot.region


_ANSWERS: Final[Mapping[Topic, Callable[[Any, MapSnapshot], Wire]]] = {
    MAP_POINT: point,
    MAP_LAYER: layer,
    MAP_BOX: part,
    MAP_RESOURCE: resource,
    MAP_SCORE: lambda _, snapshot: score(snapshot),
    MAP_CROSS_VALIDATION: lambda _, snapshot: cross_validation(snapshot),
    MAP_GRADE_TONNAGE: curve,
    MAP_REALISATIONS: drawn,
    TRACK: lambda _, snapshot: track(snapshot),
    MAP_HISTORY: lambda _, snapshot: history(snapshot),
    MAP_REGION: lambda _, snapshot: region(snapshot),
}

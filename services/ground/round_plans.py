"""From a planner's answer to a round as it goes up: planned elsewhere, checked and named here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, isfinite
from typing import Any

import numpy as np

from he3.errors import InvalidInput
from he3.frames import FloatArray, Place, SiteGrid, as_points
from he3.posterior.grid import GridPosterior
from schemas.plans import PlannedSample, RoundPlan
from services.ground.planners import planner_named
from services.ground.planners.interface import PlannedRound, Planner, PlanningRequest

START_TOLERANCE_M = 0.5  # how far from where it was asked to begin a planned round may begin
MAX_VERTICES = 4096  # of a path, as the message admits


@dataclass(frozen=True, slots=True)
class PlanInWork:
    """A round that is being planned."""

    job: str
    number: int
    start_m: Place
    samples: int
    samples_left: int
    attempt: int
    known: int
    """Measurements in the map when planning began."""
    pending: tuple[str, ...]
    """Measurements under way that are counted in."""


def run_planner(planner: str | Planner, request: PlanningRequest, pending: int) -> PlannedRound:
    """The planner's answer, with the last `pending` of the observed places counted in first.

    Pure and picklable, made to run elsewhere. The posterior variance does not depend on values, so places whose values
    are not known yet lower it all the same.
    """
    if pending:
        values = np.zeros(len(request.observed_m))
        ahead = GridPosterior.build(request.grid, request.hyperparameters, request.observed_m, values)
        request = replace(request, std_ppb=ahead.std_ppb)
    function = planner_named(planner) if isinstance(planner, str) else planner
    return function(request)


def round_plan(work: PlanInWork, result: Any, grid: SiteGrid, version: str, depth_m: float) -> RoundPlan:
    """The planner's answer as it goes up; raises InvalidInput if it is not what was asked for.

    version: what sets the ids of its samples apart from those of an earlier plan of that round; depth_m: of each hole.
    """
    if not isinstance(result, PlannedRound):
        raise InvalidInput(f"planner: expected a planned round, got {type(result).__name__}")
    path, places = as_points(result.path_m), as_points(result.samples_m)
    if not (1 <= len(places) <= work.samples and 1 <= len(path) <= MAX_VERTICES):
        raise InvalidInput(
            f"planner: expected 1 to {work.samples} samples on 1 to {MAX_VERTICES} vertices, "
            f"got {len(places)} on {len(path)}"
        )
    if hypot(path[0, 0] - work.start_m[0], path[0, 1] - work.start_m[1]) > START_TOLERANCE_M:
        raise InvalidInput(f"planner: expected a path from {work.start_m}, got one from {tuple(path[0].tolist())}")
    if not grid.contains(np.vstack((path, places))).all():
        raise InvalidInput("planner: expected a round within the region, got one that leaves it")
    return RoundPlan(
        round=work.number,
        path_m=tuple(_rounded(place) for place in path),
        samples=tuple(
            PlannedSample(
                sample_id=sample_id(work.number, version, index),
                x_m=_rounded(place)[0],
                y_m=_rounded(place)[1],
                depth_m=depth_m,
            )
            for index, place in enumerate(places, 1)
        ),
        information_nats=float(result.information_nats) if isfinite(result.information_nats) else 0.0,
    )


def sample_id(number: int, version: str, index: int) -> str:
    """The id of the sample at that place of a round, from 1: ``r07s3``, or ``r07v12s3`` in a later version."""
    return f"r{number:02d}{version}s{index}"


def _rounded(place: FloatArray) -> Place:
    """To the millimetre: below what a rover holds, and half the bytes."""
    return round(float(place[0]), 3), round(float(place[1]), 3)

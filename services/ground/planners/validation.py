"""Validation of planners' answers, ours and plug-ins' alike: a rover can drive every accepted answer.

A round starts where it was asked to, stays on open ground and within the budget, and takes its samples on its path in
the order in which the path reaches them.
"""

from __future__ import annotations

from math import hypot, isfinite

import numpy as np

from he3.errors import InvalidInput
from he3.frames import FloatArray, as_points, path_length
from schemas.ground import GoalForecast
from services.ground.planners.interface import PlannedRound, PlanningRequest
from services.ground.planners.traversability import open_ground

START_TOLERANCE_M = 0.5  # between where a round was asked to begin and where it begins
MAX_VERTICES = 4096  # of a path, as the message admits
ON_PATH_M = 0.01  # distance within which a sample lies on the path
ROUNDING_NATS = 1e-9  # below zero, an information that is zero may come out


def checked_answer(name: str, answer: object, request: PlanningRequest) -> PlannedRound:
    """The answer with arrays of floats; raises InvalidInput, in one line, unless it is a round that can be driven.

    name: the planner's, for the line.
    """
    if not isinstance(answer, PlannedRound):
        raise InvalidInput(f"planner {name}: expected a PlannedRound, got {type(answer).__name__}")
    path, samples = _points(name, "path_m", answer.path_m), _points(name, "samples_m", answer.samples_m)
    if not (1 <= len(path) <= MAX_VERTICES and 1 <= len(samples) <= request.samples):
        raise InvalidInput(
            f"planner {name}: expected 1 to {MAX_VERTICES} vertices and 1 to {request.samples} samples, "
            f"got {len(path)} and {len(samples)}"
        )
    if hypot(*(path[0] - request.start_m)) > START_TOLERANCE_M:
        raise InvalidInput(f"planner {name}: expected a path from {request.start_m}, got {tuple(path[0].tolist())}")
    if (metres := path_length(path)) > request.budget_m * (1.0 + 1e-9):
        raise InvalidInput(f"planner {name}: expected {request.budget_m:.1f} m at most, got {metres:.1f} m")
    if request.cost is not None and (cost := request.cost.of_path(path)) > request.budget_m * (1.0 + 1e-9):
        raise InvalidInput(f"planner {name}: expected {request.budget_m:.1f} level m at most, got {cost:.1f} level m")
    _check_legs(name, request, path)
    _check_samples(name, path, samples)
    outlook = None if answer.outlook_m is None else _points(name, "outlook_m", answer.outlook_m)
    if outlook is not None and not request.grid.contains(outlook).all():
        raise InvalidInput(f"planner {name}: expected outlook_m within the region, got places outside")
    forecast: object = answer.forecast  # a plug-in may have put anything there
    if forecast is not None and not isinstance(forecast, GoalForecast):
        raise InvalidInput(f"planner {name}: expected a forecast of the goal or None, got {type(forecast).__name__}")
    nats = answer.information_nats
    if not (isinstance(nats, (float, int, np.floating)) and isfinite(nats) and nats >= -ROUNDING_NATS):
        raise InvalidInput(f"planner {name}: expected information_nats of 0 or more, got {nats!r}")
    return PlannedRound(path, samples, max(0.0, float(nats)), outlook, answer.forecast)


def error_text(error: BaseException) -> str:
    """The error's kind and text on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")


def _points(name: str, which: str, values: object) -> FloatArray:
    """Places (k, 2) [m]; k may be 0."""
    try:
        points = np.array(values, dtype=np.float64)
        return as_points(points) if points.size else np.zeros((0, 2))
    except (InvalidInput, TypeError, ValueError) as error:
        raise InvalidInput(f"planner {name}: {which}: {error_text(error)}") from None


def _check_legs(name: str, request: PlanningRequest, path: FloatArray) -> None:
    """Every leg is free, but for the step by which a rover on the edge of a cell finds its footing."""
    ground = open_ground(request.grid, request.traversable, request.margin_m)
    inside = request.grid.contains(path)
    if not inside.all():
        raise InvalidInput(f"planner {name}: expected a path within the region, got {tuple(path[~inside][0].tolist())}")
    footing = ground.footing(request.start_m)
    begins, ends = path[:-1].copy(), path[1:].copy()
    if len(begins):
        begins[0] = footing
    free = ground.segments_free(begins, ends)
    if not free.all():
        (ax, ay), (bx, by) = begins[~free][0], ends[~free][0]
        nearer = f", or nearer to them than {request.margin_m:g} m" if request.margin_m else ""
        raise InvalidInput(
            f"planner {name}: expected legs over open ground, got one from ({ax:.1f}, {ay:.1f}) to "
            f"({bx:.1f}, {by:.1f}) m through closed cells{nearer}"
        )


def _check_samples(name: str, path: FloatArray, samples: FloatArray) -> None:
    """Every sample lies on the path, none before the one that precedes it."""
    reached = 0.0
    for x, y in samples:
        apart, at = _distances_from_legs(path, float(x), float(y))
        on_path = apart <= ON_PATH_M
        if not on_path.any():
            raise InvalidInput(
                f"planner {name}: expected samples on the path, got one at ({x:.1f}, {y:.1f}) m, "
                f"{apart.min():.1f} m from it"
            )
        ahead = at[on_path & (at >= reached - ON_PATH_M)]
        if not len(ahead):
            raise InvalidInput(
                f"planner {name}: expected samples in the order in which the path reaches them, got one at "
                f"({x:.1f}, {y:.1f}) m after one beyond it"
            )
        reached = float(ahead.min())


def _distances_from_legs(path: FloatArray, x: float, y: float) -> tuple[FloatArray, FloatArray]:
    """For each leg of a polyline (K, 2): how far from it a place is [m], and how far along is the nearest point [m]."""
    begin = path[:-1] if len(path) > 1 else path
    along = np.diff(path, axis=0) if len(path) > 1 else np.zeros((1, 2))
    length = np.hypot(*along.T)
    share = np.clip((([x, y] - begin) * along).sum(axis=1) / np.maximum(length**2, 1e-300), 0.0, 1.0)
    apart: FloatArray = np.hypot(*(begin + share[:, None] * along - [x, y]).T)
    return apart, np.concatenate(([0.0], np.cumsum(length)[:-1])) + share * length

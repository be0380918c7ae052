"""Anybody's planner: found by name, and its answers checked before anything drives by them.

``module:function`` is a function of a module in the working directory or on Python's path, which takes a
``PlanningRequest`` and returns a ``PlannedRound``. What ours are tested never to do, somebody's planner may: cross an
obstacle, jump, sample beside its path, overdraw the budget, break. Each is refused in one line.
"""

from __future__ import annotations

import sys
import traceback
from functools import partial
from importlib import import_module
from math import hypot
from pathlib import Path

import numpy as np

from he3.errors import He3Error, InvalidInput
from he3.frames import FloatArray, as_points, path_length
from services.ground.planners.traversability import OpenGround
from services.ground.planning import PlannedRound, Planner, PlanningRequest

START_TOLERANCE_M = 0.5  # a round may begin so far from where the rover was said to be
ON_PATH_M = 0.01  # a sample may be so far from the path


def own_planner(name: str) -> Planner:
    """The planner of that name, its answers checked; raises InvalidInput if there is none."""
    module, _, function = name.partition(":")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    try:
        planner = getattr(import_module(module), function, None)
    except Exception as error:  # noqa: BLE001 - whatever importing somebody's module does
        line = " ".join(str(error).split())
        raise InvalidInput(f"planner {name}: expected a module to import from the working directory or Python's path, "
                           f"got {type(error).__name__}: {line}") from None  # fmt: skip
    if not callable(planner):
        raise InvalidInput(f"planner {name}: expected a function {function} in {module}, got none")
    return partial(_checked, name, planner)


def _checked(name: str, planner: Planner, request: PlanningRequest) -> PlannedRound:
    try:
        answer = planner(request)
    except He3Error:
        raise
    except Exception as error:
        where, line = traceback.extract_tb(error.__traceback__)[-1], " ".join(str(error).split())
        raise InvalidInput(f"planner {name}: expected a PlannedRound or NoRoute, got {type(error).__name__}: {line} "
                           f"({Path(where.filename).name}, line {where.lineno})") from error  # fmt: skip
    if not isinstance(answer, PlannedRound):
        raise InvalidInput(f"planner {name}: expected a PlannedRound, got {type(answer).__name__}")
    path, samples = as_points(answer.path_m), as_points(answer.samples_m)
    if not (len(path) and 1 <= len(samples) <= request.samples):
        raise InvalidInput(f"planner {name}: expected a path and 1 to {request.samples} samples, got {len(path)} "
                           f"vertices and {len(samples)}")  # fmt: skip
    if hypot(*(path[0] - request.start_m)) > START_TOLERANCE_M:
        raise InvalidInput(f"planner {name}: expected a path from {request.start_m}, got {tuple(path[0].tolist())}")
    if (metres := path_length(path)) > request.budget_m * (1.0 + 1e-9):
        raise InvalidInput(f"planner {name}: expected {request.budget_m:.1f} m at most, got {metres:.1f} m")
    _check_legs(name, request, path)
    _check_samples(name, path, samples)
    return answer


def _check_legs(name: str, request: PlanningRequest, path: FloatArray) -> None:
    """Every leg is free, but for the step by which a rover on the edge of a cell finds its footing."""
    ground = OpenGround(request.grid, request.traversable)
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
        raise InvalidInput(f"planner {name}: expected legs over open ground, got one from ({ax:.1f}, {ay:.1f}) to "
                           f"({bx:.1f}, {by:.1f}) m through closed cells")  # fmt: skip


def _check_samples(name: str, path: FloatArray, samples: FloatArray) -> None:
    """Every sample lies on the path."""
    for x, y in samples:
        nearest = _distance_to(path, float(x), float(y))
        if nearest > ON_PATH_M:
            raise InvalidInput(f"planner {name}: expected samples on the path, got one at ({x:.1f}, {y:.1f}) m, "
                               f"{nearest:.1f} m from it")  # fmt: skip


def _distance_to(path: FloatArray, x: float, y: float) -> float:
    """Distance [m] from a place to a polyline (K, 2)."""
    begin, along = path[:-1], np.diff(path, axis=0)
    if not len(begin):
        return float(hypot(path[0, 0] - x, path[0, 1] - y))
    squared = np.maximum((along * along).sum(axis=1), 1e-300)
    share = np.clip((([x, y] - begin) * along).sum(axis=1) / squared, 0.0, 1.0)
    return float(np.hypot(*(begin + share[:, None] * along - [x, y]).T).min())

"""Anybody's planner: found by name, and its answers checked before anything drives by them.

``module:function`` is a function of a module in the working directory or on Python's path, which takes a
``PlanningRequest`` and returns a ``PlannedRound``. What ours are tested never to do, somebody's planner may: cross an
obstacle, jump, sample beside its path or backwards along it, overdraw the budget, print, exit, break. What it prints
goes to the log, anything else is refused in one line.
"""

from __future__ import annotations

import sys
import traceback
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from math import hypot, isfinite
from pathlib import Path

import numpy as np

from he3.errors import InvalidInput, NoRoute
from he3.frames import FloatArray, as_points, path_length
from services.ground.planners.interface import PlannedRound, Planner, PlanningRequest
from services.ground.planners.traversability import OpenGround

START_TOLERANCE_M = 0.5  # a round may begin so far from where the rover was said to be
MAX_VERTICES = 4096  # of a path, as a message admits
ON_PATH_M = 0.01  # a sample may be so far from the path


def load_plugin(name: str) -> Planner:
    """The planner of that name, its answers checked; raises InvalidInput if there is none."""
    module, _, function = name.partition(":")
    if not (module and function):
        raise InvalidInput(f"expected a planner as module:function, got {name!r}")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    try:
        with redirect_stdout(sys.stderr):
            found = import_module(module)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever importing somebody's module does
        raise InvalidInput(f"planner {name}: expected a module to import from the working directory or Python's path, "
                           f"got {_one_line(error)}") from None  # fmt: skip
    planner = getattr(found, function, None)
    if not callable(planner):
        came = "none" if planner is None else type(planner).__name__
        raise InvalidInput(f"planner {name}: expected a function {function} in {module}, got {came}")
    return partial(_checked, name, planner)


def _checked(name: str, planner: Planner, request: PlanningRequest) -> PlannedRound:
    """The planner's answer as ours would be, with arrays of floats; raises InvalidInput for one that cannot be."""
    try:
        answer = planner(request)
    except NoRoute:
        raise
    except (Exception, SystemExit) as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        raise InvalidInput(f"planner {name}: expected a PlannedRound or NoRoute, got {_one_line(error)} "
                           f"({Path(where.filename).name}, line {where.lineno})") from error  # fmt: skip
    if not isinstance(answer, PlannedRound):
        raise InvalidInput(f"planner {name}: expected a PlannedRound, got {type(answer).__name__}")
    path, samples = _points(name, "path_m", answer.path_m), _points(name, "samples_m", answer.samples_m)
    if not (1 <= len(path) <= MAX_VERTICES and 1 <= len(samples) <= request.samples):
        raise InvalidInput(f"planner {name}: expected 1 to {MAX_VERTICES} vertices and 1 to {request.samples} "
                           f"samples, got {len(path)} and {len(samples)}")  # fmt: skip
    if hypot(*(path[0] - request.start_m)) > START_TOLERANCE_M:
        raise InvalidInput(f"planner {name}: expected a path from {request.start_m}, got {tuple(path[0].tolist())}")
    if (metres := path_length(path)) > request.budget_m * (1.0 + 1e-9):
        raise InvalidInput(f"planner {name}: expected {request.budget_m:.1f} m at most, got {metres:.1f} m")
    _check_legs(name, request, path)
    _check_samples(name, path, samples)
    outlook = None if answer.outlook_m is None else _points(name, "outlook_m", answer.outlook_m)
    if outlook is not None and not request.grid.contains(outlook).all():
        raise InvalidInput(f"planner {name}: expected outlook_m within the region, got places outside")
    nats = answer.information_nats
    if not (isinstance(nats, (float, int, np.floating)) and isfinite(nats) and nats >= 0):
        raise InvalidInput(f"planner {name}: expected information_nats of 0 or more, got {nats!r}")
    return PlannedRound(path, samples, float(nats), outlook)


def _one_line(error: BaseException) -> str:
    """The error's kind and text on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")


def _points(name: str, which: str, values: object) -> FloatArray:
    """Places (k, 2) [m], none of them for none."""
    try:
        points = np.array(values, dtype=np.float64)
        return as_points(points) if points.size else np.zeros((0, 2))
    except (InvalidInput, TypeError, ValueError) as error:
        raise InvalidInput(f"planner {name}: {which}: {_one_line(error)}") from None


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
    """Every sample lies on the path, none before the one that precedes it."""
    reached = 0.0
    for x, y in samples:
        apart, at = _distances_from_legs(path, float(x), float(y))
        on_path = apart <= ON_PATH_M
        if not on_path.any():
            raise InvalidInput(f"planner {name}: expected samples on the path, got one at ({x:.1f}, {y:.1f}) m, "
                               f"{apart.min():.1f} m from it")  # fmt: skip
        ahead = at[on_path & (at >= reached - ON_PATH_M)]
        if not len(ahead):
            raise InvalidInput(f"planner {name}: expected samples in the order in which the path reaches them, got one "
                               f"at ({x:.1f}, {y:.1f}) m after one beyond it")  # fmt: skip
        reached = float(ahead.min())


def _distances_from_legs(path: FloatArray, x: float, y: float) -> tuple[FloatArray, FloatArray]:
    """For each leg of a polyline (K, 2): how far from it a place is [m], and how far along is the nearest point [m]."""
    begin = path[:-1] if len(path) > 1 else path
    along = np.diff(path, axis=0) if len(path) > 1 else np.zeros((1, 2))
    length = np.hypot(*along.T)
    share = np.clip((([x, y] - begin) * along).sum(axis=1) / np.maximum(length**2, 1e-300), 0.0, 1.0)
    apart: FloatArray = np.hypot(*(begin + share[:, None] * along - [x, y]).T)
    return apart, np.concatenate(([0.0], np.cumsum(length)[:-1])) + share * length

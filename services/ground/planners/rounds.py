"""A round from a path: sample places along it, its part within a budget, and the information of its samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from he3.errors import NoRoute
from he3.frames import path_length
from he3.gp import GaussianProcess
from he3.information import information_gain
from services.ground.planners.interface import PlannedRound, PlanningRequest

if TYPE_CHECKING:
    from he3.driving_cost import TerrainCost
    from he3.frames import FloatArray, Place

MAX_SHARE_RATIO = 1.5
"""Largest part of the remaining budget that a round takes, in even shares: so the last rounds keep some of it."""


def arc_lengths(path_m: FloatArray) -> FloatArray:
    """Distance (K,) [m] along the polyline (K, 2) [m] from its first vertex to each vertex."""
    steps = np.diff(path_m, axis=0)
    return np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))


def places_along(path_m: FloatArray, count: int) -> FloatArray:
    """Places (count, 2) [m] at equal distances along the polyline (K, 2) [m], the last at its end."""
    along = arc_lengths(path_m)
    at = along[-1] * np.arange(1, count + 1) / count
    places = np.column_stack((np.interp(at, along, path_m[:, 0]), np.interp(at, along, path_m[:, 1])))
    places[-1] = path_m[-1]
    return places


def path_prefix(path_m: FloatArray, length_m: float) -> FloatArray:
    """The first ``length_m`` metres of the polyline (K, 2) [m], or all of it if it is not longer."""
    along = arc_lengths(path_m)
    if along[-1] <= length_m:
        return path_m
    whole = int(np.searchsorted(along, length_m, side="right"))
    share = (length_m - along[whole - 1]) / (along[whole] - along[whole - 1])
    end = path_m[whole - 1] + share * (path_m[whole] - path_m[whole - 1])
    return np.vstack((path_m[:whole], end))


def affordable(path_m: FloatArray, budget_m: float, cost: TerrainCost | None) -> FloatArray:
    """The part of the polyline (K, 2) [m] that a budget admits: in metres, or with a cost in level metres."""
    return path_prefix(path_m, budget_m if cost is None else cost.metres_for(path_m, budget_m))


def lead_cost(request: PlanningRequest, footing: Place) -> float:
    """Length [m], or with a cost that cost [level m], of the way from the rover to where its legs begin."""
    lead = np.array([request.start_m, footing], dtype=np.float64)
    return path_length(lead) if request.cost is None else request.cost.of_path(lead)


def budget_share_m(request: PlanningRequest) -> float:
    """This round's even share of the remaining budget [m]. Raises NoRoute if the budget is spent."""
    if not request.budget_m > 0:
        raise NoRoute(f"the travel budget is spent: {request.budget_m:g} m remain for {request.samples_left} samples")
    return request.budget_m * request.samples / request.samples_left


def belief_given(request: PlanningRequest) -> GaussianProcess:
    """The belief given the observed places, without values: only its covariances are meaningful."""
    belief = GaussianProcess(request.hyperparameters)
    return belief.condition_on_places(request.observed_m) if request.observed_m.size else belief


def planned_round(request: PlanningRequest, path_m: FloatArray, samples_m: FloatArray) -> PlannedRound:
    """The round with this path (K, 2) [m] and these sample places (k, 2) [m].

    The path begins at the start, or at the place that the rover drives to first (``OpenGround.footing``).
    """
    start = np.array(request.start_m, dtype=np.float64)
    path = path_m if np.array_equal(path_m[0], start) else np.vstack((start, path_m))
    covariance = belief_given(request).posterior_covariance(samples_m)
    nats = information_gain(covariance, request.hyperparameters.noise_variance_ppb2)
    return PlannedRound(path_m=path, samples_m=samples_m, information_nats=nats)

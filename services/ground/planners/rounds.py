"""A round from a path: its part within a budget, and the information of its samples."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from he3.errors import NoRoute
from he3.frames import path_length
from he3.gp import GaussianProcess
from he3.information import information_gain
from services.ground.planners.interface import PlannedRound, PlanningRequest
from services.ground.planners.polyline import path_prefix

if TYPE_CHECKING:
    from he3.driving_cost import TerrainCost
    from he3.frames import FloatArray, Place

MAX_SHARE_RATIO = 1.5
"""Largest part of the remaining budget that a round takes, in even shares: so the last rounds keep some of it."""


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
        raise NoRoute(
            f"the travel budget is spent: {max(request.budget_m, 0.0):g} m remain for {request.samples_left} samples"
        )
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


def after_way_back(planned: PlannedRound, request: PlanningRequest) -> PlannedRound:
    """The planned round, which begins with the way back that the request names, if there is one."""
    if request.back_m is None:
        return planned
    joined = np.vstack((request.back_m, planned.path_m))
    stays = np.concatenate(([False], (np.diff(joined, axis=0) == 0.0).all(axis=1)))
    return replace(planned, path_m=joined[~stays])

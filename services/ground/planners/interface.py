"""The request and the answer of every planner: frozen values and arrays, no I/O, no clock, no global generator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid, as_points, path_length

if TYPE_CHECKING:
    from he3.certificate import Targets
    from he3.driving_cost import TerrainCost
    from he3.gp import Hyperparameters
    from schemas.ground import GoalForecast

STEP_SHARE = 0.02
"""1, share of the site's width that a tree's longest edge takes at least: the paper's 10 m of 500 m."""


@dataclass(frozen=True, slots=True)
class PlannerOptions:
    """The settings of the planners; the defaults are the paper's, for its sites of 500 m."""

    clearance_m: float = 15.0
    """Least distance of a target from every sample [m] (`rrt`, `rrtstar`)."""
    step_m: float = 10.0
    """Longest edge of a tree [m]."""
    goal_tolerance_m: float = 10.0
    """A target counts as reached within this distance [m]."""
    max_iterations: int = 5000
    """Bound on tree growth; planning ends after iterations, never after a time."""
    information_exponent: float = 1.0
    """alpha of the utility u = I^alpha / c (`informative`)."""
    extra: dict[str, float] = field(default_factory=dict)
    """Settings of one planner, by name; a planner refuses names that it does not know."""

    def on_site(self, grid: SiteGrid) -> PlannerOptions:
        """These settings, with steps and tolerances no finer than a cell and than their share of the site's width.

        A tree of 10 m steps has no path across a site of many kilometres, however long it grows.
        """
        least_m = max(grid.resolution_m, STEP_SHARE * max(grid.width_m, grid.height_m))
        return replace(self, step_m=max(self.step_m, least_m), goal_tolerance_m=max(self.goal_tolerance_m, least_m))


@dataclass(frozen=True, slots=True, eq=False)
class PlanningGoal:
    """When the map is good enough (`ground.goal`)."""

    targets: Targets
    std_ppb: float
    """Greatest standard deviation at the targets [ppb]."""
    probability: float
    """Probability of the hyperparameters under which it is to hold."""


@dataclass(frozen=True, slots=True)
class PlanningRequest:
    """The input of a planner for one round."""

    grid: SiteGrid
    traversable: NDArray[np.bool_]
    """(rows, columns): where the rover's centre may be; keep-outs are already subtracted, and so is the footprint where
    ``margin_m`` is 0."""
    start_m: tuple[float, float]
    """Where the round begins (x, y) [m]."""
    observed_m: FloatArray
    """(n, 2) places [m] that are measured or will be: the samples of plans under way are included."""
    std_ppb: NDArray[np.float32]
    """(rows, columns) posterior standard deviation [ppb] given all of ``observed_m``."""
    hyperparameters: Hyperparameters
    samples: int
    """Number of samples of this round."""
    samples_left: int
    """Number of samples of the rest of the mission, this round included."""
    budget_m: float
    """Distance that the rest of the mission may drive [m], this round included; may be infinite. With a `cost` it is in
    level metres, and bounds the cost, which is never below the distance."""
    seed: int
    """Determines every random choice of the planner."""
    interest: NDArray[np.float32] | None = None
    """(rows, columns) weight >= 0 of each cell's uncertainty; None means 1 everywhere."""
    options: PlannerOptions = field(default_factory=PlannerOptions)
    outlook_m: FloatArray | None = None
    """(k, 2) places [m] where the last plan expected to sample after its round, in that order; None if it had none.
    A planner may start from it, so that consecutive plans agree."""
    cost: TerrainCost | None = None
    """What legs cost (`ground.cost`); None: their length."""
    goal: PlanningGoal | None = None
    """When the mission may end before its last sample; None: never."""
    back_m: FloatArray | None = None
    """(k, 2) polyline [m] on which the rover drives back, the way that it came, before `start_m`, where it ends; None:
    the rover stands there. The ground puts it before the planner's path, and takes its cost off the budget."""
    margin_m: float = 0.0
    """Distance that every leg keeps from closed cells [m], because the rover has a width: on a site of large cells."""


@dataclass(frozen=True, slots=True)
class PlannedRound:
    """One round: a polyline from the rover's place, and the places on it where samples are taken."""

    path_m: FloatArray
    """(K, 2) polyline [m] from the start; every leg is traversable."""
    samples_m: FloatArray
    """(samples, 2) places [m] on the path, in the order in which they are reached."""
    information_nats: float
    """Mutual information between the round's measurements and the field, given all samples before [nats]."""
    outlook_m: FloatArray | None = None
    """(k, 2) places [m] where the planner expects to sample after this round, in order; None if it plans one round."""
    forecast: GoalForecast | None = None
    """What the goal takes from this round on; None without a goal, and from planners that do not foresee it."""

    @property
    def length_m(self) -> float:
        """Length of the path [m]."""
        return path_length(self.path_m)


Planner = Callable[[PlanningRequest], PlannedRound]
"""Raises NoRoute if no round is possible: the rover is walled in, the budget is spent, or no place is left."""


def validated(request: PlanningRequest) -> PlanningRequest:
    """The request itself, if its shapes and numbers fit; raises InvalidInput otherwise."""
    for name in ("traversable", "std_ppb", "interest"):
        array = getattr(request, name)
        if array is not None and array.shape != request.grid.shape:
            raise InvalidInput(f"planning: expected {name} of shape {request.grid.shape}, got {array.shape}")
    if request.samples < 1 or request.samples_left < request.samples:
        raise InvalidInput(
            f"planning: expected 1 <= samples <= samples_left, got {request.samples} and {request.samples_left}"
        )
    if request.seed < 0:
        raise InvalidInput(f"planning: expected a seed of 0 or more, got {request.seed}")
    as_points(np.array([request.start_m]))
    if request.observed_m.size:
        as_points(request.observed_m)
    if request.outlook_m is not None and request.outlook_m.size:
        as_points(request.outlook_m)
    return request

"""The published planners, as a faithful baseline: drive to the most uncertain place along a tree's path, unsmoothed.

The target is the most uncertain cell that the rover can reach, at least ``clearance_m`` from every sample. A tree of
at most ``max_iterations`` iterations grows from the rover, by steps of 10 m, until a node lies within 10 m of the
target. Its path is driven as it is, and the samples are taken at equal distances along it, the last at its end. The
uncertainty determines the target alone, not the path.

`rrtstar` rewires within min(50 m, 150 m sqrt(log n / n)), exactly (see ``trees``), and like `rrt` it ends when the
target is reached: typically after 900 iterations (450 to 2600) of the 5000 allowed. The setting ``refine_iterations``
continues to that many, for shorter paths.

Four cases that the paper does not treat. Far from all samples the uncertainty equals the prior's to the last digits of
a float32; of places that are equally uncertain in this sense, the one farthest from all samples is the target, as it
would be with more digits (in the first round, the one farthest from the rover). If a tree does not reach its target
within the bound, the next two most uncertain targets are tried, then the longest of the approaching paths is driven.
If none of the trees left the place where the rover stands, in a corner behind an obstacle, a complete search over the
cells finds the way to the first target.
Under a finite budget, targets lie within the round's even share of it, and a path ends after
``MAX_SHARE_RATIO`` times that share.
"""

from __future__ import annotations

from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from he3.errors import InvalidInput, NoRoute
from he3.frames import FloatArray, Place, SiteGrid, path_length
from services.ground.planners.interface import PlannedRound, PlanningRequest, validated
from services.ground.planners.polyline import places_along
from services.ground.planners.rounds import MAX_SHARE_RATIO, affordable, budget_share_m, lead_cost, planned_round
from services.ground.planners.routes import RouteFinder
from services.ground.planners.traversability import open_ground
from services.ground.planners.trees import GrowthSettings, tree_path

TARGETS_TRIED = 3
TIE = 1e-4
"""Relative difference below which two uncertainties are equal: float32 rounding, with a margin."""
SETTINGS = ("refine_iterations",)


def rrt(request: PlanningRequest) -> PlannedRound:
    """The round along the paper's RRT. Raises NoRoute, or InvalidInput for an inconsistent request."""
    return _towards_most_uncertain(request, optimal=False)


def rrtstar(request: PlanningRequest) -> PlannedRound:
    """The round along the paper's RRT*. Raises NoRoute, or InvalidInput for an inconsistent request."""
    return _towards_most_uncertain(request, optimal=True)


def _towards_most_uncertain(request: PlanningRequest, *, optimal: bool) -> PlannedRound:
    options = validated(request).options
    if unknown := set(options.extra) - set(SETTINGS):
        raise InvalidInput(f"rrt and rrtstar know the settings {', '.join(SETTINGS)}; got {', '.join(sorted(unknown))}")
    share_m = budget_share_m(request)
    ground = open_ground(request.grid, request.traversable, request.margin_m)
    start = ground.footing(request.start_m)
    limit_m = min(request.budget_m, MAX_SHARE_RATIO * share_m) - lead_cost(request, start)
    growth = GrowthSettings(goal_tolerance_m=options.goal_tolerance_m).coarser(options.step_m)
    rng = np.random.default_rng(request.seed)
    candidates = _candidates(request, ground.connected_to(start), start, share_m)
    best = np.array([start])
    targets: list[Place] = []
    for _ in range(TARGETS_TRIED):
        target = _most_uncertain(request, candidates, rng)
        if target is None:
            break
        targets.append(target)
        path, reached = tree_path(
            ground, start, target, optimal=optimal, iterations=options.max_iterations, seed=request.seed, growth=growth,
            refine=int(options.extra.get("refine_iterations", 0)), cost=request.cost if optimal else None,
        )  # fmt: skip
        if reached or path_length(path) > path_length(best):
            best = path
        if reached:
            break
        _close_disc(candidates, request.grid, target, options.goal_tolerance_m)
    if targets and path_length(best) <= 0.0:
        best = RouteFinder(ground).route(start, targets[0])
    best = affordable(best, limit_m, request.cost)
    if path_length(best) <= 0.0:
        raise NoRoute(
            f"no target was reached from ({start[0]:g}, {start[1]:g}) m within {options.max_iterations} iterations "
            f"and {limit_m:g} m"
        )
    return planned_round(request, best, places_along(best, request.samples))


def _candidates(
    request: PlanningRequest, connected: NDArray[np.bool_], start: Place, share_m: float
) -> NDArray[np.bool_]:
    """(rows, columns): whether a cell may be a target: reachable, clear of samples and start, within the budget."""
    grid, options = request.grid, request.options
    candidates = connected.copy()
    for x, y in request.observed_m:
        _close_disc(candidates, grid, (float(x), float(y)), options.clearance_m)
    _close_disc(candidates, grid, start, options.goal_tolerance_m)
    if isfinite(share_m):
        distance = np.hypot(grid.x_m[None, :] - start[0], grid.y_m[:, None] - start[1])
        near = candidates & (distance <= share_m)
        # If the share is too small for any target, the rover drives towards one as far as the share allows.
        candidates = near if near.any() else candidates
    if not candidates.any():
        raise NoRoute(
            f"no target from ({start[0]:g}, {start[1]:g}) m: none of the {int(connected.sum())} cells that can be "
            f"reached lies {options.goal_tolerance_m:g} m from there and {options.clearance_m:g} m from every sample"
        )
    return candidates


def _most_uncertain(request: PlanningRequest, candidates: NDArray[np.bool_], rng: np.random.Generator) -> Place | None:
    """Centre [m] of the candidate cell with the largest uncertainty times interest; None if there is no candidate."""
    cells = np.flatnonzero(candidates.ravel())
    if not cells.size:
        return None
    weighted: FloatArray = request.std_ppb.ravel()[cells].astype(np.float64)
    if request.interest is not None:
        weighted *= request.interest.ravel()[cells]
    equally_good = cells[weighted >= weighted.max() * (1.0 - TIE)]
    if equally_good.size > 1:
        equally_good = _farthest(equally_good, request)
    row, column = divmod(int(rng.choice(equally_good)), request.grid.columns)
    size = request.grid.resolution_m
    return (column + 0.5) * size, (row + 0.5) * size


def _farthest(cells: NDArray[np.intp], request: PlanningRequest) -> NDArray[np.intp]:
    """The cells (flat indices) farthest from all samples, or from the rover if there is no sample."""
    grid = request.grid
    known = request.observed_m if request.observed_m.size else np.array([request.start_m])
    elsewhere = np.ones(grid.shape, dtype=np.bool_)
    elsewhere[grid.cells_of(known)] = False
    distance = ndimage.distance_transform_edt(elsewhere).ravel()[cells]
    farthest: NDArray[np.intp] = cells[distance >= distance.max()]
    return farthest


def _close_disc(mask: NDArray[np.bool_], grid: SiteGrid, centre_m: Place, radius_m: float) -> None:
    """Clear the mask, in place, at cells whose centre lies within the radius [m] of the place."""
    if radius_m == inf:
        mask[:] = False
        return
    x, y, size = centre_m[0], centre_m[1], grid.resolution_m
    rows = slice(max(int((y - radius_m) / size) - 1, 0), max(int((y + radius_m) / size) + 2, 0))
    columns = slice(max(int((x - radius_m) / size) - 1, 0), max(int((x + radius_m) / size) + 2, 0))
    near = (grid.x_m[None, columns] - x) ** 2 + (grid.y_m[rows, None] - y) ** 2 < radius_m**2
    mask[rows, columns] &= ~near

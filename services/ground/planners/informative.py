"""The paper's utility, computed: an RRT* tree over everything within reach, and of all its paths the best by

    u = I^alpha / (c + c0)

with I the joint mutual information [nats] of the path's sample places, given all samples so far, as far as it is about
the site, and c its length [m].
A tree of some 3,000 nodes has as many paths; the covariances of their places are one batch, and so are their
determinants.

Three additions keep u useful, and all of them matter more than alpha.

*The cost of a round besides its metres*, c0. With c0 = 0 the shortest path always wins: I grows with the logarithm of
the variance, c from zero, and 150 samples end within 230 m of the start. But each sample takes an hour or more of
drilling; at 0.1 m/s an hour is worth 360 m. So c0 is ``sample_cost_m`` for each of the round's
samples. That is for 150 samples on a site of 500 m, each of which represents s x s metres, s^2 = area / n; where s is
larger, c0 is larger in proportion. On a wide site all that is not known lies kilometres away, and paths of a hundred
metres would be the best for ever. A mission of few samples would take them all near its start.
Means of 3 or 4 seeds, Matern 5/2, over 30 rounds of 5 samples (t1, then t2; `rrtstar`: 0.81 at 14.5 km, 0.50
at 14.9), flown before the third addition:

    sample_cost_m     100          150          200          300          480         1000
    RMSE [ppb]     0.793 0.465  0.795 0.470  0.786 0.468  0.764 0.470  0.773 0.468  0.802 0.466
    driven [km]      5.3  5.5     6.0  6.2     6.1  6.6     6.7  7.2     7.6  8.3     9.4  9.5

At 300 m, RMSE and metres were below those of `rrtstar` with every kernel; at 150 m, missions with rough kernels
(Matern 1/2) drive 3.5 km only and their maps are worse.

*The least length scale.* Samples along short paths make the fitted length scale short; with a short length scale
places 20 m apart are almost independent, and the paths get shorter still: 150 samples in one corner. But n samples have
to represent the whole region for any length scale. So for the choice of a path, and for that alone, no correlation
falls to a half before ``least_scale`` s. (For the squared
exponential at 1,000 m a sample, that reduced the RMSE on t1 from 0.847 to 0.785 ppb.)

*The site's edge.* A field is least known where it has the fewest neighbours, so the most informative places of all lie
along the edge, where much of what a sample tells is about ground outside the site (Krause, Singh & Guestrin 2008,
sect. 3). Each of n samples represents s x s metres; of the information of a sample counts the share of that square
which lies in the site: half of it at an edge, a quarter in a corner. (60 missions of 40 samples on plateaus: RMSE 0.42
of the field's deviation where it was 0.49, the worst 0.64 where it was 0.93, at 93 % of the metres. Of 150 samples
on t1 and t2 few lie near an edge: 0.789 and 0.471 ppb at 6.7 and 7.1 km where it was 0.783 and 0.476 at 6.8 and 7.1,
10 seeds, Matern 5/2.)

Under a finite budget a round takes at most ``pace`` times its even share of what remains.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from he3.errors import InvalidInput, NoRoute
from he3.frames import FloatArray, SiteGrid, path_length
from he3.information import information_gains
from he3.kernels import kernel_from
from he3.mixture import heaviest_of
from services.ground.planners.cheapest import cheapest_ways
from services.ground.planners.gentle import on_gentle_ground
from services.ground.planners.interface import PlannedRound, PlannerOptions, PlanningRequest, validated
from services.ground.planners.polyline import places_along
from services.ground.planners.rounds import (
    MAX_SHARE_RATIO,
    affordable,
    belief_given,
    budget_share_m,
    lead_cost,
    planned_round,
)
from services.ground.planners.traversability import open_ground
from services.ground.planners.trees import GrowthSettings, Tree, exploration_tree
from services.ground.planners.unreached import with_paths_further

if TYPE_CHECKING:
    from he3.driving_cost import TerrainCost
    from he3.hyperparameters import Hyperparameters

DEFAULTS = {
    "iterations": 3600.0,
    "sample_cost_m": 300.0,
    "least_scale": 1.0,
    "pace": MAX_SHARE_RATIO,
    "rewire_scale_m": 400.0,
}
"""Settings by name. The tree's rewiring radius shrinks more slowly than the paper's, which makes paths shorter.

``sample_cost_m`` is that of samples ``_USUAL_SPACING_M`` apart, and of a tree with steps of ``PlannerOptions.step_m``.
"""
_USUAL_SPACING_M = 500.0 / sqrt(150.0)
_LENGTH_SCALES = ("length_scale_m", "rough_length_scale_m")


def informative(request: PlanningRequest) -> PlannedRound:
    """The round along the best path of the tree. Raises NoRoute, or InvalidInput for an inconsistent request."""
    options = validated(request).options
    if unknown := set(options.extra) - set(DEFAULTS):
        raise InvalidInput(f"informative knows the settings {', '.join(DEFAULTS)}; got {', '.join(sorted(unknown))}")
    settings = DEFAULTS | options.extra
    request = on_gentle_ground(request)
    share_m = budget_share_m(request)
    ground = open_ground(request.grid, request.traversable, request.margin_m)
    start = ground.footing(request.start_m)
    lead_m = lead_cost(request, start)
    growth = GrowthSettings(rewire_scale_m=settings["rewire_scale_m"]).coarser(options.step_m)
    iterations = min(int(settings["iterations"]), options.max_iterations)
    cost = request.cost
    tree = exploration_tree(ground, start, iterations=iterations, seed=request.seed, growth=growth, cost=cost)
    tree = with_paths_further(tree, ground, options.step_m)
    away_m = np.hypot(*(tree.nodes_m - start).T)
    if away_m.max() <= options.goal_tolerance_m:
        raise NoRoute(
            f"no path leads farther than {options.goal_tolerance_m:g} m from ({start[0]:g}, {start[1]:g}) m: "
            f"a tree of {iterations} iterations reached {len(away_m) - 1} places"
        )
    cost_m = tree.cost_m + lead_m if cost is None else path_costs(tree, cost) + lead_m
    nodes = np.flatnonzero(tree.cost_m > 0.0)
    limit_m = max(settings["pace"] * share_m, float(cost_m[nodes].min()))  # at least the cheapest path
    nodes = nodes[cost_m[nodes] <= limit_m]
    area_m2 = float(ground.connected_to(start).sum()) * request.grid.resolution_m**2
    spacing_m = sqrt(area_m2 / (len(request.observed_m) + request.samples_left))
    hyperparameters = with_least_length_scale(heaviest_of(request.hyperparameters), settings["least_scale"] * spacing_m)
    places = places_on_paths(tree, nodes, request.samples)
    shares = shares_inside(request.grid, places, spacing_m)
    nats = path_information(replace(request, hyperparameters=hyperparameters), places, shares)
    sample_cost_m = settings["sample_cost_m"]
    if "sample_cost_m" not in options.extra:
        sample_cost_m *= max(1.0, spacing_m / _USUAL_SPACING_M, options.step_m / PlannerOptions().step_m)
    utility = nats**options.information_exponent / (cost_m[nodes] + sample_cost_m * request.samples)
    path = affordable(tree.path_to(int(nodes[np.argmax(utility)])), request.budget_m - lead_m, cost)
    places = places_along(path, request.samples)
    if cost is not None:
        stops_m = path_length(path) * np.arange(1, request.samples + 1) / request.samples
        path = cheapest_ways(ground, cost, path, stops_m, request.seed)
        path[-1] = places[-1]
    return planned_round(request, path, places)


def path_costs(tree: Tree, cost: TerrainCost) -> FloatArray:
    """Cost (N,) [level m] of the path from the tree's root to each of its nodes."""
    symmetric = tree.summed(cost.of_legs(tree.nodes_m[np.maximum(tree.parents, 0)], tree.nodes_m))
    height = cost.heights(tree.nodes_m)
    costs: FloatArray = symmetric + 0.5 * cost.climb * (height - height[0])
    return costs


def shares_inside(grid: SiteGrid, places_m: FloatArray, side_m: float) -> FloatArray:
    """Share (...,) of the square of that side [m] around each of the places (..., 2) [m] that lies in the site.

    A square that is larger than the site counts as one of the site's size.
    """
    shares = np.ones(places_m.shape[:-1])
    for axis, extent_m in enumerate((grid.width_m, grid.height_m)):
        side = min(side_m, extent_m)
        at = places_m[..., axis]
        shares *= (np.minimum(at + 0.5 * side, extent_m) - np.maximum(at - 0.5 * side, 0.0)).clip(0.0) / side
    return shares


def path_information(request: PlanningRequest, places_m: FloatArray, shares: FloatArray) -> FloatArray:
    """Joint mutual information (N,) [nats] of each of N sets of k sample places (N, k, 2) [m], given the observations.

    shares: (N, k), how much of each sample's information counts. If the request has interest, the field's deviation at
    a place is multiplied by its weight.
    """
    covariance = belief_given(request).posterior_covariances(places_m)
    if request.interest is not None:
        weight = request.interest[request.grid.cells_of(places_m.reshape(-1, 2))].reshape(places_m.shape[:2])
        covariance *= weight[:, :, None] * weight[:, None, :]
    return information_gains(covariance, request.hyperparameters.noise_variance_ppb2, shares)


def with_least_length_scale(hyperparameters: Hyperparameters, least_m: float) -> Hyperparameters:
    """The hyperparameters with length scales raised so that no correlation is below a half within ``least_m`` [m]."""
    kernel = hyperparameters.kernel
    least_scale_m = least_m / kernel.half_correlation_scales
    short = {k: least_scale_m for k, v in kernel.parameters().items() if k in _LENGTH_SCALES and v < least_scale_m}
    if not short:
        return hyperparameters
    return replace(hyperparameters, kernel=kernel_from(kernel.name, {**kernel.parameters(), **short}))


def places_on_paths(tree: Tree, nodes: NDArray[np.intp], count: int) -> FloatArray:
    """Places (N, count, 2) [m] at equal distances along the path from the root to each of the nodes (N,).

    The last is the node itself. The search climbs from the nodes by leaps of 2^j ancestors, for all places at once.
    """
    at = tree.cost_m[nodes][:, None] * (np.arange(1, count + 1) / count)
    leaps = [np.maximum(tree.parents, 0)]
    for _ in range(ceil(np.log2(len(tree.nodes_m) + 1))):
        if not leaps[-1].any():
            break
        leaps.append(leaps[-1][leaps[-1]])
    below = np.broadcast_to(nodes[:, None], at.shape)
    for leap in reversed(leaps):
        above = leap[below]
        below = np.where(tree.cost_m[above] >= at, above, below)
    above = np.maximum(tree.parents[below], 0)
    leg = tree.cost_m[below] - tree.cost_m[above]
    share = np.clip((at - tree.cost_m[above]) / np.where(leg > 0.0, leg, 1.0), 0.0, 1.0)[:, :, None]
    places: FloatArray = tree.nodes_m[above] + share * (tree.nodes_m[below] - tree.nodes_m[above])
    return places

"""One design for all remaining samples and the tour through it: an initial spread, then optimised together.

First the places are spread over what the samples so far leave uncovered, each at the centroid of its own share (a
centroidal Voronoi tessellation: Lloyd 1982), and a short tour is laid through them. If the budget is too small for that
tour, fewer and larger shares are visited, and the samples are placed along that tour. Then all places move at once down
the gradient of

    V(P) + lambda L(P)

with V the field's average posterior variance, L the tour's length and lambda the price of a metre: a fixed minimum, or
more where the budget binds. The price at which a step shortens the tour just enough follows from the two gradients.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from he3.frames import FloatArray, path_length
from he3.tsp import short_tour
from services.ground.planners.polyline import places_along
from services.ground.planners.tour.legs import cost_of_bent_legs

if TYPE_CHECKING:
    from he3.driving_cost import TerrainCost
    from he3.frames import IntArray
    from he3.i_optimal_design import AverageVariance
    from services.ground.planners.tour.site import Site

LLOYD_ITERATIONS = 12
REORDER_EVERY = 6
"""Steps of the places between two improvements of their order."""
MAX_STEP_M = 8.0
"""Longest step of a place [m]. This and the next two hold for samples 10 m to 1 km apart, see ``step_scale``."""
FIRST_STEP_M = 3.0
"""Root mean square step at the beginning [m], unless the budget requires more."""
PULL_CELLS = 1.0
"""Distance over which the legs' costs are compared to find where terrain is cheaper [cells]."""
LAST_STEP_M = 0.4
"""Root mean square step at the end [m], unless the budget requires more."""
OVERBUDGET_WEIGHT = 2.0
"""Per cent of variance by which a tour must be better for each per cent by which it exceeds the budget."""


def initial_design(site: Site, sampled_m: FloatArray, samples: int, budget_m: float, first_node: int) -> FloatArray:
    """Places (samples, 2) [m] in the order of a tour of about the budget at most, not yet optimised."""
    shares = samples
    for attempt in range(4):
        places = site.snap_to_reachable(centroidal_places(site, sampled_m, shares, first_node))
        stops = np.vstack((site.start_m, places))
        legs = site.legs(stops)
        order = short_tour(legs.lengths_m)
        length = float(legs.lengths_m[order[:-1], order[1:]].sum())
        if length <= budget_m or attempt == 3 or shares == 1:
            break
        shares = max(1, min(shares - 1, int(shares * (budget_m / length) ** 2)))
    route = stops[order]
    return route[1:] if shares == samples else site.snap_to_reachable(places_along(route, samples))


def design_from_outlook(site: Site, sampled_m: FloatArray, outlook_m: FloatArray, samples: int) -> FloatArray:
    """Places (samples, 2) [m] from an outlook (k, 2) [m]: the most crowded ones removed, or gaps filled."""
    places = site.snap_to_reachable(outlook_m)
    while len(places) > samples:
        others = np.vstack((places, sampled_m))
        distance = cKDTree(others).query(places, k=2)[0][:, 1]
        places = np.delete(places, int(np.argmin(distance)), axis=0)
    if len(places) < samples:
        more = centroidal_places(site, np.vstack((sampled_m, places)), samples - len(places), 0)
        places = np.vstack((places, more))
    return places


def centroidal_places(site: Site, sampled_m: FloatArray, count: int, first_node: int) -> FloatArray:
    """Places (count, 2) [m], each the centroid of the cells nearer to it than to any other place or sample.

    They start as far as possible from the samples and from each other (Gonzalez 1985), with distances weighted by
    interest. first_node: index of the first node if there is no sample.
    """
    nodes = site.nodes.places_m
    # The mean squared distance is least where the density of places is as the square root of the weight.
    stretch = (site.nodes.weights / site.nodes.weights.max()) ** 0.25
    sampled = sampled_m if len(sampled_m) else np.zeros((0, 2))
    places = np.empty((count, 2))
    farthest = first_node
    distance = np.full(len(nodes), np.inf)
    if len(sampled):
        distance = cKDTree(sampled).query(nodes)[0]
        farthest = int(np.argmax(distance * stretch))
    for i in range(count):
        places[i] = nodes[farthest]
        distance = np.minimum(distance, np.hypot(*(nodes - places[i]).T))
        farthest = int(np.argmax(distance * stretch))
    total = count + len(sampled)
    for _ in range(LLOYD_ITERATIONS):
        _, owner = cKDTree(np.vstack((places, sampled))).query(nodes)
        weight = np.bincount(owner, site.nodes.weights, total)[:count]
        moment = [np.bincount(owner, site.nodes.weights * nodes[:, k], total)[:count] for k in (0, 1)]
        owns = weight > 0
        places[owns] = np.column_stack(moment)[owns] / weight[owns, None]
        places = site.snap_to_reachable(places)
    return places


def optimise_places(
    site: Site,
    variance: AverageVariance,
    places_m: FloatArray,
    price: float,
    budget_m: float,
    steps: int,
    first_step_m: float = FIRST_STEP_M,
    ordered: bool = True,
) -> FloatArray:
    """The places (n, 2) [m], in the order of their tour, after that number of steps down the gradient of V + lambda L.

    price: the least lambda, in units of V per metre. first_step_m: root mean square step at the beginning [m]. ordered:
    whether the order is improved once more after the last step.
    """
    places = places_m
    scale = step_scale(site, len(places))
    first_step_m, last_step_m, max_step_m = first_step_m * scale, LAST_STEP_M * scale, MAX_STEP_M * scale
    momentum = np.zeros_like(places)
    corners = np.full(places.shape, np.nan)
    terrain: TerrainPull | None = None
    for step in range(steps):
        if step % REORDER_EVERY == 0:
            order, corners = shorter_order(site, places)
            places, momentum = places[order], momentum[order]
            terrain = None if site.cost is None else terrain_pull(site, site.cost, places, corners)
        gradient = variance.gradient(places)
        momentum = gradient if step == 0 else 0.6 * momentum + 0.4 * gradient
        pull, length = length_gradient(site.start_m, places, corners)
        if terrain is not None:
            pull, length = pull + terrain.pull, length * terrain.rate
        wanted = first_step_m * (last_step_m / first_step_m) ** (step / max(steps - 1, 1))
        size = float(np.sqrt(np.mean(np.sum((momentum + price * pull) ** 2, axis=1))))
        if not size > 0:
            break
        rate = wanted / size
        lam = price
        excess = length - budget_m
        if excess > 0:
            # A step of this rate changes the length by -rate (momentum . pull + lambda |pull|^2); a third is taken off.
            squared = float((pull * pull).sum())
            if squared > 0:
                lam = max(price, (excess / (3.0 * rate) - float((momentum * pull).sum())) / squared)
        move = -rate * (momentum + lam * pull)
        move *= np.minimum(1.0, max_step_m / np.maximum(np.hypot(*move.T), 1e-9))[:, None]
        places = site.snap_to_reachable(places + move)
    if not ordered:
        return places
    order, _ = shorter_order(site, places)
    return places[order]


def step_scale(site: Site, samples: int) -> float:
    """Factor of the steps' lengths: 1 if the samples' spacing is 10 m to 1 km; beyond, in proportion to the spacing."""
    spacing_m = float(np.sqrt(site.area_m2 / samples))
    return min(1.0, spacing_m / 10.0) if spacing_m < 1000.0 else spacing_m / 1000.0


def tour_lengths(site: Site, places_m: FloatArray) -> tuple[float, float]:
    """Length [m] of the tour through the places (n, 2) [m] in their order: around obstacles, and in straight lines."""
    stops = np.vstack((site.start_m, places_m))
    return float(site.leg_lengths(stops).sum()), path_length(stops)


def objective(site: Site, variance: AverageVariance, places_m: FloatArray, price: float, budget_m: float) -> float:
    """The objective that compares designs: V + lambda L, with a penalty on metres beyond the budget."""
    length, _ = tour_lengths(site, places_m)
    value = variance(places_m)
    return value * (1.0 + OVERBUDGET_WEIGHT * max(0.0, length / budget_m - 1.0)) + price * length


def length_gradient(start_m: FloatArray, places_m: FloatArray, corners_m: FloatArray) -> tuple[FloatArray, float]:
    """Gradient (n, 2) of the tour's length by its places, and that length [m].

    corners_m (n, 2): where the leg to each place bends [m], NaN where it is straight.
    """
    before = np.vstack((start_m, places_m[:-1]))
    bent = ~np.isnan(corners_m[:, :1])
    into = places_m - np.where(bent, corners_m, before)
    out = np.where(bent, corners_m, places_m) - before
    into_length, out_length = np.hypot(*into.T), np.hypot(*out.T)
    gradient = into / np.maximum(into_length, 1e-9)[:, None]
    gradient[:-1] -= (out / np.maximum(out_length, 1e-9)[:, None])[1:]
    length = float(np.where(bent[:, 0], into_length + out_length, into_length).sum())
    return gradient, length


@dataclass(frozen=True, slots=True)
class TerrainPull:
    """What terrain adds to a tour's length and to its gradient."""

    pull: FloatArray
    """(n, 2), level metres a metre."""
    rate: float
    """Cost of the tour in its lengths [level m a metre]."""


def terrain_pull(site: Site, cost: TerrainCost, places_m: FloatArray, corners_m: FloatArray) -> TerrainPull:
    """What the terrain adds, by differences of the legs' costs over a few cells around each place (n, 2) [m]."""
    step_m = PULL_CELLS * site.ground.grid.resolution_m
    from_m = np.vstack((site.start_m, places_m[:-1]))

    def around(places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Costs and lengths (n,) of the two legs at each place, if that place alone is moved there."""
        after = np.vstack((corners_m[1:], np.full((1, 2), np.nan)))
        to_m = np.vstack((places_m[1:], places[-1:]))
        costs = cost_of_bent_legs(cost, from_m, corners_m, places) + cost_of_bent_legs(cost, places, after, to_m)
        return costs, _bent_lengths(from_m, corners_m, places) + _bent_lengths(places, after, to_m)

    pull = np.zeros_like(places_m)
    for axis in (0, 1):
        aside = np.zeros(2)
        aside[axis] = step_m
        far, near = site.snap_to_reachable(places_m + aside), site.snap_to_reachable(places_m - aside)
        (cost_far, length_far), (cost_near, length_near) = around(far), around(near)
        pull[:, axis] = (cost_far - length_far - cost_near + length_near) / (2.0 * step_m)
    lengths = _bent_lengths(from_m, corners_m, places_m)
    return TerrainPull(
        pull, float(cost_of_bent_legs(cost, from_m, corners_m, places_m).sum() / max(lengths.sum(), 1e-9))
    )


def _bent_lengths(a_m: FloatArray, corners_m: FloatArray, b_m: FloatArray) -> FloatArray:
    """Lengths (n,) [m] of legs from a (n, 2) to b (n, 2) [m], by corners (n, 2) [m] that may be NaN."""
    middle = np.where(np.isnan(corners_m), b_m, corners_m)
    lengths: FloatArray = np.hypot(*(middle - a_m).T) + np.hypot(*(b_m - middle).T)
    return lengths


def shorter_order(site: Site, places: FloatArray) -> tuple[IntArray, FloatArray]:
    """An order (n,) of the places that is no longer than their own, and the corners (n, 2) [m] of its legs."""
    stops = np.vstack((site.start_m, places))
    legs = site.legs(stops)
    order = short_tour(legs.lengths_m, np.arange(len(stops)))
    return order[1:] - 1, legs.corners_m[order[:-1], order[1:]]

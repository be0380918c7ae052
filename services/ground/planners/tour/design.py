"""One design for all samples that are left, and the tour through it: spread out, then drawn taut together.

First the places are spread over what the samples so far leave uncovered, each in the middle of its own share (a
centroidal Voronoi tessellation: Lloyd 1982), and a short tour is laid through them. Where the budget does not reach
that far, fewer and larger shares are toured, and the samples set along that tour. Then the places move, all at once,
down the gradient of

    V(P) + lambda L(P)

the field's average posterior variance and the tour's length, lambda being the price of a metre: what thrift asks for,
or more where the budget binds. The price that makes a step just short enough follows from the two gradients.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from he3.frames import FloatArray, path_length
from he3.tsp import short_tour
from services.ground.planners.rounds import places_along

if TYPE_CHECKING:
    from he3.i_optimal_design import AverageVariance
    from services.ground.planners.tour.site import Site

LLOYD_ITERATIONS = 12
REORDER_EVERY = 6
"""Steps of the places between two looks at the order in which they are visited."""
MAX_STEP_M = 8.0
"""No place moves farther at a time [m]."""
FIRST_STEP_M = 3.0
LAST_STEP_M = 0.4
OVERBUDGET_WEIGHT = 2.0
"""Per cent of variance by which a tour has to be better for each per cent that it is over the budget."""
"""Root mean square step [m] at the beginning and at the end, where the budget does not ask for more."""


def initial_design(site: Site, sampled_m: FloatArray, samples: int, budget_m: float, first_node: int) -> FloatArray:
    """Places (samples, 2) [m] in the order of a tour of about the budget at most, not yet drawn taut."""
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
    """The outlook's places (k, 2) [m], as many as there are samples: the most crowded left out, or gaps filled up."""
    places = site.snap_to_reachable(outlook_m)
    while len(places) > samples:
        around = np.vstack((places, sampled_m))
        apart = cKDTree(around).query(places, k=2)[0][:, 1]
        places = np.delete(places, int(np.argmin(apart)), axis=0)
    if len(places) < samples:
        more = centroidal_places(site, np.vstack((sampled_m, places)), samples - len(places), 0)
        places = np.vstack((places, more))
    return places


def centroidal_places(site: Site, sampled_m: FloatArray, count: int, first_node: int) -> FloatArray:
    """Places (count, 2) [m], each the centre of the cells that are nearer to it than to any other or any taken.

    They begin as far as possible from those taken and from each other (Gonzalez 1985), where distances count for more
    the more interest there is; first_node is the first of them where none is taken.
    """
    nodes = site.nodes.places_m
    # Mean squared distances are least where the density goes with the root of the weight.
    stretch = (site.nodes.weights / site.nodes.weights.max()) ** 0.25
    taken = sampled_m if len(sampled_m) else np.zeros((0, 2))
    places = np.empty((count, 2))
    farthest = first_node
    apart = np.full(len(nodes), np.inf)
    if len(taken):
        apart = cKDTree(taken).query(nodes)[0]
        farthest = int(np.argmax(apart * stretch))
    for i in range(count):
        places[i] = nodes[farthest]
        apart = np.minimum(apart, np.hypot(*(nodes - places[i]).T))
        farthest = int(np.argmax(apart * stretch))
    for _ in range(LLOYD_ITERATIONS):
        _, owner = cKDTree(np.vstack((places, taken))).query(nodes)
        weight = np.bincount(owner, site.nodes.weights, count + len(taken))[:count]
        moment = [np.bincount(owner, site.nodes.weights * nodes[:, k], count + len(taken))[:count] for k in (0, 1)]
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
) -> FloatArray:
    """The places (n, 2) [m], in the order of their tour, after that many steps down V + lambda L.

    price: the least lambda, in units of V a metre. first_step_m: root mean square step at the beginning.
    """
    places = places_m
    momentum = np.zeros_like(places)
    corners = np.full(places.shape, np.nan)
    for step in range(steps):
        if step % REORDER_EVERY == 0:
            order, corners = _shorter_order(site, places)
            places, momentum = places[order], momentum[order]
        _, gradient = variance.with_gradient(places)
        momentum = gradient if step == 0 else 0.6 * momentum + 0.4 * gradient
        pull, length = length_gradient(site.start_m, places, corners)
        wanted = first_step_m * (LAST_STEP_M / first_step_m) ** (step / max(steps - 1, 1))
        size = float(np.sqrt(np.mean(np.sum((momentum + price * pull) ** 2, axis=1))))
        if not size > 0:
            break
        rate = wanted / size
        lam = price
        excess = length - budget_m
        if excess > 0:
            # A step of this rate changes the length by -rate (momentum . pull + lambda |pull|^2): take off a third.
            squared = float((pull * pull).sum())
            if squared > 0:
                lam = max(price, (excess / (3.0 * rate) - float((momentum * pull).sum())) / squared)
        move = -rate * (momentum + lam * pull)
        move *= np.minimum(1.0, MAX_STEP_M / np.maximum(np.hypot(*move.T), 1e-9))[:, None]
        places = site.snap_to_reachable(places + move)
    order, _ = _shorter_order(site, places)
    return places[order]


def tour_lengths(site: Site, places_m: FloatArray) -> tuple[float, float]:
    """Length [m] of the tour through the places (n, 2) [m] in their order, round obstacles and as the crow flies."""
    stops = np.vstack((site.start_m, places_m))
    legs = np.arange(len(stops))
    lengths = site.legs(stops).lengths_m[legs[:-1], legs[1:]]
    return float(lengths.sum()), path_length(stops)


def objective(site: Site, variance: AverageVariance, places_m: FloatArray, price: float, budget_m: float) -> float:
    """What the design costs, to compare it with others: V + lambda L, and dearly for metres beyond the budget."""
    length, _ = tour_lengths(site, places_m)
    value = variance(places_m)
    return value * (1.0 + OVERBUDGET_WEIGHT * max(0.0, length / budget_m - 1.0)) + price * length


def length_gradient(start_m: FloatArray, places_m: FloatArray, corners_m: FloatArray) -> tuple[FloatArray, float]:
    """Gradient (n, 2) of the tour's length with respect to its places, and that length [m].

    corners_m (n, 2): where the leg to each place bends, NaN where it does not.
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


def _shorter_order(site: Site, places: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """A shorter order (n,) of the places than that they come in, if there is one, and the corners (n, 2) of its
    legs."""
    stops = np.vstack((site.start_m, places))
    legs = site.legs(stops)
    order = short_tour(legs.lengths_m, np.arange(len(stops)))
    return order[1:] - 1, legs.corners_m[order[:-1], order[1:]]

"""The route through a design: a short order of its places, and a free path for each of its legs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from he3.frames import FloatArray, path_length
from he3.tsp import short_tour
from services.ground.planners.polyline import arc_lengths, path_prefix
from services.ground.planners.tour.legs import joined_path, leg_path
from services.ground.planners.tour.paths import shortest_path

if TYPE_CHECKING:
    from services.ground.planners.tour.site import Site

MAX_REORDERINGS = 4
"""Times that the order is improved with the lengths of paths found for blocked legs."""


@dataclass(frozen=True, slots=True)
class Route:
    """A free polyline, and the places on it in the order in which it reaches them."""

    path_m: FloatArray
    """(K, 2) [m]."""
    places_m: FloatArray
    """(n, 2) [m]."""
    at_m: FloatArray
    """(n,) distance of each place along the path [m]."""

    def truncated(self, budget_m: float) -> Route:
        """The route cut at the budget [m]. Places beyond its end move to the middle of the longest gaps before it."""
        if self.at_m[-1] <= budget_m:
            return self
        end_m = max(budget_m, 0.0)
        at = [0.0, *self.at_m[self.at_m < end_m].tolist(), end_m]
        while len(at) < len(self.at_m) + 1:
            gap = int(np.argmax(np.diff(at)))
            at.insert(gap + 1, 0.5 * (at[gap] + at[gap + 1]))
        path, at_m = path_prefix(self.path_m, end_m), np.array(at[1:])
        along = arc_lengths(self.path_m)
        places = np.column_stack([np.interp(at_m, along, self.path_m[:, k]) for k in (0, 1)])
        places[-1] = path[-1]
        return Route(path, places, at_m)


def route_through(site: Site, places_m: FloatArray, kicks: int, seed: int) -> Route:
    """A short free route from the site's start through all places (n, 2) [m], which must be reachable.

    The search for a short order begins from that of the places. kicks, seed: see ``he3.tsp.short_tour``.
    """
    stops = np.vstack((site.start_m, places_m))
    legs = site.legs(stops)
    lengths = legs.lengths_m.copy()
    found: dict[tuple[int, int], FloatArray] = {}
    order = short_tour(lengths, np.arange(len(stops)), kicks, seed)
    for look in range(MAX_REORDERINGS):
        for i, j in pairwise(order.tolist()):
            pair = min(i, j), max(i, j)
            if not legs.free[pair] and pair not in found:
                found[pair] = shortest_path(site.ground, stops[pair[0]], stops[pair[1]])
                lengths[i, j] = lengths[j, i] = site.way_cost(found[pair])
        if look == MAX_REORDERINGS - 1:
            break
        shorter = short_tour(lengths, order)
        if np.array_equal(shorter, order):
            break
        order = shorter
    paths = []
    for i, j in pairwise(order.tolist()):
        if legs.free[i, j]:
            paths.append(leg_path(legs, stops, i, j))
        else:
            paths.append(found[i, j] if i < j else found[j, i][::-1])
    return Route(joined_path(paths), stops[order[1:]], np.cumsum([path_length(path) for path in paths]))

"""Legs around obstacles: lengths between the places of a tour, and the lines along which they are driven.

A blocked leg between neighbours is bent at one corner beside its middle, if that makes it free; this is cheap enough
for every pair of neighbours at each reordering of the tour. If one corner does not suffice, a long detour is assumed.
Only if the tour contains that leg all the same, the shortest path over the cells is searched (``tour.paths``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from he3.frames import FloatArray

if TYPE_CHECKING:
    from he3.driving_cost import TerrainCost
    from services.ground.planners.traversability import OpenGround

NEIGHBOURS = 10
"""Nearest places to which the legs of a place are checked; a short tour rarely goes to a farther one."""
CORNER_OFFSETS = np.array([0.08, 0.16, 0.28, 0.45, 0.7])
"""Distances of the corner from the leg's middle, in shares of the leg's length, on either side."""
BLOCKED_LEG_FACTOR = 2.0
"""Assumed length of a leg that one corner does not free, in straight lengths, until its path is found."""
DISTANT_LEG_FACTOR = 1.1
"""Assumed length of a leg to a place that is not a neighbour, in straight lengths."""
LABYRINTH_SHARE = 0.05
"""Share of blocked legs between neighbours above which straight lengths mislead, and a bound is used instead."""

LengthBound = Callable[[FloatArray], FloatArray]
"""Places (n, 2) [m] -> lower bounds (n, n) [m] on the lengths of the paths between them."""


@dataclass(frozen=True, slots=True)
class LegTable:
    """Lengths of the legs between n places, and their corners."""

    lengths_m: FloatArray
    """(n, n) [m], or with a cost [level m], the same in both directions."""
    corners_m: FloatArray
    """(n, n, 2) [m], NaN for straight legs and for those whose path is not known."""
    free: NDArray[np.bool_]
    """(n, n): whether the leg, with its corner if any, is known to be free."""


def leg_table(
    ground: OpenGround, places_m: FloatArray, bound: LengthBound | None = None, cost: TerrainCost | None = None
) -> LegTable:
    """The legs between places (n, 2) [m], all on open ground. bound: called only if many legs are blocked.

    cost: what legs cost; None: their length.
    """
    n = len(places_m)
    distance = np.hypot(*(places_m[:, None] - places_m[None]).transpose(2, 0, 1))
    lengths = distance * DISTANT_LEG_FACTOR
    corners = np.full((n, n, 2), np.nan)
    free = np.eye(n, dtype=bool)
    if n > 1:
        _, near = cKDTree(places_m).query(places_m, k=min(NEIGHBOURS + 1, n))
        first = np.repeat(np.arange(n), near.shape[1])
        pairs = np.unique(np.sort(np.column_stack((first, near.ravel())), axis=1), axis=0)
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        i, j = pairs[:, 0], pairs[:, 1]
        length, corner, is_free = legs_with_one_corner(ground, places_m[i], places_m[j])
        lengths[i, j] = lengths[j, i] = length
        corners[i, j] = corners[j, i] = corner
        free[i, j] = free[j, i] = is_free
        if bound is not None and np.count_nonzero(~is_free) > LABYRINTH_SHARE * len(pairs):
            lengths = np.where(free, lengths, np.maximum(lengths, bound(places_m)))
        if cost is not None:
            known = cost_of_bent_legs(cost, places_m[i], corner, places_m[j])
            metres = max(float(length[is_free].sum()), 1e-9)
            lengths *= max(1.0, float(known[is_free].sum()) / metres)  # legs whose way is not known cost as the others
            i, j, known = i[is_free], j[is_free], known[is_free]
            lengths[i, j] = lengths[j, i] = known
    return LegTable(lengths, corners, free)


def consecutive_lengths(
    ground: OpenGround, stops_m: FloatArray, bound: LengthBound | None = None, cost: TerrainCost | None = None
) -> FloatArray:
    """Lengths (n - 1,) [m], or with a cost [level m], of the legs from each of n stops (n, 2) [m] to the next.

    As those of ``leg_table``, but each leg is computed, however many other stops are nearer.
    """
    a, b = stops_m[:-1], stops_m[1:]
    lengths, corner, free = legs_with_one_corner(ground, a, b)
    if bound is not None and np.count_nonzero(~free) > LABYRINTH_SHARE * len(a):
        lengths = np.where(free, lengths, np.maximum(lengths, bound(stops_m).diagonal(1)))
    if cost is not None:
        known = cost_of_bent_legs(cost, a, corner, b)
        metres = max(float(lengths[free].sum()), 1e-9)
        lengths = np.where(free, known, lengths * max(1.0, float(known[free].sum()) / metres))
    return lengths


def cost_of_bent_legs(cost: TerrainCost, a_m: FloatArray, corner_m: FloatArray, b_m: FloatArray) -> FloatArray:
    """Symmetric costs (k,) [level m] of legs from a (k, 2) to b (k, 2) [m], by corners (k, 2) [m] that may be NaN."""
    bent = ~np.isnan(corner_m[:, 0])
    middle = np.where(bent[:, None], corner_m, b_m)
    costs = cost.of_legs(a_m, middle)
    costs[bent] += cost.of_legs(middle[bent], b_m[bent])
    return costs


def legs_with_one_corner(
    ground: OpenGround, a_m: FloatArray, b_m: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Lengths (k,) [m], corners (k, 2) [m] or NaN, and freedom (k,) of legs from a (k, 2) to b (k, 2) [m]."""
    distance = np.hypot(*(b_m - a_m).T)
    lengths = distance.copy()
    corners = np.full(a_m.shape, np.nan)
    free = ground.segments_free(a_m, b_m)
    blocked = np.flatnonzero(~free)
    if blocked.size:
        lengths[blocked] *= BLOCKED_LEG_FACTOR
        a, b = a_m[blocked], b_m[blocked]
        across = np.column_stack((a[:, 1] - b[:, 1], b[:, 0] - a[:, 0]))
        shares = np.concatenate((CORNER_OFFSETS, -CORNER_OFFSETS))
        bends = 0.5 * (a + b)[:, None] + shares[None, :, None] * across[:, None]
        count = len(shares)
        flat = bends.reshape(-1, 2)
        fits = ground.is_open(flat)
        fits[fits] = ground.segments_free(np.repeat(a, count, axis=0)[fits], flat[fits])
        fits[fits] = ground.segments_free(flat[fits], np.repeat(b, count, axis=0)[fits])
        bent = distance[blocked, None] * np.sqrt(1.0 + 4.0 * shares**2)
        bent = np.where(fits.reshape(-1, count), bent, np.inf)
        best = np.argmin(bent, axis=1)
        rows = np.arange(len(blocked))
        found = np.isfinite(bent[rows, best])
        at = blocked[found]
        lengths[at] = bent[rows, best][found]
        corners[at] = bends[rows, best][found]
        free[at] = True
    return lengths, corners, free


def leg_path(table: LegTable, places_m: FloatArray, i: int, j: int) -> FloatArray:
    """The free leg from place i to place j as a polyline (2 or 3, 2) [m]."""
    corner = table.corners_m[i, j]
    ends = (places_m[i], places_m[j])
    return np.array(ends if np.isnan(corner[0]) else (ends[0], corner, ends[1]))


def joined_path(pieces: list[FloatArray]) -> FloatArray:
    """One polyline (K, 2) [m] from consecutive ones, each of which begins where the one before ends."""
    return np.vstack([pieces[0], *(piece[1:] for piece in pieces[1:])])

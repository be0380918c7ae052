"""Designs of `tour` for a mission with a goal: the shortest tour after which the goal holds.

A greedy cover of the goal's targets is pruned, and then made shorter: all places move at once, down the tour's length
where the goal holds with room to spare, and down the excess of the variance where it does not. Then the place that is
needed least is left out and the others close the gap; as long as they can, that is repeated. Last, each place slides
along its tour's short cuts. What is shorter and still holds is kept.

The goal is to hold under kernels that together have the goal's probability, those under which it holds soonest, and
enough is to be seen of a field as it is thought to be before landing (``he3.certificate``).
If the samples that are left do not suffice for all of them, the heaviest kernel alone decides; if they do not suffice
for that either, there is no cover, and `tour` plans as without a goal: what is learned then may show a way.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from he3.certificate import Targets, thought_before_landing
from he3.cover import CoverProblem
from he3.i_optimal_design import field_nodes
from he3.mixture import alternatives_of, heaviest_of
from he3.tsp import short_tour
from services.ground.planners.foresight import forecast_of
from services.ground.planners.tour.design import length_gradient, shorter_order
from services.ground.planners.tour.site import reachable_site

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.gp import Hyperparameters
    from schemas.ground import GoalForecast
    from services.ground.planners.interface import PlanningGoal, PlanningRequest
    from services.ground.planners.tour.site import Site

TARGETS = 800
"""Targets of a design at first; those that it misses are added."""
CANDIDATES = 1000
"""Places out of which the greedy cover chooses."""
REACH = 0.1
"""Margin around the targets in which candidates lie, in shares of the targets' extent."""
LOOKS = 5
"""Times that the targets which a design misses are added."""
STEPS = 60
"""Steps of a descent."""
FIRST_STEP, LAST_STEP = 0.08, 0.006
"""Root mean square steps, in spacings of the places."""
REORDER_EVERY = 8
ROW_SPACINGS = (1.15, 0.8, 0.55)
"""Distances of the places of a row in distances of rows: from an even lattice to dense rows, whose tour is shorter."""
HALVINGS = 8
MOST_WORK, MOST_WORK_LATER = 1.5e8, 3e7
"""Bounds on the work of the first search and of later ones: steps times places times targets times kernels. The first
takes up to about 10 s of one processor."""
FAILURES = 3
"""Places that are left out in vain, one after the other, before the search ends."""
WEIGHT_CHANGE = 1.25
"""Factor by which the excess weighs more after a step that leaves some, and less after one that leaves none."""


@dataclass(frozen=True, slots=True)
class Covering:
    """What a plan for a goal comes to."""

    places_m: FloatArray | None
    """(n, 2) [m] in the order of their tour; None if no cover was found."""
    forecast: GoalForecast


def covering(request: PlanningRequest, goal: PlanningGoal, site: Site, budget_m: float) -> Covering:
    """The cover for the rest of the mission with what it is expected to take. budget_m: as the request's."""
    left, sampled = request.samples_left, request.observed_m
    kernels = kernels_to_satisfy(request.hyperparameters, goal, sampled, request.grid.extent_m)
    places, worst = cover(kernels, goal, site, sampled, left, _former(request))
    found = worst <= 1.0
    metres = tour_metres(site, places) if found else 0.0
    unit = "m" if request.cost is None else "level m"
    forecast = forecast_of(len(places), metres, worst * goal.std_ppb, goal.std_ppb, left, budget_m, unit)
    if not found and len(kernels) > 1:
        places, worst_of_one = cover([heaviest_of(request.hyperparameters)], goal, site, sampled, left, None)
        found = worst_of_one <= 1.0
    if not found or tour_metres(site, places) > budget_m:
        return Covering(None, forecast)
    return Covering(places, forecast)


def foreseen(request: PlanningRequest, goal: PlanningGoal) -> GoalForecast:
    """What a greedy cover takes, for planners that foresee nothing. Raises NoRoute for a rover that is walled in."""
    nodes = field_nodes(request.grid, request.interest)
    site = reachable_site(request.grid, request.traversable, request.margin_m, request.start_m, nodes, request.cost)
    kernels = kernels_to_satisfy(request.hyperparameters, goal, request.observed_m, request.grid.extent_m)
    problem = CoverProblem(kernels, request.observed_m, goal.targets.thinned(TARGETS), goal.std_ppb)
    places = problem.added(np.zeros((0, 2)), _candidates(site, goal.targets), request.samples_left)
    worst = float(np.sqrt(max(0.0, 1.0 + problem.excess(places).max())))
    metres = tour_metres(site, in_order(site, places)) if len(places) and worst <= 1.0 + _ALMOST else 0.0
    unit = "m" if request.cost is None else "level m"
    worst_ppb = goal.std_ppb * (1.0 if worst <= 1.0 + _ALMOST else worst)
    return forecast_of(len(places), metres, worst_ppb, goal.std_ppb, request.samples_left, request.budget_m, unit)


def kernels_to_satisfy(
    hyperparameters: Hyperparameters, goal: PlanningGoal, sampled_m: FloatArray, extent_m: float
) -> list[Hyperparameters]:
    """The kernels of the mixture, the least uncertain first, until they have the goal's probability together.

    The last one is what is thought of the field before landing on a site of that width.
    """
    each = alternatives_of(hyperparameters)
    thinned = goal.targets.thinned(TARGETS // 4)
    worst = [
        float(CoverProblem([one], sampled_m, thinned, goal.std_ppb).excess(np.zeros((0, 2))).max()) for _, one in each
    ]
    chosen, weight = [], 0.0
    for number in np.argsort(worst, kind="stable"):
        chosen.append(each[number][1])
        weight += each[number][0]
        if weight >= goal.probability:
            break
    return [*chosen, thought_before_landing(goal.targets, goal.std_ppb, extent_m)]


def cover(
    kernels: list[Hyperparameters],
    goal: PlanningGoal,
    site: Site,
    sampled_m: FloatArray,
    most: int,
    former_m: FloatArray | None,
) -> tuple[FloatArray, float]:
    """Places (n, 2) [m] in the order of their tour, n <= most, and the greatest std that they leave, over the goal's.

    former_m: places to begin with. If no cover is found, the places are those of an attempt.
    """
    targets = goal.targets
    complete = CoverProblem(kernels, sampled_m, targets, goal.std_ppb)
    candidates = _candidates(site, targets)
    places = np.zeros((0, 2)) if former_m is None else site.snap_to_cell_centres(former_m)[:most]
    looked_at = np.zeros(len(targets), dtype=np.bool_)
    looked_at[:: max(1, len(targets) // TARGETS)] = True
    for look in range(LOOKS):
        problem = CoverProblem(kernels, sampled_m, targets.only(looked_at), goal.std_ppb)
        if look and len(places) and (closed := descended(site, problem, places, STEPS)) is not None:
            places = closed  # moved by little, they need no more
        places = problem.added(places, candidates, most)
        if not problem.holds(places):
            break  # the samples do not suffice
        places = problem.pruned(places)
        if look == 0 and len(places) > 1:
            places = shortest_of(site, problem, places, most, thorough=former_m is None)
        excess = complete.excess(places)
        if excess.max() <= _ALMOST:
            break
        looked_at |= excess > 0.0
    else:
        places = complete.pruned(complete.added(places, candidates, most))
    excess = complete.excess(places)
    worst = float(np.sqrt(max(0.0, 1.0 + excess.max())))
    if not len(places):  # the goal holds by this reckoning, yet is not certified: look where least is known
        places = site.snap_to_cell_centres(targets.centres_m[[int(np.argmax(excess))]])
    return in_order(site, places), 1.0 if worst <= 1.0 + _ALMOST else worst


_ALMOST = 1e-6
"""Excess that counts as none."""


def shortest_of(site: Site, problem: CoverProblem, places_m: FloatArray, most: int, *, thorough: bool) -> FloatArray:
    """The cover (m, 2) [m] of the shortest tour that is found from a cover (n, 2) [m]; its places at cells' centres.

    thorough: begin also with lattices, whose rows are as far apart as the goal admits, and follow more ways.
    """
    starts = [in_order(site, places_m)]
    if thorough:
        starts += [in_order(site, lattice) for lattice in lattice_covers(site, problem, most)]
    most_work = MOST_WORK if thorough else MOST_WORK_LATER
    descents = max(2, int(most_work / (STEPS * len(places_m) * problem.size)))
    starts = starts[: max(1, descents // 2)]
    found = []
    for start in starts:
        moved = descended(site, problem, start, STEPS)
        found += [(tour_metres(site, each), each) for each in (start, moved) if each is not None]
    best_m, best = min(found, key=lambda one: one[0])
    descents -= len(starts)
    failures, tried = 0, 0
    while descents > 0 and failures < (FAILURES if thorough else 1) and len(best) > 2:
        descents -= 1
        fewer = np.delete(best, _least_needed(site, problem, best, tried), axis=0)
        moved = descended(site, problem, fewer, STEPS)
        if moved is not None and (metres := tour_metres(site, moved)) < best_m:
            best, best_m = problem.pruned(moved), metres
            failures, tried = 0, 0
        else:
            failures, tried = failures + 1, tried + 1
    if thorough and descents > 0:
        moved = descended(site, problem, best, 3 * STEPS)
        if moved is not None and tour_metres(site, moved) < best_m:
            best = moved
    return in_order(site, best)


def lattice_covers(site: Site, problem: CoverProblem, most: int) -> list[FloatArray]:
    """Covers of at most that many places (n, 2) [m]: lattices of shifted rows, the widest of each kind, pruned."""
    centres = problem.targets.centres_m
    low, high = centres.min(axis=0), centres.max(axis=0)
    covers = []
    for upright in (False, True):
        for along in ROW_SPACINGS:
            least, widest, found = 0.0, float((high - low).max()), None
            for _ in range(HALVINGS):
                spacing_m = 0.5 * (least + widest)
                places = _lattice(site, low, high, spacing_m, along, upright, most)
                if places is None:  # too many
                    least = spacing_m
                elif problem.holds(places):
                    least, found = spacing_m, places
                else:
                    widest = spacing_m
            if found is not None:
                covers.append(problem.pruned(found))
    return covers


def _lattice(
    site: Site, low: FloatArray, high: FloatArray, spacing_m: float, along: float, upright: bool, most: int
) -> FloatArray | None:
    """Rows of places (n, 2) [m] between two corners, by turns in either direction; None if they are more than most.

    spacing_m: between rows; along: between the places of a row, in spacings of rows.
    """
    extent = (high - low)[::-1] if upright else high - low
    rows = max(1, round(float(extent[1]) / spacing_m))
    a_row = max(1, round(float(extent[0]) / (along * spacing_m)))
    if rows * a_row > most:
        return None
    shift = 0.25 * (-1.0) ** np.arange(rows)[:, None]
    u = (np.arange(a_row)[None, :] + 0.5 + shift) / a_row
    u[1::2] = u[1::2, ::-1]
    v = np.repeat((np.arange(rows) + 0.5) / rows, a_row)
    places = np.column_stack((u.ravel(), v)) * extent
    snapped = site.snap_to_cell_centres(low + (places[:, ::-1] if upright else places))
    _, first = np.unique(snapped, axis=0, return_index=True)
    return snapped[np.sort(first)]


def _least_needed(site: Site, problem: CoverProblem, places_m: FloatArray, rank: int) -> int:
    """The place that is needed least, by the excess without it and the metres that it costs; rank: the next ones."""
    stops = np.vstack((site.start_m, places_m))
    legs = np.hypot(*np.diff(stops, axis=0).T)
    past = np.append(np.hypot(*(stops[2:] - stops[:-2]).T), 0.0)
    saved = legs + np.append(legs[1:], 0.0) - past
    without = np.maximum(problem.excess_without(places_m), 0.0)
    merit = without / without.mean() - saved / saved.mean() if without.any() else -saved
    return int(np.argsort(merit, kind="stable")[min(rank, len(places_m) - 1)])


def descended(site: Site, problem: CoverProblem, places_m: FloatArray, steps: int) -> FloatArray | None:
    """The shortest cover (n, 2) [m] on the way of a descent from places (n, 2) [m]; None if none was met."""
    places = places_m
    spacing_m = float(np.sqrt(site.area_m2 / len(places)))
    weight = 1.0
    best, best_m = None, inf
    momentum = np.zeros_like(places)
    corners = np.full(places.shape, np.nan)
    for step in range(steps):
        if step % REORDER_EVERY == 0:
            order, corners = shorter_order(site, places)
            places, momentum = places[order], momentum[order]
        excess, _, gradient = problem.with_gradient(places)
        pull, length = length_gradient(site.start_m, places, corners)
        if excess <= 0.0 and length < best_m:
            best, best_m = places, length
        size = _rms(gradient)
        momentum = 0.5 * momentum + (0.5 * gradient / size if size > 0.0 else 0.0)
        weight *= WEIGHT_CHANGE if excess > 0.0 else 1.0 / WEIGHT_CHANGE
        weight = min(max(weight, 0.05), 50.0)
        direction = weight * momentum + pull / max(_rms(pull), 1e-12)
        wanted = spacing_m * FIRST_STEP * (LAST_STEP / FIRST_STEP) ** (step / max(steps - 1, 1))
        places = site.snap_to_reachable(places - wanted * direction / max(_rms(direction), 1e-12))
    if best is None:
        return None
    centred = site.snap_to_cell_centres(best)
    return centred if problem.holds(centred) else _nudged(site, problem, centred)


def _nudged(site: Site, problem: CoverProblem, places_m: FloatArray) -> FloatArray | None:
    """A cover near the places (n, 2) [m], which miss it by the rounding to cells; None if there is none."""
    places = places_m
    cell_m = site.ground.grid.resolution_m
    for _ in range(6):
        _, _, gradient = problem.with_gradient(places)
        size = np.hypot(*gradient.T)
        moving = size > 0.3 * size.max()
        step = np.where(moving[:, None], gradient / np.maximum(size, 1e-300)[:, None], 0.0)
        places = site.snap_to_cell_centres(places - 1.2 * cell_m * step)
        if problem.holds(places):
            return places
    return None


def in_order(site: Site, places_m: FloatArray) -> FloatArray:
    """The places (n, 2) [m] in the order of a short tour, no longer than their own order."""
    stops = np.vstack((site.start_m, places_m))
    lengths = site.legs(stops).lengths_m
    orders = short_tour(lengths, np.arange(len(stops))), short_tour(lengths)
    order = min(orders, key=lambda one: float(lengths[one[:-1], one[1:]].sum()))
    return places_m[order[1:] - 1]


def tour_metres(site: Site, places_m: FloatArray) -> float:
    """Length [m], or cost [level m], of the tour through the places (n, 2) [m] in their order."""
    stops = np.vstack((site.start_m, places_m))
    legs = np.arange(len(stops))
    return float(site.legs(stops).lengths_m[legs[:-1], legs[1:]].sum())


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean((vectors * vectors).sum(axis=1))))


def _former(request: PlanningRequest) -> FloatArray | None:
    """The outlook of the plan before, if it was for the goal: shorter than all that may still be sampled."""
    outlook = request.outlook_m
    return outlook if outlook is not None and 0 < len(outlook) < request.samples_left else None


def _candidates(site: Site, targets: Targets) -> FloatArray:
    """Centres (C, 2) [m] of reachable cells around the targets, evenly spread."""
    grid = site.ground.grid
    rows, columns = np.arange(grid.rows)[:, None], np.arange(grid.columns)[None, :]
    reachable = (site.nearest_reachable[0] == rows) & (site.nearest_reachable[1] == columns)
    centres = targets.centres_m
    low, high = centres.min(axis=0), centres.max(axis=0)
    margin = REACH * (high - low).max() + grid.resolution_m
    x, y = grid.x_m, grid.y_m
    reachable &= ((x >= low[0] - margin) & (x <= high[0] + margin))[None, :]
    reachable &= ((y >= low[1] - margin) & (y <= high[1] + margin))[:, None]
    if not reachable.any():
        reachable = (site.nearest_reachable[0] == rows) & (site.nearest_reachable[1] == columns)
    step = 1
    thinned = reachable
    while np.count_nonzero(thinned) > CANDIDATES:
        step += 1
        thinned = np.zeros_like(reachable)
        thinned[step // 2 :: step, step // 2 :: step] = reachable[step // 2 :: step, step // 2 :: step]
    places: FloatArray = (np.argwhere(thinned)[:, ::-1].astype(np.float64) + 0.5) * grid.resolution_m
    return places

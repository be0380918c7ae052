"""The whole rest of the mission as one design and one tour; the round is its first piece.

All samples and metres that are left are planned together: places that make the average of the field as certain as
possible (``he3.design_of_samples``), on a tour that is short and within the budget (``tour_design``). Nothing is
carried over from round to round but what the request says, so that a restarted station plans as one that was never
stopped; plans agree with one another because each is near the optimum of the same criterion at the same price of a
metre.

Without a budget, metres are not free either: the tour lengthens only where one per cent more of it lowers the variance
by more than ``thrift`` per cent. Hyperparameters that say nothing about where to go, because they let a sample know
only its own spot or all of the site, are brought to the nearest that do.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from math import inf, isfinite, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from he3.design_of_samples import AverageVariance, FieldNodes, field_nodes
from he3.errors import InvalidInput, NoRoute
from he3.frames import FloatArray, SiteGrid, path_length
from he3.kernels import Kernel, kernel_from
from he3.touring import short_tour
from services.ground.planners.rounds import arc_lengths, cut, planned
from services.ground.planners.tour_design import Site, drawn_taut, first_design, worth
from services.ground.planners.tour_legs import joined, leg_path, leg_table
from services.ground.planners.tour_ways import shortest_way
from services.ground.planners.traversability import OpenGround
from services.ground.planning import PlannedRound, PlanningRequest, checked

THRIFT = 0.03
"""Per cent of variance that one per cent of the tour has to be worth, whatever the budget."""
LEG_CONSTANT = 0.7124 * 1.28
"""Metres a sample that a mission without a budget may drive, in units of sqrt(area / samples). The shortest tour through
many places takes 0.7124 if they lie at random (Beardwood, Halton & Hammersley 1959) and 1 on a lattice; between the two,
the variance hardly depends on it."""
DESIGNS = 4
FIRST_STEPS = 40
STEPS = 10
STEP_ON_M = 1.5
"""Root mean square step [m] with which the last plan's places begin to move on."""
KICKS = 20
SETTINGS = ("thrift", "designs", "first_steps", "steps", "kicks")
SHORTEST_IN_SPACINGS = 0.5
LONGEST_IN_SPACINGS = 6.0
"""Length scales that a design uses, in spacings of an even lattice of all samples over the site."""
LATEST_LOOKS = 4
"""How often legs whose way had to be found change the order of the tour."""


def tour(request: PlanningRequest) -> PlannedRound:
    """The first piece of one tour through one design for all samples that are left.

    Raises NoRoute where nothing can be reached or no metre is left, InvalidInput for a request that makes no sense.
    """
    extra = checked(request).options.extra
    if unknown := set(extra) - set(SETTINGS):
        raise InvalidInput(f"tour knows the settings {', '.join(SETTINGS)}; got {', '.join(sorted(unknown))}")
    if not request.budget_m > 0:
        raise NoRoute(f"the travel budget is spent: {request.budget_m:g} m are left for {request.samples_left} samples")
    grid = request.grid
    cells = request.traversable.astype(np.bool_).tobytes()
    ground, labels = _labelled(grid, cells)
    start = np.array(ground.footing(request.start_m))
    row, column = grid.cells_of(start[None])
    nearest = _nearest(grid, cells, int(labels[row[0], column[0]]))
    budget_m = request.budget_m - path_length(np.array([request.start_m, start]))

    nodes = field_nodes(grid, request.interest)
    site = Site(nodes, lambda places: _settled(grid, nearest, places), lambda places: leg_table(ground, places), start)
    variance = _average_variance(request, nodes)
    reachable_m2 = np.count_nonzero(labels == labels[row[0], column[0]]) * grid.resolution_m**2
    leg_m = LEG_CONSTANT * sqrt(reachable_m2 / (request.samples_left + len(request.observed_m)))
    if not isfinite(budget_m):
        budget_m = leg_m * request.samples_left
    thrift = float(extra.get("thrift", THRIFT))
    places = _design(request, site, variance, thrift / leg_m, budget_m, extra)
    places = _on_centres(grid, site.settle(places))
    ways = _toured(ground, start, places, int(extra.get("kicks", KICKS)), request.seed)
    return _first_round(request, ways, budget_m)


def _design(
    request: PlanningRequest,
    site: Site,
    variance: AverageVariance,
    relative_price: float,
    budget_m: float,
    extra: dict[str, float],
) -> FloatArray:
    """Places (samples_left, 2) [m] in the order of their tour: the last plan's, moved on, or the best of a few."""
    left = request.samples_left
    samples = left + len(request.observed_m)
    if request.outlook_m is not None and len(request.outlook_m) == left:
        places = site.settle(request.outlook_m)
        price = relative_price * variance(places) / samples
        steps = int(extra.get("steps", STEPS))
        return drawn_taut(site, variance, places, price, budget_m, steps, STEP_ON_M)
    rng = np.random.default_rng(request.seed)
    best, least = np.zeros((0, 2)), inf
    for _ in range(int(extra.get("designs", DESIGNS))):
        first_node = int(rng.integers(len(site.nodes.weights)))
        places = first_design(site, request.observed_m, left, budget_m, first_node)
        price = relative_price * variance(places) / samples
        places = drawn_taut(site, variance, places, price, budget_m, int(extra.get("first_steps", FIRST_STEPS)))
        cost = worth(site, variance, places, price, budget_m)
        if cost < least:
            best, least = places, cost
    return best


@lru_cache(maxsize=4)
def _labelled(grid: SiteGrid, traversable: bytes) -> tuple[OpenGround, NDArray[np.int32]]:
    """Open ground, and the number of the connected part (rows, columns) that each open cell is in. Remembered."""
    ground = OpenGround(grid, np.frombuffer(traversable, dtype=np.bool_).reshape(grid.shape))
    return ground, ndimage.label(ground.open)[0]


@lru_cache(maxsize=4)
def _nearest(grid: SiteGrid, traversable: bytes, part: int) -> NDArray[np.int32]:
    """Row and column (2, rows, columns) of the cell of that part that is nearest to each cell. Remembered.

    Raises NoRoute if the part is a single cell: whoever stands there is walled in.
    """
    _, labels = _labelled(grid, traversable)
    within = labels == part
    if np.count_nonzero(within) < 2:
        row, column = np.argwhere(within)[0]
        x, y = (column + 0.5) * grid.resolution_m, (row + 0.5) * grid.resolution_m
        raise NoRoute(f"walled in at ({x:g}, {y:g}) m: no other cell can be reached from there")
    return np.asarray(ndimage.distance_transform_edt(~within, return_distances=False, return_indices=True))


def _settled(grid: SiteGrid, nearest: NDArray[np.int32], places: FloatArray) -> FloatArray:
    """The places (n, 2) [m] where they can be reached, the centre of the nearest cell that can be where not."""
    size = grid.resolution_m
    columns = np.clip((places[:, 0] / size).astype(np.intp), 0, grid.columns - 1)
    rows = np.clip((places[:, 1] / size).astype(np.intp), 0, grid.rows - 1)
    to_row, to_column = nearest[0, rows, columns], nearest[1, rows, columns]
    stays = (to_row == rows) & (to_column == columns) & grid.contains(places)
    centres = (np.column_stack((to_column, to_row)) + 0.5) * size
    return np.where(stays[:, None], places, centres)


def _on_centres(grid: SiteGrid, places: FloatArray) -> FloatArray:
    """The centres of the cells that the places (n, 2) [m] are in: clear of edges that other cells share."""
    rows, columns = grid.cells_of(places)
    centres: FloatArray = (np.column_stack((columns, rows)).astype(np.float64) + 0.5) * grid.resolution_m
    return centres


def _average_variance(request: PlanningRequest, nodes: FieldNodes) -> AverageVariance:
    hyperparameters, grid = request.hyperparameters, request.grid
    samples = request.samples_left + len(request.observed_m)
    spacing_m = sqrt(grid.width_m * grid.height_m / samples)
    kernel = telling(hyperparameters.kernel, SHORTEST_IN_SPACINGS * spacing_m, LONGEST_IN_SPACINGS * spacing_m)
    return AverageVariance(kernel.of_squared_distance, hyperparameters.noise_variance, nodes, request.observed_m)


def telling(kernel: Kernel, shortest_m: float, longest_m: float) -> Kernel:
    """The kernel with its length scales within these bounds [m]: itself, where they are."""
    parameters = {
        name: min(max(value, shortest_m), longest_m) if name.endswith("length_scale_m") else value
        for name, value in kernel.parameters().items()
    }
    return kernel_from(kernel.name, parameters)


def _toured(
    ground: OpenGround, start: FloatArray, places: FloatArray, kicks: int, seed: int
) -> tuple[FloatArray, list[FloatArray]]:
    """The places (n, 2) [m] in the order of a short tour from the start, and the free way to each of them."""
    stops = np.vstack((start, places))
    table = leg_table(ground, stops)
    lengths = table.lengths_m.copy()
    found: dict[tuple[int, int], FloatArray] = {}
    order = short_tour(lengths, np.arange(len(stops)), kicks, seed)
    for look in range(LATEST_LOOKS):
        legs = [(min(i, j), max(i, j)) for i, j in pairwise(order.tolist()) if not table.free[i, j]]
        for i, j in legs:
            if (i, j) not in found:
                found[i, j] = shortest_way(ground, stops[i], stops[j])
                lengths[i, j] = lengths[j, i] = path_length(found[i, j])
        if look == LATEST_LOOKS - 1:
            break
        better = short_tour(lengths, order)
        if np.array_equal(better, order):
            break
        order = better
    ways = []
    for i, j in pairwise(order.tolist()):
        if table.free[i, j]:
            ways.append(leg_path(table, stops, i, j))
        else:
            ways.append(found[i, j] if i < j else found[j, i][::-1])
    return stops[order[1:]], ways


def _first_round(
    request: PlanningRequest, toured: tuple[FloatArray, list[FloatArray]], budget_m: float
) -> PlannedRound:
    """The round's share of the tour; where all of it is longer than the budget, samples go where the budget ends."""
    places, ways = toured
    route = joined(ways)
    at = np.cumsum([path_length(way) for way in ways])
    if at[-1] > budget_m:
        at = _within_budget(at, max(budget_m, 0.0))
        route = cut(route, at[-1])
        along = arc_lengths(route)
        places = np.column_stack([np.interp(at, along, route[:, k]) for k in (0, 1)])
    now, later = places[: request.samples], places[request.samples :]
    path = cut(route, float(at[request.samples - 1]))
    path[-1] = now[-1]
    return replace(planned(request, path, now), outlook_m=later)


def _within_budget(at: FloatArray, budget_m: float) -> FloatArray:
    """Distances (n,) [m] along the route: those within the budget, and for the others the middles of the longest
    gaps."""
    within = [0.0, *at[at <= budget_m].tolist(), budget_m]
    for _ in range(len(at) - len(within) + 2):
        gap = int(np.argmax(np.diff(within)))
        within.insert(gap + 1, 0.5 * (within[gap] + within[gap + 1]))
    return np.array(within[1:][: len(at)])

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

from functools import lru_cache
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from he3.design_of_samples import AverageVariance, FieldNodes, field_nodes
from he3.errors import InvalidInput, NoRoute
from he3.frames import FloatArray, SiteGrid, path_length
from he3.kernels import Kernel, kernel_from
from he3.touring import short_tour
from services.ground.planners.rounds import arc_lengths, cut, planned
from services.ground.planners.tour_design import Site, drawn_taut, first_design
from services.ground.planners.tour_legs import joined, leg_path, leg_table
from services.ground.planners.tour_ways import shortest_way
from services.ground.planners.traversability import OpenGround
from services.ground.planning import PlannedRound, PlanningRequest, checked

THRIFT = 0.15
"""Per cent of variance that one per cent of the tour has to be worth: about where the tour is 8 % shorter than one
through the middle of equal shares, for half a per cent of RMSE."""
STEPS = 30
KICKS = 10
SETTINGS = ("thrift", "steps", "kicks")
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
    rng = np.random.default_rng(request.seed)
    first_node = int(rng.integers(len(nodes.weights)))
    places = first_design(site, request.observed_m, request.samples_left, budget_m, first_node)
    price = _price(request, variance, places, float(extra.get("thrift", THRIFT)))
    places = drawn_taut(site, variance, places, price, budget_m, int(extra.get("steps", STEPS)))
    places = _on_centres(grid, site.settle(places))
    pieces = _toured(ground, start, places, int(extra.get("kicks", KICKS)), request.seed)
    return _first_round(request, pieces, budget_m)


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
    return (np.column_stack((columns, rows)) + 0.5) * grid.resolution_m


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


def _price(request: PlanningRequest, variance: AverageVariance, places: FloatArray, thrift: float) -> float:
    """Units of average variance that a metre has to be worth.

    The same all through a mission, but for the hyperparameters: the length is that of a tour through all of its
    samples, taken or left, at even spacing.
    """
    samples = request.samples_left + len(request.observed_m)
    return thrift * variance(places) / sqrt(samples * request.grid.width_m * request.grid.height_m)


def _toured(ground: OpenGround, start: FloatArray, places: FloatArray, kicks: int, seed: int) -> list[FloatArray]:
    """Free polylines, one a place, from the start through all places (n, 2) [m] in the order of a short tour."""
    stops = np.vstack((start, places))
    table = leg_table(ground, stops)
    lengths = table.lengths_m.copy()
    found: dict[tuple[int, int], FloatArray] = {}
    order = short_tour(lengths, np.arange(len(stops)), kicks, seed)
    for look in range(LATEST_LOOKS):
        unknown = [
            (int(i), int(j)) for i, j in pairwise(order) if not table.free[i, j] and (min(i, j), max(i, j)) not in found
        ]
        if not unknown:
            break
        for i, j in unknown:
            i, j = min(i, j), max(i, j)
            found[i, j] = shortest_way(ground, stops[i], stops[j])
            lengths[i, j] = lengths[j, i] = path_length(found[i, j])
        if look < LATEST_LOOKS - 1:
            order = short_tour(lengths, order)
    pieces = []
    for i, j in pairwise(order):
        if table.free[i, j]:
            pieces.append(leg_path(table, stops, i, j))
        else:
            way = found.get((min(i, j), max(i, j)))
            if way is None:
                way = shortest_way(ground, stops[min(i, j)], stops[max(i, j)])
            pieces.append(way if i < j else way[::-1])
    return pieces


def _first_round(request: PlanningRequest, pieces: list[FloatArray], budget_m: float) -> PlannedRound:
    """The round's share of the tour; where all of it is longer than the budget, samples go where the budget ends."""
    route = joined(pieces)
    at = np.cumsum([path_length(piece) for piece in pieces])
    if at[-1] > budget_m:
        at = _within_budget(at, max(budget_m, 0.0))
        route = cut(route, max(budget_m, 0.0))
    at = at[: request.samples]
    path = cut(route, float(at[-1]))
    along = arc_lengths(route)
    samples = np.column_stack([np.interp(at, along, route[:, k]) for k in (0, 1)])
    return planned(request, path, samples)


def _within_budget(at: FloatArray, budget_m: float) -> FloatArray:
    """Distances (n,) [m] along the route: those within the budget, and for the others the middles of the longest
    gaps."""
    within = [0.0, *at[at <= budget_m].tolist(), budget_m]
    for _ in range(len(at) - len(within) + 2):
        gap = int(np.argmax(np.diff(within)))
        within.insert(gap + 1, 0.5 * (within[gap] + within[gap + 1]))
    return np.array(within[1:][: len(at)])

"""The planner `tour`: the rest of the mission as one design and one tour, of which the round is the first piece.

All remaining samples and metres are planned together: places that minimise the field's average variance
(``he3.i_optimal_design``), on a tour that is short and within the budget (``tour.design``). The first plan starts from
several designs and optimises the best of them longer, which is worth 1 % of RMSE where the budget binds. All of this is
done on a coarse field, a few cells a sample; only the last steps see a finer one, which is worth 0.3 % of variance.
Later plans start from the outlook of the plan before and adapt it to the refitted hyperparameters, so that rounds agree
with one another and leave no gaps. A request without an outlook is planned from scratch.

A mission without a budget is given one: metres beyond those of a tour through an even lattice gain almost nothing.
Length scales so short that a sample informs about its own place only, or so long that it informs about the whole site,
do not guide a design: they are clamped.

A mission with a goal is planned as the shortest tour after which the goal holds (``tour.covering``), if one is found.
"""

from __future__ import annotations

from dataclasses import replace
from math import isfinite, sqrt

import numpy as np

from he3.errors import InvalidInput, NoRoute
from he3.frames import FloatArray
from he3.i_optimal_design import AverageVariance, FieldNodes, field_nodes
from he3.kernels import Kernel, kernel_from
from services.ground.planners.cheapest import cheapest_ways
from services.ground.planners.gentle import on_gentle_ground
from services.ground.planners.interface import PlannedRound, PlanningRequest, validated
from services.ground.planners.polyline import path_prefix
from services.ground.planners.rounds import lead_cost, planned_round
from services.ground.planners.tour.covering import covering
from services.ground.planners.tour.design import (
    design_from_outlook,
    initial_design,
    objective,
    optimise_places,
    tour_lengths,
)
from services.ground.planners.tour.route import route_through
from services.ground.planners.tour.site import Site, reachable_site

LENGTH_PRICE = 0.03
"""Least per cent of variance that one per cent of the tour must gain, for any budget."""
LEG_SPACINGS = 1.02
"""Straight metres per sample of a mission without a budget, in units of sqrt(reachable area / samples), the spacing of
a square lattice. The shortest tour through random places takes 0.7124 (Beardwood, Halton & Hammersley 1959), one
through a lattice 1; near it, the variance hardly depends on the metres."""
INITIAL_DESIGNS = 8
"""Designs that a plan without an outlook starts from where the budget binds."""
UNBOUND_DESIGNS = 4
"""The same without a budget, where they differ little."""
FINALISTS = 2
"""Designs that are optimised further; the best of them is taken. Without a budget, one is."""
INITIAL_STEPS = 20
"""Steps of every initial design."""
FINAL_STEPS = 80
"""Further steps of a finalist."""
COARSE_NODES = 625
"""Cells of the coarse field, at least."""
COARSE_NODES_A_SAMPLE = 4.0
"""The same for each sample of the mission."""
FINE_STEPS = 15
"""Last steps of the best design, on the finer field."""
FINE_STEP_M = 1.0
"""Root mean square step on the finer field at the beginning [m]."""
OUTLOOK_STEPS = 6
"""Steps of a design from an outlook."""
OUTLOOK_STEP_M = 1.5
"""Root mean square step of a design from an outlook at the beginning [m]."""
KICKS = 30
"""Kicks of the first plan's tour: see ``he3.tsp.short_tour``."""
OUTLOOK_KICKS = 8
"""The same for a plan from an outlook, which begins with the order of the plan before."""
MAX_OUTLOOK_MISMATCH = 0.34
"""Largest difference between the outlook's samples and those that remain, as a share of the latter."""
BUDGET_ROUNDING = 1e-9
"""Share of the budget that is not used, so that the path's length in another order of summation does not exceed it."""
SETTINGS = ("length_price", "designs", "finalists", "first_steps", "final_steps", "steps", "kicks", "rough")
MIN_LENGTH_SCALE_SPACINGS = 0.5
"""Shortest length scale of a design, in spacings of an even lattice of all samples over the site."""
MAX_LENGTH_SCALE_SPACINGS = 6.0
"""Longest length scale of a design, in the same unit."""


def tour(request: PlanningRequest) -> PlannedRound:
    """The first piece of one tour through one design for all remaining samples, with the rest as its outlook.

    Raises NoRoute if no place is reachable or the budget is spent, InvalidInput for an inconsistent request.
    """
    extra = validated(request).options.extra
    if unknown := set(extra) - set(SETTINGS):
        raise InvalidInput(f"tour knows the settings {', '.join(SETTINGS)}; got {', '.join(sorted(unknown))}")
    request = on_gentle_ground(request)
    nodes = field_nodes(request.grid, request.interest)
    site = reachable_site(request.grid, request.traversable, request.margin_m, request.start_m, nodes, request.cost)
    budget_m = request.budget_m - lead_cost(request, (float(site.start_m[0]), float(site.start_m[1])))
    if not budget_m > 0:
        raise NoRoute(
            f"the travel budget is spent: {max(request.budget_m, 0.0):g} m remain for {request.samples_left} samples"
        )
    for_goal = None if request.goal is None else covering(request, request.goal, site, budget_m)
    if for_goal is not None and for_goal.places_m is not None:
        places = site.snap_to_cell_centres(for_goal.places_m)
    else:
        places = site.snap_to_cell_centres(_design(request, site, budget_m, extra))
    kicks = OUTLOOK_KICKS if _usable_outlook(request) is not None else KICKS
    route = route_through(site, places, int(extra.get("kicks", kicks)), request.seed)
    affordable_m = budget_m * (1.0 - BUDGET_ROUNDING)
    if site.cost is not None and isfinite(budget_m):
        affordable_m = site.cost.metres_for(route.path_m, affordable_m)
    route = route.truncated(affordable_m)
    now, later = route.places_m[: request.samples], route.places_m[request.samples :]
    path = path_prefix(route.path_m, float(route.at_m[len(now) - 1]))
    path[-1] = now[-1]
    if site.cost is not None:
        path = cheapest_ways(site.ground, site.cost, path, route.at_m[: len(now)], request.seed)
    forecast = None if for_goal is None else for_goal.forecast
    return replace(planned_round(request, path, now), outlook_m=later, forecast=forecast)


def _design(request: PlanningRequest, site: Site, budget_m: float, extra: dict[str, float]) -> FloatArray:
    """Places (samples_left, 2) [m] in the order of their tour: from the outlook, or the best of several designs."""
    left, samples = request.samples_left, request.samples_left + len(request.observed_m)
    leg_m = LEG_SPACINGS * sqrt(site.area_m2 / samples)
    length_price = float(extra.get("length_price", LENGTH_PRICE)) / (samples * leg_m)

    def weighed(places: FloatArray, variance: AverageVariance) -> tuple[float, float]:
        """The price of a metre, and the metres of the budget."""
        metres = budget_m if isfinite(budget_m) else _default_budget_m(site, places, leg_m)
        return length_price * variance(places), metres

    def optimised(places: FloatArray, steps: int) -> tuple[float, FloatArray]:
        price, metres = weighed(places, coarse)
        places = optimise_places(site, coarse, places, price, metres, steps)
        return objective(site, coarse, places, price, metres), places

    fine = _average_variance(request, site.nodes)
    if (outlook_m := _usable_outlook(request)) is not None:
        places = design_from_outlook(site, request.observed_m, outlook_m, left)
        steps = int(extra.get("steps", OUTLOOK_STEPS))
        return optimise_places(site, fine, places, *weighed(places, fine), steps, OUTLOOK_STEP_M, ordered=False)
    most = max(COARSE_NODES, round(COARSE_NODES_A_SAMPLE * samples))
    coarse = _average_variance(request, field_nodes(request.grid, request.interest, most))
    count, finalists = (INITIAL_DESIGNS, FINALISTS) if isfinite(budget_m) else (UNBOUND_DESIGNS, 1)
    rng = np.random.default_rng(request.seed)
    designs = []
    for _ in range(max(1, int(extra.get("designs", count)))):
        first_node = int(rng.integers(len(site.nodes.weights)))
        places = initial_design(site, request.observed_m, left, budget_m, first_node)
        designs.append(optimised(places, int(extra.get("first_steps", INITIAL_STEPS))))
    designs.sort(key=lambda design: design[0])
    if (final_steps := int(extra.get("final_steps", FINAL_STEPS))) > 0:
        best = designs[: max(1, int(extra.get("finalists", finalists)))]
        designs = sorted([*designs, *(optimised(places, final_steps) for _, places in best)], key=lambda one: one[0])
    places = designs[0][1]
    return optimise_places(site, fine, places, *weighed(places, fine), FINE_STEPS, FINE_STEP_M, ordered=False)


def _usable_outlook(request: PlanningRequest) -> FloatArray | None:
    """The outlook (k, 2) [m], if it has about as many places as samples remain."""
    outlook_m, left = request.outlook_m, request.samples_left
    return outlook_m if outlook_m is not None and abs(len(outlook_m) - left) <= MAX_OUTLOOK_MISMATCH * left else None


def _default_budget_m(site: Site, places: FloatArray, leg_m: float) -> float:
    """The budget [m] of a tour through the places (n, 2) [m] if none is given: legs of ``leg_m``, detours included."""
    # In metres also where legs cost something else: what terrain costs beyond level ground is to be saved elsewhere.
    around_obstacles, straight = tour_lengths(replace(site, cost=None), places)
    return len(places) * leg_m * max(around_obstacles, leg_m) / max(straight, leg_m)


def _average_variance(request: PlanningRequest, nodes: FieldNodes) -> AverageVariance:
    hyperparameters, grid = request.hyperparameters, request.grid
    spacing_m = sqrt(grid.width_m * grid.height_m / (request.samples_left + len(request.observed_m)))
    kernel = clamp_length_scales(
        hyperparameters.kernel, MIN_LENGTH_SCALE_SPACINGS * spacing_m, MAX_LENGTH_SCALE_SPACINGS * spacing_m
    )
    rough = bool(request.options.extra.get("rough"))
    noise = hyperparameters.noise_variance
    return AverageVariance(kernel.of_squared_distance, noise, nodes, request.observed_m, rough=rough)


def clamp_length_scales(kernel: Kernel, shortest_m: float, longest_m: float) -> Kernel:
    """The kernel with its length scales clamped to shortest_m..longest_m."""
    parameters = {
        name: min(max(value, shortest_m), longest_m) if name.endswith("length_scale_m") else value
        for name, value in kernel.parameters().items()
    }
    return kernel_from(kernel.name, parameters)

"""An example of a plug-in planner: drive to the most uncertain place, and from there to the next.

    he3 run t1 --in-process --planner examples.most_uncertain:most_uncertain
    he3 bench paper --seeds 3 --regions t1 --planners rrtstar,tour,examples.most_uncertain:most_uncertain

It has neither tree nor utility. It is greedy: each place is chosen given the samples before it, for any length of
the path to it. Compare the metres that it drives.
"""

from __future__ import annotations

import numpy as np

from he3.errors import NoRoute
from he3.frames import path_length
from services.ground.planners.interface import PlannedRound, PlanningRequest, validated
from services.ground.planners.rounds import belief_given, planned_round
from services.ground.planners.routes import RouteFinder
from services.ground.planners.traversability import OpenGround

SPACING_CELLS = 10
"""Spacing of the candidate places."""


def most_uncertain(request: PlanningRequest) -> PlannedRound:
    """The round to the most uncertain places within the budget, one by one. Raises NoRoute if there is none."""
    grid = validated(request).grid
    ground = OpenGround(grid, request.traversable, request.margin_m)
    routes = RouteFinder(ground)
    here = ground.footing(request.start_m)
    rows, columns = (axis[ground.clearance > 1] for axis in np.mgrid[: grid.rows, : grid.columns])
    kept = (rows % SPACING_CELLS == 0) & (columns % SPACING_CELLS == 0)
    rows, columns = rows[kept], columns[kept]
    places = (np.column_stack((columns, rows)) + 0.5) * grid.resolution_m
    interest = np.ones(len(places)) if request.interest is None else request.interest[rows, columns]
    belief = belief_given(request)
    path, chosen, left_m = [np.array([here])], [], request.budget_m
    while len(chosen) < request.samples and len(places):
        within_reach = routes.distances_from(here)[rows, columns] <= left_m
        uncertainty = np.where(within_reach, interest * belief.predict(places)[1], -1.0)
        best = int(np.argmax(uncertainty))
        if uncertainty[best] < 0:
            break
        target = (float(places[best, 0]), float(places[best, 1]))
        leg = routes.route(here, target)
        left_m -= path_length(leg)
        path.append(leg[1:])
        here = target
        chosen.append(target)
        belief = belief.condition_on_places([target])
    if not chosen:
        raise NoRoute(f"no place to sample is reachable within the remaining {request.budget_m:g} m")
    return planned_round(request, np.vstack(path), np.array(chosen))

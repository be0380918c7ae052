"""A planner of your own: always on to the most uncertain place, and from there to the next.

    he3 run t1 --in-process --planner examples.most_uncertain:most_uncertain
    he3 bench paper --seeds 3 --regions t1 --planners rrtstar,tour,examples.most_uncertain:most_uncertain

It needs no tree and asks for no utility, but it is greedy: what one sample will teach about the places around it is
taken into account before the next is chosen, what the way there costs is not. See how many metres that takes.
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
"""Of the places among which it chooses."""


def most_uncertain(request: PlanningRequest) -> PlannedRound:
    """The round to the most uncertain places within reach, one after the other. Raises NoRoute if there is none."""
    grid = validated(request).grid
    ground = OpenGround(grid, request.traversable)
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
        worth = np.where(within_reach, interest * belief.predict(places)[1], -1.0)
        best = int(np.argmax(worth))
        if worth[best] < 0:
            break
        target = (float(places[best, 0]), float(places[best, 1]))
        leg = routes.route(here, target)
        left_m -= path_length(leg)
        path.append(leg[1:])
        here = target
        chosen.append(target)
        belief = belief.condition_on_places([target])
    if not chosen:
        raise NoRoute(f"no place to sample can be reached within the {request.budget_m:g} m that are left")
    return planned_round(request, np.vstack(path), np.array(chosen))

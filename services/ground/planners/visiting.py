"""A round through places that a person has chosen, in their order: the ways between them are found here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from services.ground.planners.rounds import planned_round
from services.ground.planners.routes import RouteFinder
from services.ground.planners.traversability import OpenGround

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from services.ground.planners.interface import PlannedRound, PlanningRequest


def visiting(request: PlanningRequest, places_m: FloatArray) -> PlannedRound:
    """The round that samples these places (k, 2) [m] in this order.

    Each way is straight where that is free, else a shortened one around the obstacles; with a cost, the cheapest one
    that a lattice of cells has. Raises NoRoute for a place that no way leads to. With ways around obstacles it takes
    some tens of milliseconds each on 500 x 500 cells.
    """
    ground = OpenGround(request.grid, request.traversable, request.margin_m)
    here = np.array(ground.footing(request.start_m), dtype=np.float64)
    finder: RouteFinder | None = None
    path = [here[None]]
    for number, place in enumerate(places_m):
        way = np.vstack((here, place))
        if not ground.segments_free(way[:1], way[1:])[0]:
            finder = finder or RouteFinder(ground)
            way = finder.route((float(here[0]), float(here[1])), (float(place[0]), float(place[1])))
        if request.cost is not None:
            from services.ground.planners.cheapest import cheapest_way

            way = cheapest_way(ground, request.cost, way, request.seed + number, iterations=0)
        path.append(way[1:])
        here = place
    whole = np.vstack(path)
    stays = np.concatenate(([False], (np.diff(whole, axis=0) == 0.0).all(axis=1)))  # two samples of one place
    return planned_round(request, whole[~stays], places_m)

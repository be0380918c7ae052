"""The planners: one signature for all, arrays and frozen values in, a planned round out.

They are named here and imported when asked for, so that whoever only needs the names needs no OMPL. Anybody's own is
named ``module:function`` (``services.ground.planners.plugin``).
"""

from __future__ import annotations

from importlib import import_module

from he3.errors import InvalidInput
from services.ground.planners.interface import PlannedRound, Planner, PlanningRequest

PLANNERS = {
    "rrt": "services.ground.planners.rrt",
    "rrtstar": "services.ground.planners.rrt",
    "informative": "services.ground.planners.informative",
    "tour": "services.ground.planners.tour.planner",
}
"""Name of each planner, which is also its function's name, and the module that holds it."""


def planner_named(name: str) -> Planner:
    """The planner of that name, ours or anybody's; raises InvalidInput for a name that none has."""
    if ":" in name:
        own: Planner = import_module("services.ground.planners.plugin").load_plugin(name)
        return own
    if name not in PLANNERS:
        raise InvalidInput(f"expected a planner among {', '.join(PLANNERS)}, or module:function; got {name!r}")
    planner: Planner = getattr(import_module(PLANNERS[name]), name)
    return planner


def plan(name: str, request: PlanningRequest) -> PlannedRound:
    """What the planner of that name answers to the request: one picklable callable for all of them."""
    return planner_named(name)(request)

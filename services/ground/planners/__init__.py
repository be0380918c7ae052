"""The planners, all with one signature: a request of arrays and frozen values in, a planned round out.

They are named here and imported on demand, so that their names are known without OMPL. A plug-in planner is
named ``module:function`` (``services.ground.planners.plugin``). Every planner's answers are validated in one place
(``services.ground.planners.validation``).
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from services.ground.planners.validation import checked_answer

if TYPE_CHECKING:
    from services.ground.planners.interface import PlannedRound, Planner, PlanningRequest

PLANNERS = {
    "rrt": "services.ground.planners.rrt",
    "rrtstar": "services.ground.planners.rrt",
    "informative": "services.ground.planners.informative",
    "tour": "services.ground.planners.tour.planner",
}
"""Name of each built-in planner, which is also its function's name, and its module."""


def planner_named(name: str) -> Planner:
    """The planner of that name, built-in or plug-in, with its answers validated.

    Raises InvalidInput for a name that no planner has, or a plug-in that cannot be imported.
    """
    if ":" in name:
        planner: Planner = import_module("services.ground.planners.plugin").load_plugin(name)
    elif name in PLANNERS:
        planner = getattr(import_module(PLANNERS[name]), name)
    else:
        raise InvalidInput(f"expected a planner among {', '.join(PLANNERS)}, or module:function; got {name!r}")
    return partial(_validated, name, planner)


def _validated(name: str, planner: Planner, request: PlanningRequest) -> PlannedRound:
    return checked_answer(name, planner(request), request)


def plan(name: str, request: PlanningRequest) -> PlannedRound:
    """The round that the planner of that name plans: one picklable callable for all planners."""
    return planner_named(name)(request)

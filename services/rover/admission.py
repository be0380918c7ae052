"""Plan admission: whether a plan can be executed from the place where the rover will be when the plan begins. Pure."""

from __future__ import annotations

import math
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from services.rover.activities import Activity, Leg, legs_of

if TYPE_CHECKING:
    from he3.frames import Place, SiteGrid
    from schemas.plans import MissionPlan, RoundPlan
    from services.rover.keep_outs import KeepOuts

JOIN_TOLERANCE_M: Final = 2.0  # m between where a round begins and where the rover will be
MAX_ROUND_M: Final = 50_000.0  # m of path in one round; more is an error: a whole mission drives 20 km
MAX_ROUND_SIDES: Final = 100.0  # of a site so large that this allows more, times its longer side


@dataclass(frozen=True, slots=True)
class Admission:
    """The facts with which a plan must agree."""

    accepted: MissionPlan | None
    """The last plan accepted."""
    last_begun: int
    """The last round that has begun; 0 before the first."""
    replannable: bool
    """Whether that round was aborted, so that it may be planned again."""
    start_m: Place
    """Where the rover will be when the next round begins [m]."""
    measured: AbstractSet[str]
    """Samples that must not be taken again: measured, or part of the current activity."""
    site: SiteGrid
    keep_outs: KeepOuts


def admit(plan: MissionPlan, admission: Admission) -> tuple[Activity, ...] | str:
    """The plan's rounds that have not begun, as activities; or one line that says why the plan is rejected."""
    newest = admission.accepted
    if newest is not None and plan.revision <= newest.revision:
        return f"expected a revision newer than {newest.revision}, got {plan.revision}"
    next_round = admission.last_begun + 1
    first = admission.last_begun if admission.replannable else next_round
    rounds = [planned for planned in plan.rounds if planned.round >= first]
    if not rounds:
        return f"expected rounds from {first} on, got {plan.rounds[-1].round} as the last: all have begun"
    if rounds[0].round > next_round:
        return f"expected round {next_round} next, got {rounds[0].round}"
    activities: list[Activity] = []
    start = admission.start_m
    for planned in rounds:
        legs = _admit_round(planned, start, admission)
        if isinstance(legs, str):
            return legs
        activity = Activity(legs, round=planned.round, revision=plan.revision)
        start = activity.end_m or start
        activities.append(activity)
    return tuple(activities)


def _admit_round(planned: RoundPlan, start: Place, admission: Admission) -> tuple[Leg, ...] | str:
    begins = planned.path_m[0]
    gap = math.dist(begins, start)
    if gap > JOIN_TOLERANCE_M:
        return (
            f"expected round {planned.round} to begin within {JOIN_TOLERANCE_M:g} m of ({start[0]:.2f}, "
            f"{start[1]:.2f}), where the rover will be, got ({begins[0]:.2f}, {begins[1]:.2f}), {gap:.1f} m away"
        )
    for sample in planned.samples:
        if sample.sample_id in admission.measured:
            return f"round {planned.round}: expected new samples, got {sample.sample_id}, which is measured already"
    stray = outside(admission.site, (*planned.path_m, *((s.x_m, s.y_m) for s in planned.samples)))
    if stray is not None:
        return f"round {planned.round}: {stray}"
    length = sum(math.dist(a, b) for a, b in zip(planned.path_m, planned.path_m[1:], strict=False))
    longest = max(MAX_ROUND_M, MAX_ROUND_SIDES * max(admission.site.width_m, admission.site.height_m))
    if length > longest:
        return f"round {planned.round}: expected a path of at most {longest:g} m, got {length:.0f} m"
    legs = legs_of(planned)
    if isinstance(legs, str):
        return legs
    closed = admission.keep_outs.objection((start, *(vertex for leg in legs for vertex in leg.path_m)))
    return legs if closed is None else f"round {planned.round}: {closed}"


def outside(site: SiteGrid, places_m: tuple[Place, ...]) -> str | None:
    """One line on the first of the places that lies outside the site; None if all lie in it."""
    within = site.contains(np.array(places_m))
    if within.all():
        return None
    x, y = places_m[int(np.argmin(within))]
    return f"expected places within 0..{site.width_m:g} m east and 0..{site.height_m:g} m north, got ({x:g}, {y:g})"

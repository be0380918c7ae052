"""Whether a plan may be executed: a pure question about the plan and where the rover will be when its turn comes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from he3.frames import Place, SiteGrid
from schemas.plans import MissionPlan, RoundPlan
from services.rover.activities import Activity, Leg, legs_of
from services.rover.geometry import Area

JOIN_TOLERANCE_M: Final = 2.0  # m between where a round begins and where the rover will be
MAX_ROUND_M: Final = 50_000.0  # m of way in a round: more is a mistake, the whole mission drives 20 km


@dataclass(frozen=True, slots=True)
class Situation:
    """What a plan has to fit."""

    accepted: MissionPlan | None
    """The last plan that was."""
    begun: int
    """The last round that has begun; 0 before the first."""
    replannable: bool
    """That round was aborted, so it may be planned again."""
    place_m: Place
    """Where the rover will be when the next round begins."""
    measured: frozenset[str] | set[str]
    """Samples that must not be taken again: done, or part of the round under way."""
    site: SiteGrid
    areas: Mapping[str, Area]
    margin_m: float
    """Distance to keep from those areas [m]."""


def admitted(plan: MissionPlan, situation: Situation) -> tuple[Activity, ...] | str:
    """The plan's rounds that have not begun, laid out; or one line that says why the plan is rejected."""
    newest = situation.accepted
    if newest is not None and plan.revision <= newest.revision:
        return f"expected a revision newer than {newest.revision}, got {plan.revision}"
    first = situation.begun if situation.replannable else situation.begun + 1
    rounds = [planned for planned in plan.rounds if planned.round >= first]
    if not rounds:
        return f"expected rounds from {first} on, got {plan.rounds[-1].round} as the last: all have begun"
    if rounds[0].round > situation.begun + 1:
        return f"expected round {situation.begun + 1} next, got {rounds[0].round}"
    jobs: list[Activity] = []
    place = situation.place_m
    for planned in rounds:
        laid_out = _laid_out(planned, place, situation)
        if isinstance(laid_out, str):
            return laid_out
        job = Activity(laid_out, round=planned.round, revision=plan.revision)
        place = job.ends_m or place
        jobs.append(job)
    return tuple(jobs)


def _laid_out(planned: RoundPlan, place: Place, situation: Situation) -> tuple[Leg, ...] | str:
    begins = planned.path_m[0]
    gap = math.dist(begins, place)
    if gap > JOIN_TOLERANCE_M:
        return (
            f"expected round {planned.round} to begin within {JOIN_TOLERANCE_M:g} m of ({place[0]:.2f}, "
            f"{place[1]:.2f}), where the rover will be, got ({begins[0]:.2f}, {begins[1]:.2f}), {gap:.1f} m away"
        )
    for sample in planned.samples:
        if sample.sample_id in situation.measured:
            return f"round {planned.round}: expected new samples, got {sample.sample_id}, which is measured already"
    stray = outside(situation.site, (*planned.path_m, *((s.x_m, s.y_m) for s in planned.samples)))
    if stray is not None:
        return f"round {planned.round}: {stray}"
    length = sum(math.dist(a, b) for a, b in zip(planned.path_m, planned.path_m[1:], strict=False))
    if length > MAX_ROUND_M:
        return f"round {planned.round}: expected a path of at most {MAX_ROUND_M:g} m, got {length:.0f} m"
    legs = legs_of(planned)
    if isinstance(legs, str):
        return legs
    closed = closed_off((place, *(vertex for leg in legs for vertex in leg.way_m)), situation.areas, situation.margin_m)
    return legs if closed is None else f"round {planned.round}: {closed}"


def outside(site: SiteGrid, places_m: tuple[Place, ...]) -> str | None:
    """One line on the first of the places that lies outside the site; None if all are in it."""
    within = site.contains(np.array(places_m))
    if within.all():
        return None
    x, y = places_m[int(np.argmin(within))]
    return f"expected places within 0..{site.width_m:g} m east and 0..{site.height_m:g} m north, got ({x:g}, {y:g})"


def closed_off(way_m: tuple[Place, ...], areas: Mapping[str, Area], margin_m: float) -> str | None:
    """One line on the first closed area that the way comes near; None if it keeps clear of all.

    An area that the way begins in does not count until the way has left it: that is how the rover gets out.
    """
    for name, area in areas.items():
        leaving = area.is_near(way_m[0], way_m[0], margin_m)
        for a, b in itertools.pairwise(way_m):
            near = area.is_near(a, b, margin_m)
            if near and not leaving:
                return f"the way from ({a[0]:.2f}, {a[1]:.2f}) to ({b[0]:.2f}, {b[1]:.2f}) enters keep-out {name}"
            leaving = leaving and area.is_near(b, b, margin_m)
        if leaving and len(way_m) > 1:
            return f"the way ends within keep-out {name}"
    return None

"""Makes the plan message of a round from a planner's answer.

Four types describe a round, each in its place: `PlannedRound` is a planner's answer, `PlanningTask` a round that is
being planned, `RoundPlan` the message to the rover, `RoundRecord` the entry of a round that was sent in the round log.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import dist
from typing import TYPE_CHECKING

from schemas.plans import PlannedSample, RoundPlan

if TYPE_CHECKING:
    from he3.frames import FloatArray, Place
    from services.ground.planners.interface import PlannedRound
    from services.mission.mission_time import MissionTime


@dataclass(frozen=True, slots=True)
class PlanningTask:
    """A round that is being planned."""

    job: str
    """Name of the computation."""
    number: int
    """Number of the round."""
    samples_left: int
    """How many samples the rest of the mission takes, this round included."""
    attempt: int
    """Number of failed attempts to plan this round."""
    known: int
    """Measurements in the map when planning began."""
    pending: tuple[str, ...]
    """Measurements under way that are counted in."""


@dataclass(frozen=True, slots=True)
class ProposedRound:
    """A round that is planned and waits for the operator's approval."""

    number: int
    """Number of the proposal."""
    task: PlanningTask
    plan: RoundPlan
    outlook_m: FloatArray | None
    """The planner's outlook, as in `PlannedRound`."""
    proposed_at: MissionTime


def round_plan(number: int, planned: PlannedRound, version: str, depth_m: float) -> RoundPlan:
    """The round of that number as a message, its places rounded to the millimetre.

    version: what tells the ids of its samples from those of an earlier plan of that round; depth_m: of each hole.
    """
    return RoundPlan(
        round=number,
        path_m=tuple(_rounded(place) for place in planned.path_m),
        samples=tuple(
            PlannedSample(
                sample_id=sample_id(number, version, index),
                x_m=_rounded(place)[0],
                y_m=_rounded(place)[1],
                depth_m=depth_m,
            )
            for index, place in enumerate(planned.samples_m, 1)
        ),
        information_nats=planned.information_nats,
    )


def path_length_m(plan: RoundPlan) -> float:
    """Length of the round's path [m]."""
    return sum(dist(a, b) for a, b in pairwise(plan.path_m))


def sample_id(number: int, version: str, index: int) -> str:
    """The id of the sample at that place of a round, from 1: ``r07s3``, or ``r07v12s3`` in a later version."""
    return f"r{number:02d}{version}s{index}"


def _rounded(place: FloatArray) -> Place:
    """To the millimetre: below what a rover holds, and half the bytes."""
    return round(float(place[0]), 3), round(float(place[1]), 3)

"""What the rover is about: rounds laid out as legs from stop to stop, and errands of the operator's."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from he3.frames import Place
from schemas.plans import PlannedSample, RoundPlan
from services.rover.drill import Hole
from services.rover.geometry import nearest_share, squared_distance

SAMPLE_TOLERANCE_M: Final = 0.5  # m that a sample may lie beside its path; the rover drives to the sample itself
_SAME_PLACE_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Leg:
    """A way to a stop: vertices still to be reached, and the sample to take at the last of them, if any."""

    way_m: tuple[Place, ...]
    sample: PlannedSample | None


def legs_of(planned: RoundPlan) -> tuple[Leg, ...] | str:
    """The round's path cut at its samples; or one line that says which sample does not lie on it, in order."""
    path = planned.path_m
    legs: list[Leg] = []
    vertex, place = 0, path[0]  # how far along the path the last stop was: on the segment from vertex to the next
    for sample in planned.samples:
        target = (sample.x_m, sample.y_m)
        found = _along(path, vertex, place, target)
        if found is None:
            return (
                f"expected sample {sample.sample_id} within {SAMPLE_TOLERANCE_M:g} m of the path of round "
                f"{planned.round}, after the sample before it, got ({target[0]:g}, {target[1]:g})"
            )
        reached, place = found
        legs.append(Leg((*path[vertex + 1 : reached + 1], target), sample))
        vertex = reached
    rest = path[vertex + 1 :]
    if rest or not legs:
        legs.append(Leg(rest, None))
    # The path's first vertex is a way point too: the rover may stand a little beside it.
    return (Leg((path[0], *legs[0].way_m), legs[0].sample), *legs[1:])


def _along(path: tuple[Place, ...], vertex: int, place: Place, target: Place) -> tuple[int, Place] | None:
    """Segment and place on it, at or after the given ones, where the path first comes nearest to the target.

    The first approach counts, not the nearest of all: later samples need what of the path is left.
    """
    if len(path) == 1:
        return (0, place) if math.dist(place, target) <= SAMPLE_TOLERANCE_M else None
    best: tuple[float, int, Place] | None = None
    for index in range(vertex, len(path) - 1):
        a, b = (place if index == vertex else path[index]), path[index + 1]
        squared = squared_distance(target, a, b)
        if squared <= SAMPLE_TOLERANCE_M**2 and (best is None or squared < best[0]):
            share = nearest_share(target, a, b)
            best = (squared, index, (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])))
        elif best is not None:
            break
        if best is not None and best[0] <= _SAME_PLACE_M**2:
            break
    return best and (best[1], best[2])


@dataclass(slots=True)
class Activity:
    """What is being executed: a round of a plan (`round` > 0), or an errand of a telecommand."""

    legs: tuple[Leg, ...]
    round: int = 0
    revision: int = 0
    command_id: str | None = None
    leg: int = 0
    vertex: int = 0
    hole: Hole | None = None
    measured: list[str] = field(default_factory=list)
    """Samples of it whose number is known."""
    leaving: set[str] = field(default_factory=set)
    """Closed areas that it began in, and has not come out of yet."""

    @property
    def ends_m(self) -> Place | None:
        """Where it ends; None if it leads nowhere else."""
        for leg in reversed(self.legs):
            if leg.way_m:
                return leg.way_m[-1]
        return None

"""Activities: a round of a plan, or a drive that an operator commanded, as legs from stop to stop."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from services.rover.drill import Borehole
from services.rover.geometry import nearest_fraction, squared_distance

if TYPE_CHECKING:
    from he3.frames import Place
    from schemas.commands import Telecommand
    from schemas.plans import PlannedSample, RoundPlan
    from services.runtime.node import SavedState

SAMPLE_TOLERANCE_M: Final = 0.5  # m; how far a sample may lie beside its path. The rover drives to the sample itself.
_SAME_PLACE_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Leg:
    """The path to one stop: its vertices [m], and the sample to take at the last of them, if any."""

    path_m: tuple[Place, ...]
    sample: PlannedSample | None


def legs_of(planned: RoundPlan) -> tuple[Leg, ...] | str:
    """The legs of the round: its path cut at its samples. Or one line on the first sample that is not on the path.

    Samples must lie on the path in their order.
    """
    path = planned.path_m
    legs: list[Leg] = []
    vertex, place = 0, path[0]  # the last stop: a place on the segment that begins at this vertex
    for sample in planned.samples:
        target = (sample.x_m, sample.y_m)
        found = _first_approach(path, vertex, place, target)
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
    # The path's first vertex is a waypoint too: the rover may stand a little beside it.
    return (Leg((path[0], *legs[0].path_m), legs[0].sample), *legs[1:])


def _first_approach(path: tuple[Place, ...], vertex: int, place: Place, target: Place) -> tuple[int, Place] | None:
    """Segment and place where the path, from the given segment and place on, first comes nearest to the target.

    The first approach counts, not the nearest of all: the rest of the path is left for later samples.
    """
    if len(path) == 1:
        return (0, place) if math.dist(place, target) <= SAMPLE_TOLERANCE_M else None
    best: tuple[float, int, Place] | None = None
    for index in range(vertex, len(path) - 1):
        a, b = (place if index == vertex else path[index]), path[index + 1]
        squared = squared_distance(target, a, b)
        if squared <= SAMPLE_TOLERANCE_M**2 and (best is None or squared < best[0]):
            fraction = nearest_fraction(target, a, b)
            best = (squared, index, (a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1])))
        elif best is not None:
            break
        if best is not None and best[0] <= _SAME_PLACE_M**2:
            break
    return best and (best[1], best[2])


@dataclass(slots=True)
class Activity:
    """A round of a plan (`round` > 0), or a commanded drive (`command`), and how far it has come."""

    legs: tuple[Leg, ...]
    round: int = 0
    revision: int = 0
    command: Telecommand | None = None
    leg: int = 0
    vertex: int = 0
    """The next vertex of the current leg's path."""
    borehole: Borehole | None = None
    measured: list[str] = field(default_factory=list)
    """Ids of its samples whose value is known."""
    exempt_keep_outs: set[str] = field(default_factory=set)
    """Keep-outs that the activity began in: they do not stop it until it has left them."""

    @property
    def current_leg(self) -> Leg:
        return self.legs[self.leg]

    @property
    def done(self) -> bool:
        return self.leg == len(self.legs)

    def finish_leg(self) -> None:
        """Begins the next leg."""
        self.borehole, self.vertex = None, 0
        self.leg += 1

    @property
    def end_m(self) -> Place | None:
        """Where the activity ends [m]; None if none of its legs has a path."""
        for leg in reversed(self.legs):
            if leg.path_m:
                return leg.path_m[-1]
        return None

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "legs": self.legs,
            "round": self.round,
            "revision": self.revision,
            "command": self.command,
            "leg": self.leg,
            "vertex": self.vertex,
            "borehole": None if self.borehole is None else self.borehole.checkpoint(),
            "measured": list(self.measured),
            "exempt_keep_outs": set(self.exempt_keep_outs),
        }

    @classmethod
    def restored(cls, state: SavedState) -> Activity:
        """The activity restored from this state."""
        borehole = state["borehole"]
        return cls(**{**state, "borehole": None if borehole is None else Borehole(**borehole)})

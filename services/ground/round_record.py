"""The entry of a round in the round log."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from he3.frames import FloatArray, Place
    from schemas.plans import PlannedSample, RoundPlan, Waypoint
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState


@dataclass(slots=True, eq=False)
class RoundRecord:
    """The entry of one version of one round; `introduced` is the first plan revision that held it."""

    plan: RoundPlan
    introduced: int
    begun: bool = False
    ended: bool = False
    """Whether the rover has reported its end; samples may still be under way."""
    ended_early: bool = False
    """Whether it was aborted: samples that are not reported as measured will not arrive."""
    ended_at: MissionTime = 0
    """Mission time at which it was aborted."""
    settled: set[str] = field(default_factory=set)
    """Samples that arrived or were skipped."""
    arrived: int = 0
    """Number of samples that arrived."""
    done: set[str] = field(default_factory=set)
    """Samples that the rover reported as measured when the round ended."""
    reached_m: float = 0.0
    """Farthest place reached along the path [m]."""
    _arc_m: FloatArray = field(init=False)
    _path_m: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self._path_m = np.array(self.plan.path_m, dtype=np.float64)
        steps = np.hypot(*np.diff(self._path_m, axis=0).T)
        self._arc_m = np.concatenate(([0.0], np.cumsum(steps)))

    @property
    def number(self) -> int:
        return self.plan.round

    @property
    def length_m(self) -> float:
        """Length of the path [m]."""
        return float(self._arc_m[-1])

    @property
    def to_drive_m(self) -> float:
        """Metres of the path that are still to be driven, by the ground's knowledge."""
        return 0.0 if self.ended else self.length_m - self.reached_m

    @property
    def end_m(self) -> Place:
        """Where the path ends [m]."""
        return self.plan.path_m[-1]

    @property
    def pending(self) -> list[PlannedSample]:
        """Samples that are still to come, in the order of the path."""
        if len(self.settled) == len(self.plan.samples):
            return []
        return [
            planned
            for planned in self.plan.samples
            if planned.sample_id not in self.settled and (not self.ended_early or planned.sample_id in self.done)
        ]

    @property
    def closed(self) -> bool:
        """Whether no sample of it is still to come."""
        return not self.pending

    def start(self, at: MissionTime) -> None:
        """Note the start at that time; a round aborted before may start again from an older plan."""
        if self.ended_early and at > self.ended_at:
            self.ended = self.ended_early = False

    def complete(self) -> None:
        """Note that the rover has completed it."""
        if not self.ended:
            self.ended = True
            self.reached_m = self.length_m

    def break_off(self, at: MissionTime) -> None:
        """Note that the rover aborted it at that time."""
        self.ended = self.ended_early = True
        self.ended_at = at

    def give_up(self) -> None:
        """Give it up: the rover executes another version of the round."""
        self.ended = self.ended_early = True

    def settle(self, sample_id: str, arrived: bool = False) -> bool:
        """Close a sample, which arrived or never will; returns whether it was open."""
        if sample_id in self.settled:
            return False
        self.settled.add(sample_id)
        self.arrived += arrived
        return True

    def note_place(self, place_m: Place, tolerance_m: float = 2.0) -> None:
        """Note the progress along the path, if the place is on the part still ahead."""
        if len(self._path_m) < 2:
            return
        a, b = self._path_m[:-1], self._path_m[1:]
        leg = b - a
        squared = np.maximum((leg * leg).sum(axis=1), 1e-12)
        share = np.clip(((np.array(place_m) - a) * leg).sum(axis=1) / squared, 0.0, 1.0)
        foot = a + share[:, None] * leg
        off = np.hypot(foot[:, 0] - place_m[0], foot[:, 1] - place_m[1])
        arc = self._arc_m[:-1] + share * np.sqrt(squared)
        ahead = np.flatnonzero((arc >= self.reached_m - 1e-6) & (off <= tolerance_m))
        if ahead.size:
            # The first passage that fits: a path that crosses itself is not cut short.
            self.reached_m = max(self.reached_m, float(arc[ahead[0]]))

    def driven(self) -> tuple[Waypoint, ...]:
        """The part of the path up to the farthest place reached."""
        whole, here = self._reached()
        return (*self.plan.path_m[:whole], here)

    def ahead(self) -> tuple[Waypoint, ...]:
        """The part of the path beyond the farthest place reached."""
        whole, here = self._reached()
        return (here, *self.plan.path_m[whole:])

    def _reached(self) -> tuple[int, Waypoint]:
        """The number of vertices passed so far, and the farthest place reached."""
        if self.reached_m >= self.length_m:
            return len(self.plan.path_m), self.end_m
        whole = int(np.searchsorted(self._arc_m, self.reached_m, side="right"))
        x, y = (float(np.interp(self.reached_m, self._arc_m, self._path_m[:, axis])) for axis in (0, 1))
        return whole, (x, y)

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "plan": self.plan,
            "introduced": self.introduced,
            "begun": self.begun,
            "ended": self.ended,
            "ended_early": self.ended_early,
            "ended_at": self.ended_at,
            "settled": set(self.settled),
            "arrived": self.arrived,
            "done": set(self.done),
            "reached_m": self.reached_m,
        }

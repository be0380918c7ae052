"""The entry of a round in the round log."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot
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
    changes: int = field(default=0, init=False)
    """Counts what has changed in it since it was made here, apart from its samples."""
    all_settled: bool = field(init=False)
    """Whether every sample arrived or was skipped."""
    _arc_m: FloatArray = field(init=False)
    _x: FloatArray = field(init=False)
    _y: FloatArray = field(init=False)
    _legs: list[list[float]] = field(init=False)
    """Of each leg its beginning x, y, its extent x, y, square and length, and the path up to it [m]."""
    _passed: tuple[float, tuple[Waypoint, ...], tuple[Waypoint, ...]] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.all_settled = len(self.settled) == len(self.plan.samples)
        self._x, self._y = np.array(self.plan.path_m, dtype=np.float64).T.copy()
        leg_x, leg_y = np.diff(self._x), np.diff(self._y)
        self._arc_m = np.concatenate(([0.0], np.cumsum(np.hypot(leg_x, leg_y))))
        squared = np.maximum(leg_x**2 + leg_y**2, 1e-12)
        columns = (self._x[:-1], self._y[:-1], leg_x, leg_y, squared, np.sqrt(squared), self._arc_m[:-1])
        self._legs = np.column_stack(columns).tolist()

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
        if self.all_settled:
            return []
        return [
            planned
            for planned in self.plan.samples
            if planned.sample_id not in self.settled and (not self.ended_early or planned.sample_id in self.done)
        ]

    @property
    def closed(self) -> bool:
        """Whether no sample of it is still to come."""
        return self.all_settled or not self.pending

    def begin(self) -> None:
        """Note that the rover has begun it."""
        if not self.begun:
            self.begun = True
            self.changes += 1

    def start(self, at: MissionTime) -> None:
        """Note the start at that time; a round aborted before may start again from an older plan."""
        if self.ended_early and at > self.ended_at:
            self.ended = self.ended_early = False
            self.changes += 1

    def complete(self) -> None:
        """Note that the rover has completed it."""
        if not self.ended:
            self.ended = True
            self.reached_m = self.length_m
            self.changes += 1

    def break_off(self, at: MissionTime) -> None:
        """Note that the rover aborted it at that time."""
        self.ended = self.ended_early = True
        self.ended_at = at
        self.changes += 1

    def give_up(self) -> None:
        """Give it up: the rover executes another version of the round."""
        self.ended = self.ended_early = True
        self.changes += 1

    def settle(self, sample_id: str, arrived: bool = False) -> bool:
        """Close a sample, which arrived or never will; returns whether it was open."""
        if sample_id in self.settled:
            return False
        self.settled.add(sample_id)
        self.all_settled = len(self.settled) == len(self.plan.samples)
        self.arrived += arrived
        return True

    def note_place(self, place_m: Place, tolerance_m: float = 2.0) -> None:
        """Note the progress along the path, if the place is on the part still ahead."""
        x_m, y_m = place_m
        first = max(0, int(np.searchsorted(self._arc_m, self.reached_m - 1e-3)) - 1)
        for leg in range(first, len(self._legs)):
            begin_x, begin_y, leg_x, leg_y, squared, root, arc_m = self._legs[leg]
            share = min(max(((x_m - begin_x) * leg_x + (y_m - begin_y) * leg_y) / squared, 0.0), 1.0)
            reached_m = arc_m + share * root
            if reached_m < self.reached_m - 1e-6:
                continue
            if hypot(begin_x + share * leg_x - x_m, begin_y + share * leg_y - y_m) <= tolerance_m:
                # The first passage that fits: a path that crosses itself is not cut short.
                if reached_m > self.reached_m:
                    self.reached_m = reached_m
                    self.changes += 1
                return

    def driven(self) -> tuple[Waypoint, ...]:
        """The part of the path up to the farthest place reached."""
        return self._divided()[0]

    def ahead(self) -> tuple[Waypoint, ...]:
        """The part of the path beyond the farthest place reached."""
        return self._divided()[1]

    def _divided(self) -> tuple[tuple[Waypoint, ...], tuple[Waypoint, ...]]:
        """The path up to the farthest place reached, and beyond it."""
        if self._passed is None or self._passed[0] != self.reached_m:
            whole, here = self._reached()
            path = self.plan.path_m
            self._passed = self.reached_m, (*path[:whole], here), (here, *path[whole:])
        return self._passed[1:]

    def _reached(self) -> tuple[int, Waypoint]:
        """The number of vertices passed so far, and the farthest place reached."""
        if self.reached_m >= self.length_m:
            return len(self.plan.path_m), self.end_m
        whole = int(np.searchsorted(self._arc_m, self.reached_m, side="right"))
        x, y = np.interp(self.reached_m, self._arc_m, self._x), np.interp(self.reached_m, self._arc_m, self._y)
        return whole, (float(x), float(y))

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

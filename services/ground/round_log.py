"""The round log: every round that was sent to the rover, with what is known of its execution.

It knows which samples are measured, skipped or still to come, and keeps the versions of rounds that were replaced: the
rover may have begun one of them before it heard of the replacement.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from he3.frames import FloatArray, Place
from schemas.plans import PlannedSample, RoundPlan, Waypoint
from services.ground.budget import Committed
from services.runtime.node import MissionTime
from services.runtime.state_codec import SavedState


@dataclass(slots=True, eq=False)
class RoundRecord:
    """The entry of one version of one round; `introduced` is the first plan revision that held it."""

    plan: RoundPlan
    introduced: int
    begun: bool = False
    ended: bool = False
    """The rover reported its end; samples of it may still be under way."""
    ended_early: bool = False
    """It was broken off: samples that are not reported as done will not come."""
    ended_at: MissionTime = 0
    """When it was broken off."""
    settled: set[str] = field(default_factory=set)
    """Samples that arrived or were skipped."""
    arrived: int = 0
    """Number of samples that arrived."""
    done: set[str] = field(default_factory=set)
    """Samples that the rover reported as measured when the round ended."""
    reached_m: float = 0.0
    """How far along its path the rover is known to have come [m]."""
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
        """Metres of the path that are still to be driven, as far as the ground knows."""
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

    def note_place(self, place_m: Place, tolerance_m: float = 2.0) -> None:
        """Remember how far along the path the rover has come, if that place is on the part of it still ahead."""
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
        """The part of the path up to where the rover is known to have come."""
        whole, here = self._reached()
        return (*self.plan.path_m[:whole], here)

    def ahead(self) -> tuple[Waypoint, ...]:
        """The part of the path from there on."""
        whole, here = self._reached()
        return (here, *self.plan.path_m[whole:])

    def _reached(self) -> tuple[int, Waypoint]:
        """How many vertices the rover is known to have passed, and the place that it is known to have come to."""
        if self.reached_m >= self.length_m:
            return len(self.plan.path_m), self.end_m
        whole = int(np.searchsorted(self._arc_m, self.reached_m, side="right"))
        x, y = (float(np.interp(self.reached_m, self._arc_m, self._path_m[:, axis])) for axis in (0, 1))
        return whole, (x, y)

    def checkpoint(self) -> SavedState:
        """All of it, as named parts."""
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


class RoundLog:
    """The chain of rounds that is in force, and every version that was ever sent."""

    def __init__(self) -> None:
        self.chain: list[RoundRecord] = []
        self._versions: list[RoundRecord] = []
        self._paths_of: object = None
        self._paths: tuple[tuple[Waypoint, ...], tuple[Waypoint, ...]] = ((), ())
        self._of_sample: dict[str, tuple[RoundRecord, int]] = {}

    def append(self, plan: RoundPlan, revision: int) -> RoundRecord:
        """Enter the round that follows the chain, first sent with that revision."""
        record = RoundRecord(plan, revision)
        self.chain.append(record)
        self._versions.append(record)
        self._number_samples(record)
        return record

    def _number_samples(self, record: RoundRecord) -> None:
        for index, planned in enumerate(record.plan.samples):
            self._of_sample[planned.sample_id] = (record, index)

    @property
    def next_number(self) -> int:
        return self.chain[-1].number + 1 if self.chain else 1

    @property
    def end_m(self) -> Place | None:
        """Where the chain ends [m]; None for an empty one."""
        return self.chain[-1].end_m if self.chain else None

    @property
    def idle(self) -> bool:
        """Whether the last round of the chain is over, or there is none."""
        return not self.chain or self.chain[-1].closed or self.chain[-1].ended

    @property
    def open_rounds(self) -> list[RoundRecord]:
        """Rounds of the chain of which something is still to come."""
        return [record for record in self.chain if not record.closed]

    @property
    def not_begun(self) -> list[RoundRecord]:
        """Rounds at the end of the chain that the rover is not known to have begun."""
        first = len(self.chain)
        while first > 0 and not self.chain[first - 1].begun:
            first -= 1
        return self.chain[first:]

    @property
    def pending(self) -> list[PlannedSample]:
        """Samples of the chain that are still to come."""
        return [planned for record in self.chain for planned in record.pending]

    @property
    def completed(self) -> int:
        """Rounds that are over, as far as the ground knows, each with all of its samples here."""
        return sum(record.begun and record.closed for record in self.chain)

    @property
    def fruitless(self) -> int:
        """How many of the last rounds that are over brought no sample."""
        over = [record for record in self.chain if record.begun and record.closed]
        return next((n for n, record in enumerate(reversed(over)) if record.arrived), len(over))

    def committed(self) -> Committed:
        """What the rounds of the chain will still take."""
        metres = sum(record.to_drive_m for record in self.chain)
        return Committed(metres, len(self.pending), len(self.open_rounds))

    def note_place(self, place_m: Place) -> None:
        """The rover was at that place, which tells how far it has come in the round that it executes."""
        executing = next((record for record in reversed(self.chain) if record.begun), None)
        if executing is not None and not executing.ended:
            executing.note_place(place_m)

    def paths(self) -> tuple[tuple[Waypoint, ...], tuple[Waypoint, ...]]:
        """Where the rover is known to have driven, joined over the rounds, and what is planned beyond that.

        The same objects as before as long as neither has changed.
        """
        key = tuple((record.introduced, record.begun, record.ended, record.reached_m) for record in self.chain)
        if key != self._paths_of:
            self._paths_of = key
            self._paths = (
                tuple(vertex for record in self.chain if record.begun for vertex in record.driven()),
                tuple(vertex for record in self.chain if not record.ended for vertex in record.ahead()),
            )
        return self._paths

    def of_sample(self, sample_id: str) -> tuple[RoundRecord, int] | None:
        """The version of the round that the sample belongs to, and its index in it; None for one never asked for."""
        return self._of_sample.get(sample_id)

    def goes_on_after(self, record: RoundRecord) -> bool:
        """Whether the rover is known to have begun something after that round, or never to have got to it."""
        if record not in self.chain:
            return True
        return any(later.begun for later in self.chain[self.chain.index(record) + 1 :])

    def version(self, number: int, revision: int) -> RoundRecord | None:
        """The version of that round which a rover with that plan revision on board executes."""
        known = [record for record in self._versions if record.number == number and record.introduced <= revision]
        return max(known, key=lambda record: record.introduced) if known else None

    def drop(self, records: Iterable[RoundRecord]) -> None:
        """Take rounds out of the chain; their samples count if they come nevertheless."""
        dropped = {id(record) for record in records}
        self.chain = [record for record in self.chain if id(record) not in dropped]

    def begin(self, record: RoundRecord) -> bool:
        """The rover has begun that round. True if that version had been replaced: the chain then ends with it.

        Of two versions that were both begun the rover gave up the older one.
        """
        record.begun = True
        if record in self.chain:
            for earlier in self.chain[: self.chain.index(record)]:
                earlier.begun = True
            return False
        order = (record.number, record.introduced)
        before = [other for other in self.chain if (other.number, other.introduced) < order]
        if any(later.begun for later in self.chain[len(before) :]):
            return False  # the rover is past it; only its samples may still arrive
        if before and before[-1].number == record.number:
            if before[-1].begun:
                before[-1].ended = before[-1].ended_early = True
            else:
                before.pop()
        self.chain = [*before, record]
        return True

    # --- checkpoints ------------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """All of it, as named parts; the chain as places in the list of all versions."""
        place = {id(record): number for number, record in enumerate(self._versions)}
        return {
            "versions": [record.checkpoint() for record in self._versions],
            "chain": [place[id(record)] for record in self.chain],
            "paths_of": self._paths_of,
            "paths": self._paths,
        }

    def restore(self, state: SavedState) -> None:
        """Become the round log that had this state."""
        self._versions = [RoundRecord(**record) for record in state["versions"]]
        self.chain = [self._versions[number] for number in state["chain"]]
        self._paths_of, self._paths = state["paths_of"], state["paths"]
        self._of_sample = {}
        for record in self._versions:
            self._number_samples(record)

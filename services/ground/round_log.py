"""The round log: every round that was sent to the rover, with its known state of execution.

It knows which samples are measured, skipped or still to come, and keeps the versions of rounds that were replaced: the
rover may have begun one of them before it received the replacement.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from typing import TYPE_CHECKING

from services.ground.budget import Committed
from services.ground.round_record import RoundRecord

if TYPE_CHECKING:
    from he3.frames import Place
    from schemas.plans import PlannedSample, RoundPlan, Waypoint
    from services.runtime.node import SavedState


class RoundLog:
    """The chain of rounds that is in force, and every version that was ever sent."""

    def __init__(self) -> None:
        self.chain: list[RoundRecord] = []
        self._versions: list[RoundRecord] = []
        self._paths_of: object = None
        self._paths_at: tuple[object, int, int] | None = None
        self._paths: tuple[tuple[Waypoint, ...], tuple[Waypoint, ...]] = ((), ())
        self._of_sample: dict[str, tuple[RoundRecord, int]] = {}

    def append(self, plan: RoundPlan, revision: int) -> RoundRecord:
        """Append a round to the chain, first sent with that revision."""
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
        return [record for record in self.chain if not record.all_settled and record.pending]

    @property
    def not_begun(self) -> list[RoundRecord]:
        """Rounds at the end of the chain that the rover is not known to have begun."""
        first = len(self.chain)
        while first > 0 and not self.chain[first - 1].begun:
            first -= 1
        return self.chain[first:]

    @property
    def executing(self) -> RoundRecord | None:
        """The round that the rover executes, by the ground's knowledge; None if it executes none."""
        begun = next((record for record in reversed(self.chain) if record.begun), None)
        return None if begun is None or begun.ended else begun

    @property
    def pending(self) -> list[PlannedSample]:
        """Samples of the chain that are still to come."""
        return [planned for record in self.chain for planned in record.pending]

    @property
    def completed(self) -> int:
        """Number of rounds that have begun and of which no sample is still to come."""
        return sum([record.begun and (record.all_settled or not record.pending) for record in self.chain])

    @property
    def fruitless(self) -> int:
        """Number of consecutive finished rounds, up to the last one, that returned no sample."""
        over = [record for record in self.chain if record.begun and record.closed]
        return next((n for n, record in enumerate(reversed(over)) if record.arrived), len(over))

    def committed(self) -> Committed:
        """Metres and samples that the rounds of the chain will still take."""
        metres = sum(record.to_drive_m for record in self.chain)
        return Committed(metres, len(self.pending), len(self.open_rounds))

    def note_place(self, place_m: Place) -> None:
        """Note a place of the rover, which shows its progress in the present round."""
        if (executing := self.executing) is not None:
            executing.note_place(place_m)

    def paths(self) -> tuple[tuple[Waypoint, ...], tuple[Waypoint, ...]]:
        """The path driven so far, joined over the rounds, and the planned path beyond it.

        The same objects as before as long as neither has changed.
        """
        at = (self.chain, sum([record.changes for record in self.chain]), len(self.chain))
        if self._paths_at is not None and at[0] is self._paths_at[0] and at[1:] == self._paths_at[1:]:
            return self._paths
        self._paths_at = at
        key = tuple((record.introduced, record.begun, record.ended, record.reached_m) for record in self.chain)
        if key != self._paths_of:
            self._paths_of = key
            self._paths = (
                tuple(chain.from_iterable(record.driven() for record in self.chain if record.begun)),
                tuple(chain.from_iterable(record.ahead() for record in self.chain if not record.ended)),
            )
        return self._paths

    def of_sample(self, sample_id: str) -> tuple[RoundRecord, int] | None:
        """The version of the round that the sample belongs to, and its index in it; None for one never asked for."""
        return self._of_sample.get(sample_id)

    def goes_on_after(self, record: RoundRecord) -> bool:
        """Whether the rover has begun a later round, or is known never to execute that round."""
        if record not in self.chain:
            return True
        return any(later.begun for later in self.chain[self.chain.index(record) + 1 :])

    def version(self, number: int, revision: int) -> RoundRecord | None:
        """The version of that round which a rover with that plan revision on board executes."""
        known = [record for record in self._versions if record.number == number and record.introduced <= revision]
        return max(known, key=lambda record: record.introduced) if known else None

    def drop(self, records: Iterable[RoundRecord]) -> None:
        """Remove rounds from the chain; their samples still count if they arrive."""
        dropped = {id(record) for record in records}
        self.chain = [record for record in self.chain if id(record) not in dropped]

    def begin(self, record: RoundRecord) -> bool:
        """Note that a round has begun; returns whether that version had been replaced. The chain then ends with it.

        If two versions of a round have begun, the rover gave up the older one.
        """
        record.begin()
        if record in self.chain:
            for earlier in self.chain[: self.chain.index(record)]:
                earlier.begin()
            return False
        order = (record.number, record.introduced)
        before = [other for other in self.chain if (other.number, other.introduced) < order]
        if any(later.begun for later in self.chain[len(before) :]):
            return False  # the rover is past it; only its samples may still arrive
        if before and before[-1].number == record.number:
            if before[-1].begun:
                before[-1].give_up()
            else:
                before.pop()
        self.chain = [*before, record]
        return True

    # --- checkpoints ------------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts; the chain as indices into the list of all versions."""
        place = {id(record): number for number, record in enumerate(self._versions)}
        return {
            "versions": [record.checkpoint() for record in self._versions],
            "chain": [place[id(record)] for record in self.chain],
            "paths_of": self._paths_of,
            "paths": self._paths,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the round log from this state."""
        self._versions = [RoundRecord(**record) for record in state["versions"]]
        self.chain = [self._versions[number] for number in state["chain"]]
        self._paths_of, self._paths, self._paths_at = state["paths_of"], state["paths"], None
        self._of_sample = {}
        for record in self._versions:
            self._number_samples(record)

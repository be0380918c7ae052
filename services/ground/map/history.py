"""Earlier maps: which ones are kept, and which one `as_of` names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np

from he3.errors import InvalidInput
from services.mission.mission_time import SECOND, MissionTime, iso

if TYPE_CHECKING:
    from services.ground.map.snapshot import MapSnapshot

MAX_BYTES = 256 * 1024 * 1024
"""Size of the arrays that are kept. Above it, every second revision of the older half is dropped."""
MIN_HELD = 4

MAX_REVISION = 10**12
"""A larger number is a time [ns]: this one is 17 minutes after the beginning of 1970."""


def with_history(shown: MapSnapshot, before: MapSnapshot | None) -> MapSnapshot:
    """The new snapshot with its history: that of the last snapshot, and the last one itself if the map has changed."""
    if before is None:
        return shown
    # Equal parts are held once.
    if np.array_equal(shown.traversable, before.traversable):
        shown = replace(shown, traversable=before.traversable)
    known = len(before.samples)
    if shown.samples[:known] == before.samples:
        shown = replace(shown, samples=(*before.samples, *shown.samples[known:]))
    held = before.earlier
    if before.revision != shown.revision:
        held = _thinned((*held, replace(before, earlier=())))
    return replace(shown, earlier=held)


def _thinned(held: tuple[MapSnapshot, ...]) -> tuple[MapSnapshot, ...]:
    last = held[-1]
    each = last.mean_ppb.nbytes + last.std_ppb.nbytes + (0 if last.intervals is None else last.intervals.nbytes)
    if len(held) <= max(MIN_HELD, MAX_BYTES // each):
        return held
    half = len(held) // 2
    return (*held[:half:2], *held[half:])


def revisions(snapshot: MapSnapshot) -> tuple[MapSnapshot, ...]:
    """Every revision that is kept, oldest first; the last is the present map."""
    return (*snapshot.earlier, snapshot)


def as_of(snapshot: MapSnapshot, when: str | None) -> MapSnapshot:
    """The last revision that is held and not later than `when` (see schemas.maps.AsOf); None means now.

    Raises InvalidInput when everything that is held is later.
    """
    return revision_at(revisions(snapshot), when)


class Revision(Protocol):
    """A revision of the map, or what tells of one."""

    @property
    def revision(self) -> int: ...

    @property
    def mission_time_ns(self) -> MissionTime: ...


Held = TypeVar("Held", bound=Revision)


def revision_at(held: Sequence[Held], when: str | None) -> Held:
    """The last of those revisions, oldest first, that is not later than `when`; None means the last of all.

    Raises InvalidInput when all of them are later.
    """
    if when is None:
        return held[-1]
    number = int(when) if when.isdigit() else None
    if number is not None and number < MAX_REVISION:
        found = [each for each in held if each.revision <= number]
        if not found:
            raise InvalidInput(f"as_of: expected a revision of {held[0].revision} to {held[-1].revision}, got {when}")
        return found[-1]
    time = _mission_time(when) if number is None else number
    found = [each for each in held if each.mission_time_ns <= time]
    if not found:
        raise InvalidInput(
            f"as_of: expected a mission time from {iso(held[0].mission_time_ns)} on, got {when}: no map is held of it"
        )
    return found[-1]


def _mission_time(when: str) -> MissionTime:
    text = when.removesuffix("Z")
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.fromisoformat(whole).replace(tzinfo=UTC)
    except ValueError:
        raise InvalidInput(f"as_of: expected a revision or a time such as 2030-01-01T06:00:00Z, got '{when}'") from None
    return int(moment.timestamp()) * SECOND + int((fraction + "000000000")[:9])

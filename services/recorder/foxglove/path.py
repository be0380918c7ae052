"""The driven path as reports of the rover tell it, in the order in which they were made, however late they come."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from he3.frames import Place
    from services.mission.mission_time import MissionTime

SAME_PLACE_M: Final = 0.01  # m, of two reports: the rover stands
STRAIGHT_M: Final = 0.001  # m, by which a report may lie beside the line from the one before to the one after
MIN_NEW, MAX_NEW = 32, 256  # reports beyond which the path is published as a whole again: a share of all of them,
NEW_SHARE: Final = 32  # one in so many, so that a file does not grow with the square of the path


class DrivenPath:
    """The places that the rover reported, and which of them are published already."""

    def __init__(self) -> None:
        self._times: list[MissionTime] = []
        self._places: list[Place] = []
        self._published = 0
        self._whole: list[Place] = []  # the corners of what is published

    def add(self, at: MissionTime, place_m: Place) -> None:
        """Take in that the rover was at a place at that time."""
        position = bisect_right(self._times, at)
        if position < self._published:
            self._published, self._whole = 0, []  # a report that came very late: the path is another
        elif position == len(self._places) > 1 and all(_same(each, place_m) for each in self._places[-2:]):
            self._times[-1] = at  # it still stands there
            return
        self._times.insert(position, at)
        self._places.insert(position, place_m)

    @property
    def is_empty(self) -> bool:
        """Whether no place was reported yet."""
        return not self._places

    @property
    def corners(self) -> Sequence[Place]:
        """The corners of the whole path."""
        return _extended([], self._places)

    @property
    def new(self) -> Sequence[Place]:
        """The corners of the path since it was last published, from the last place that was."""
        return _extended([], self._places[max(0, self._published - 1) :])

    def whole(self) -> Sequence[Place] | None:
        """All corners, if it is time to publish the whole path again; else None."""
        new = len(self._places) - self._published
        if self._published > 0 and new <= min(MAX_NEW, max(MIN_NEW, len(self._places) // NEW_SHARE)):
            return None
        self._whole = _extended(self._whole, self._places[self._published :])
        self._published = len(self._places)
        return self._whole if len(self._whole) > 1 else None


def _extended(corners: list[Place], places_m: Iterable[Place]) -> list[Place]:
    """Those corners and the places, without those at which the rover stood before, or on a line between neighbours."""
    kept = corners.copy()
    for place in places_m:
        if kept and _same(kept[-1], place):
            continue
        if len(kept) > 1 and _straight(kept[-2], kept[-1], place):
            kept[-1] = place
        else:
            kept.append(place)
    return kept


def _same(one: Place, other: Place) -> bool:
    return math.dist(one, other) < SAME_PLACE_M


def _straight(first: Place, middle: Place, last: Place) -> bool:
    """Whether the middle place lies on the line between the others."""
    length = math.dist(first, last)
    if length < SAME_PLACE_M:
        return False
    east, north = (last[0] - first[0]) / length, (last[1] - first[1]) / length
    dx, dy = middle[0] - first[0], middle[1] - first[1]
    return abs(east * dy - north * dx) < STRAIGHT_M and 0.0 <= east * dx + north * dy <= length

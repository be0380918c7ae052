"""A recording in memory: every message that a session on Earth heard, in the order of reception."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from he3.errors import InvalidInput
from schemas.roles import Role
from schemas.topics import EARTH_CLOCK, GROUND_STATUS, LINK_STATUS, MAP_OVERVIEW, Topic
from services.console.report.verification import Evidence

if TYPE_CHECKING:
    from pathlib import Path

    from schemas.ground import MapOverview
    from schemas.maps import MapScore
    from schemas.wire import Header
    from services.mission.mission_time import MissionTime
    from services.recorder.reader import Recorded

GROUND: Final = Role.GROUND.value


@dataclass(frozen=True, slots=True)
class Heard:
    """One message, and when it was received on Earth."""

    topic: Topic
    header: Header
    body: Any
    at: MissionTime


class Tape:
    """The messages of a recording, and what they say of the map's revisions."""

    def __init__(self, path: Path) -> None:
        """Raises InvalidInput, in one line, for a file that is no recording of a mission."""
        self.messages: list[Heard] = []
        """In the order of reception."""
        self.times: list[MissionTime] = []
        """When each of them was received; ascending."""
        self.overviews: list[Heard] = []
        """The first overview of each revision of the map."""
        self.scores: dict[int, MapScore] = {}
        """The score of each revision that has one."""
        self.mean_std_ppb: dict[int, float] = {}
        """Mean over the cells of the standard deviation of each revision."""
        self._by_ground: list[int] = []
        self._by_topic: dict[Topic, list[Heard]] = {}
        self._start_ns: MissionTime | None = None
        self.mission = ""
        self.evidence = Evidence(path, keep=self._keep)
        self.path = path
        if not self.messages:
            raise InvalidInput(f"{path}: expected a recording with messages, got none")

    @property
    def start_ns(self) -> MissionTime:
        """When the mission began."""
        if self._start_ns is not None:
            return self._start_ns
        scenario = self.evidence.scenario
        return self.times[0] if scenario is None else scenario.start_ns

    @property
    def end_ns(self) -> MissionTime:
        """When the last message was received."""
        return self.times[-1]

    def heard_by(self, at: MissionTime) -> int:
        """How many messages were received by that time."""
        return bisect_right(self.times, at)

    def told_by_ground(self, at: MissionTime) -> int:
        """How many messages were received up to the ground's last one by that time: the ground knew these at least.

        It says something with every report that it takes in, so what came later came while it did not run.
        """
        position = bisect_left(self._by_ground, self.heard_by(at))
        return self._by_ground[position - 1] + 1 if position else 0

    def of(self, topic: Topic, at: MissionTime) -> Sequence[Heard]:
        """The messages of that topic that were received by that time, in the order of reception."""
        found = self._by_topic.get(topic, [])
        return found[: bisect_right(found, at, key=lambda each: each.at)]

    def revisions_by(self, at: MissionTime) -> Sequence[Heard]:
        """The overviews that were received by that time, oldest first."""
        return self.overviews[: bisect_right(self.overviews, at, key=lambda each: each.at)]

    def _keep(self, message: Recorded) -> None:
        body = message.body
        at = max(message.received_at, self.times[-1]) if self.times else message.received_at
        if message.topic is LINK_STATUS:
            # They are most of a recording's bytes, and no display of the link shows them.
            body = body.model_copy(update={"dropped": ()})
        elif message.topic is EARTH_CLOCK:
            self._start_ns = body.start_ns
        elif message.topic is GROUND_STATUS:
            if body.score is not None:
                self.scores.setdefault(body.map_revision, body.score)
            if body.mean_std_ppb is not None:
                self.mean_std_ppb.setdefault(body.map_revision, body.mean_std_ppb)
        self.mission = message.header.mission
        if message.header.source == GROUND:
            self._by_ground.append(len(self.messages))
        heard = Heard(message.topic, message.header, body, at)
        self.messages.append(heard)
        self._by_topic.setdefault(message.topic, []).append(heard)
        self.times.append(at)
        if message.topic is MAP_OVERVIEW and _is_new(body, self.overviews):
            self.overviews.append(heard)


def _is_new(overview: MapOverview, known: Sequence[Heard]) -> bool:
    return not known or overview.revision > known[-1].body.revision

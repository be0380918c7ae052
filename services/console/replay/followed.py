"""The ground's account of the rover's way, followed again through the messages of a recording.

It is made of the ground's own parts: custody brings the reports into their order, the round log and the monitor of the
execution take them in, and the terrain closes where the rover met an obstacle. What the ground decided is taken from
what it sent: its plans, and the keep-outs of its overviews.
"""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from schemas.commands import CommandKind
from schemas.telemetry import EventKind
from schemas.topics import COMMAND_STATUS, EVENT, INTERESTS, MAP_OVERVIEW, PLAN, SAMPLE, STATE
from services.ground.execution import ExecutionMonitor
from services.ground.round_log import RoundLog
from services.ground.samples import SampleIntake
from services.ground.terrain import leads_through
from services.runtime.custody.receiver import CustodyReceiver

if TYPE_CHECKING:
    from collections.abc import Callable

    from schemas.ground import KeepOutArea, MapOverview
    from schemas.plans import MissionPlan, Waypoint
    from services.console.replay.tape import Heard, Tape
    from services.ground.belief import Belief
    from services.ground.execution import Outcome
    from services.ground.terrain import GroundTerrain
    from services.mission.mission_time import MissionTime

EXCURSIONS: Final = (CommandKind.GO_TO, CommandKind.RETURN_TO_START)

Paths = tuple[tuple["Waypoint", ...], tuple["Waypoint", ...]]


class FollowedGround:
    """Driven and planned path, and the terrain, at any time of a recording; quickest when time goes forward."""

    def __init__(self, tape: Tape, terrain: Callable[[], GroundTerrain]) -> None:
        """terrain: makes the terrain as it was when the mission began."""
        self._tape = tape
        self._terrain_at_first = terrain
        self._next = 0
        self._begin()

    def _begin(self) -> None:
        scenario = self._tape.evidence.scenario
        self.terrain = self._terrain_at_first()
        self._custody = CustodyReceiver()
        self._log = RoundLog()
        samples = SampleIntake(cast("Belief", _Counted()), self._log)
        start_m = (0.0, 0.0) if scenario is None else scenario.start_m
        self._monitor = ExecutionMonitor(self.terrain, self._log, samples, start_m)
        self._revision = 0
        self._keep_outs: tuple[KeepOutArea, ...] | None = None
        self._next = 0

    def paths(self, count: int) -> Paths:
        """The driven and the planned path after the first `count` messages of the recording."""
        self.follow(count)
        return self._log.paths()

    def follow(self, count: int) -> None:
        """Take in the first `count` messages of the recording, and no more."""
        if count < self._next:
            self._begin()
        for heard in self._tape.messages[self._next : count]:
            self._take(heard)
        self._next = count

    def _take(self, heard: Heard) -> None:
        topic, body = heard.topic, heard.body
        if topic is SAMPLE or topic is EVENT:
            ready, _ = self._custody.received(topic, heard.header, body, 0, heard.at)
            for delivery in ready:
                self._deliver(delivery.topic, delivery.body)
        elif topic is STATE:
            self._located(body, heard.header.made_at)
        elif topic is PLAN:
            self._planned(body)
        elif topic is MAP_OVERVIEW:
            self._closed(body)
        elif topic is INTERESTS or (topic is COMMAND_STATUS and body.command.kind in EXCURSIONS and body.end):
            self._log.drop(self._log.not_begun)

    def _deliver(self, topic: object, body: Any) -> None:
        if topic is SAMPLE:
            self._outcome(self._monitor.sample(body))
            return
        if self._monitor.objection(body) is not None:
            return
        self._monitor.heard((body.x_m, body.y_m), body.driven_m, body.at)
        if body.kind is EventKind.PLAN_REJECTED and body.plan_revision >= self._revision:
            self._log.drop(self._log.not_begun)
        elif body.kind not in (EventKind.PLAN_ACCEPTED, EventKind.MISSION_COMPLETED):
            self._outcome(self._monitor.event(body, self._revision))

    def _outcome(self, outcome: Outcome) -> None:
        if outcome.take_back:
            self._log.drop(self._log.not_begun)

    def _located(self, state: Any, made_at: MissionTime) -> None:
        on_site = self.terrain.grid.contains(np.array([(state.x_m, state.y_m)]))[0]
        if on_site and self._monitor.heard((state.x_m, state.y_m), state.driven_m, made_at):
            self._log.drop(self._monitor.rounds_dropped(state, self._revision))

    def _planned(self, plan: MissionPlan) -> None:
        """The rounds that have not begun are those of the plan: those known already, and new ones."""
        if plan.revision <= self._revision:
            return  # a repetition
        self._revision = plan.revision
        known = {record.number: record for record in self._log.not_begun if record.plan in plan.rounds}
        self._log.drop([record for record in self._log.not_begun if known.get(record.number) is not record])
        for planned in plan.rounds:
            if planned.round not in known:
                self._log.append(planned, plan.revision)

    def _closed(self, overview: MapOverview) -> None:
        """The keep-outs are those of the overview; rounds that lead through a new one are planned anew."""
        if overview.keep_outs == self._keep_outs:
            return
        self._keep_outs = overview.keep_outs
        areas = {
            area_id: [area.polygon_m for area in group]
            for area_id, group in groupby(overview.keep_outs, key=attrgetter("area_id"))
        }
        for area_id in {*self.terrain.areas, *areas}:
            if self.terrain.set_keep_out(area_id, areas.get(area_id, ())):
                area, waiting = self.terrain.areas[area_id], self._log.not_begun
                refuted = (each for each in waiting if leads_through(self.terrain.grid, each.plan.path_m, area))
                if (first := next(refuted, None)) is not None:
                    self._log.drop([record for record in waiting if record.number >= first.number])


class _Counted:
    """A belief that only knows which samples it has: the map itself is rebuilt elsewhere."""

    def __init__(self) -> None:
        self._names: set[str] = set()

    def __contains__(self, sample_id: object) -> bool:
        return sample_id in self._names

    def add(self, sample_id: str, _observation: object) -> bool:
        self._names.add(sample_id)
        return True

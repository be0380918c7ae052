"""A copy of the mission for rehearsals: the ground's state, and what the rover has still to do by its knowledge."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any

from schemas.fork import MissionFork
from schemas.plans import MissionPlan
from services.runtime.state_codec import StateCodec

if TYPE_CHECKING:
    from schemas.plans import RoundPlan
    from schemas.telemetry import RoverState
    from services.ground.execution import ExecutionMonitor
    from services.ground.planning import RoundPlanning
    from services.ground.round_log import RoundLog
    from services.ground.round_record import RoundRecord
    from services.ground.terrain import GroundTerrain
    from services.mission.mission_time import MissionTime
    from services.mission.scenario import Scenario
    from services.runtime.node import SavedState

UNNEEDED = frozenset({"publisher"})
"""Parts of the state that a rehearsal begins anew."""


class Forking:
    """Makes copies of the mission; the mission does not change."""

    def __init__(
        self,
        scenario: Scenario,
        terrain: GroundTerrain,
        round_log: RoundLog,
        execution: ExecutionMonitor,
        planning: RoundPlanning,
        types: tuple[type, ...],
    ) -> None:
        """types: those in the state, beside plain values."""
        self._scenario = scenario
        self._terrain = terrain
        self._round_log = round_log
        self._execution = execution
        self._planning = planning
        self._types = types

    def fork(self, state: SavedState, rover: RoverState | None, now: MissionTime) -> MissionFork:
        """The mission as it is now. state: the node's checkpoint; rover: its newest state."""
        kept: dict[str, Any] = {name: part for name, part in state.items() if name not in UNNEEDED}
        director = kept["director"]
        belief = {**director["belief"], "map": None}
        planning = {**director["planning"], "task": None, "proposed": None}
        refits = {**director["refits"], "job": None}
        kept["director"] = {**director, "belief": belief, "planning": planning, "refits": refits}
        measured = tuple(director["belief"]["observations"])
        encoded = StateCodec(self._types).encode({**kept, "begun": False})
        return MissionFork(
            at=now,
            scenario_json=self._scenario.model_dump_json(),
            state_base64=base64.b64encode(encoded).decode(),
            rover=rover,
            plan=self._still_to_do(len(measured), now),
            measured=measured,
            keep_outs_m={area_id: outlines[-1] for area_id, outlines in self._terrain.outlines.items() if outlines},
        )

    def _still_to_do(self, known: int, now: MissionTime) -> MissionPlan | None:
        """The rounds that are not over; known: samples in the map."""
        executing = self._round_log.executing
        begun = [] if executing is None or executing.closed else [self._rest_of(executing)]
        rounds = (*begun, *(record.plan for record in self._round_log.not_begun))
        if not rounds:
            return None
        last = known + len(self._round_log.pending) >= self._scenario.samples
        return MissionPlan(
            revision=max(1, self._planning.revision), rounds=rounds, last=last, samples_known=known, planned_at=now
        )

    def _rest_of(self, record: RoundRecord) -> RoundPlan:
        """What is left of a round under way, from where the rover was last heard of."""
        path_m = (self._execution.place_m, *record.ahead()[1:])
        return record.plan.model_copy(update={"path_m": path_m, "samples": tuple(record.pending)})

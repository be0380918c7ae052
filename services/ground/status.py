"""The ground's status, as operators see it."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from schemas.ground import CostTally, GoalStatus, GroundStatus, MissionPhase
from schemas.topics import GROUND_STATUS
from services.ground.map.overview import kernel_parameters
from services.runtime.node import SendIfHeard

if TYPE_CHECKING:
    from he3.driving_cost import CostUnit
    from he3.hyperparameters import Hyperparameters
    from schemas.telemetry import RoverState
    from services.ground.belief import Belief
    from services.ground.director import Director, MissionProgress
    from services.ground.goal import MissionGoal
    from services.ground.map.publisher import MapPublisher
    from services.ground.silence import SilenceWatch
    from services.mission.mission_time import MissionTime
    from services.mission.scenario import Scenario
    from services.runtime.node import SavedState


class _Facts(NamedTuple):
    """What the status says, apart from what never changes and what follows from the map's revision.

    What changes most often comes first.
    """

    rover_made_at: MissionTime | None
    rounds_completed: int
    samples: int
    driven_m: float
    spent: float
    plan_revision: int
    planning: bool
    map_revision: int
    phase: MissionPhase
    detail: str
    proposal: int | None
    rover: RoverState | None
    goal: GoalStatus | None
    hyperparameters: Hyperparameters


class StatusReporter:
    """Sends the status whenever it has changed, and once per period."""

    def __init__(
        self,
        scenario: Scenario,
        belief: Belief,
        director: Director,
        publisher: MapPublisher,
        silence: SilenceWatch,
        note: str = "",
        unit: CostUnit | None = None,
        goal: MissionGoal | None = None,
    ) -> None:
        """note: what the operator sees during the whole mission, behind what is new. unit: of the mission's cost."""
        self._scenario = scenario
        self._belief = belief
        self._director = director
        self._publisher = publisher
        self._silence = silence
        self._note = note
        self._unit = unit
        self._goal = goal
        self._rover: RoverState | None = None
        self._rover_made_at: MissionTime | None = None
        self._sent: _Facts | None = None

    @property
    def rover(self) -> RoverState | None:
        """The rover's newest state; None if there is none."""
        return self._rover

    def is_newer(self, made_at: MissionTime) -> bool:
        """Whether a state of the rover that was made at that time is newer than the newest so far."""
        return self._rover_made_at is None or made_at > self._rover_made_at

    def heard(self, state: RoverState, made_at: MissionTime) -> None:
        """Note the rover's state; an older one does not replace a newer one."""
        if self._rover_made_at is None or made_at >= self._rover_made_at:
            self._rover, self._rover_made_at = state, made_at

    @property
    def status(self) -> GroundStatus:
        """The status now."""
        return self._status(self._facts())

    def send(self, anyway: bool) -> Iterable[SendIfHeard]:
        """The status if it has changed; with `anyway`, also if it has not."""
        facts = self._facts()
        if anyway or facts != self._sent:
            self._sent = facts
            yield SendIfHeard(GROUND_STATUS, partial(self._status, facts))

    def _facts(self) -> _Facts:
        progress = self._director.progress()
        return _Facts(
            rover_made_at=self._rover_made_at,
            rounds_completed=progress.rounds_completed,
            samples=progress.samples,
            driven_m=progress.driven_m,
            spent=progress.spent,
            plan_revision=progress.plan_revision,
            planning=progress.planning,
            map_revision=self._publisher.revision,
            phase=self._phase(progress),
            detail=self._detail(progress)[:500],
            proposal=None if progress.proposed is None else progress.proposed.number,
            rover=self._rover,
            goal=None if self._goal is None else self._goal.status(),
            hyperparameters=self._belief.hyperparameters,
        )

    def _status(self, facts: _Facts) -> GroundStatus:
        return GroundStatus(
            phase=facts.phase,
            planner=self._scenario.ground.planner,
            round=facts.rounds_completed,
            rounds=max(self._scenario.rounds, facts.rounds_completed),  # more make up for samples that were skipped
            samples=facts.samples,
            samples_total=self._scenario.samples,
            driven_m=facts.driven_m,
            budget_m=self._scenario.ground.budget_m,
            cost=self._cost(facts.spent),
            plan_revision=facts.plan_revision,
            plans_in_work=int(facts.planning),
            map_revision=facts.map_revision,
            mean_std_ppb=self._publisher.mean_std_ppb,
            kernel=kernel_parameters(facts.hyperparameters),
            score=self._publisher.score,
            rover=facts.rover,
            rover_made_at=facts.rover_made_at,
            goal=facts.goal,
            detail=facts.detail,
            proposal=facts.proposal,
        )

    def _cost(self, spent: float) -> CostTally | None:
        """What driving has cost; None where the cost is the distance."""
        unit = self._unit
        if unit is None or unit.kind == "distance":
            return None
        return CostTally(kind=unit.kind, unit=unit.unit, spent=spent, budget=self._scenario.ground.budget_wh)

    def _phase(self, progress: MissionProgress) -> MissionPhase:
        if progress.ended is not None:
            return MissionPhase.COMPLETED if progress.ended.ok else MissionPhase.FAILED
        if not self._silence.ever_heard:
            return MissionPhase.WAITING
        return MissionPhase.EXECUTING if progress.executing else MissionPhase.PLANNING

    def _detail(self, progress: MissionProgress) -> str:
        details = ["the rover is silent"] if self._silence.silent and progress.ended is None else []
        if progress.proposed is not None:
            details.append(f"the plan of round {progress.proposed.task.number} waits for approval")
        detail = "; ".join(filter(None, (progress.detail, self._note)))
        return "; ".join((*details, detail) if detail else details)

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "rover": self._rover,
            "rover_made_at": self._rover_made_at,
            "sent": None if self._sent is None else tuple(self._sent),
        }

    def restore(self, state: SavedState) -> None:
        """Restore the reporter from this state."""
        self._rover = state["rover"]
        self._rover_made_at = state["rover_made_at"]
        self._sent = None if state["sent"] is None else _Facts(*state["sent"])

"""The director decides what is fitted, planned and sent next, and when the mission is over.

With pipeline = h, 1 + h rounds are planned that are not over: one being executed and h on board behind it. A round is
planned from where the rover will be when it begins, with the places of the measurements that are still under way
counted in; the plan names them. With h = 0 the rover waits for each round until the samples of the last are in the map.

The director itself has little state: belief, terrain, round log, budget and its other parts have the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

from he3.errors import NoRoute
from schemas.plans import MissionPlan
from schemas.telemetry import EventKind, RoverEvent, RoverState, SampleReport
from schemas.topics import PLAN
from services.ground.excursions import Excursions
from services.ground.fitting import fit
from services.ground.mission_end import MissionEnd
from services.ground.recall import RoundRecall
from services.ground.rejections import PlanRejections
from services.ground.terrain import GroundTerrain, leads_through
from services.mission.mission_time import MissionTime, seconds
from services.runtime.node import Effect, Finish, Level, LogRecord, Send, SetTimer

if TYPE_CHECKING:
    from he3.frames import Place
    from schemas.ground import InterestChange
    from schemas.plans import RoundPlan
    from services.ground.belief import Belief
    from services.ground.budget import Budget, RemainingBudget
    from services.ground.driving_costs import DrivingCosts
    from services.ground.execution import ExecutionMonitor, Outcome
    from services.ground.goal import MissionGoal
    from services.ground.interests import InterestAreas
    from services.ground.planners.interface import PlannedRound
    from services.ground.planning import RoundPlanning
    from services.ground.refits import RefitSchedule
    from services.ground.round_log import RoundLog
    from services.ground.round_plans import PlanningTask, ProposedRound
    from services.ground.round_record import RoundRecord
    from services.mission.scenario import Scenario
    from services.runtime.node import SavedState, Stateful

MAX_FRUITLESS = 40  # rounds in a row from which no sample came
MAX_ROUNDS = 9_000  # in all; a plan can number 10,000
REPLAN_TIMER = "replan"


@dataclass(frozen=True, slots=True)
class MissionProgress:
    """The progress of the mission, as it is reported."""

    rounds_completed: int
    samples: int
    """Samples in the map."""
    driven_m: float
    spent: float
    """What driving has cost, in the unit of `ground.cost`."""
    plan_revision: int
    planning: bool
    """Whether a round is being planned, or waits for approval."""
    proposed: ProposedRound | None
    """The round that waits for the operator's approval."""
    executing: bool
    """Whether samples of a round that was sent are still to come."""
    detail: str
    """A note for the operator; may be empty."""
    ended: Finish | None


class Director:
    """The mission's state machine: it changes on events alone."""

    def __init__(
        self,
        scenario: Scenario,
        belief: Belief,
        terrain: GroundTerrain,
        round_log: RoundLog,
        execution: ExecutionMonitor,
        refits: RefitSchedule,
        planning: RoundPlanning,
        budget: Budget,
        costs: DrivingCosts,
        interests: InterestAreas,
        goal: MissionGoal,
    ) -> None:
        self._scenario = scenario
        self._belief = belief
        self._terrain = terrain
        self._round_log = round_log
        self._execution = execution
        self._refits = refits
        self._planning = planning
        self._budget = budget
        self._costs = costs
        self._interests = interests
        self._excursions = Excursions()
        self._rejections = PlanRejections()
        self._end = MissionEnd()
        self._goal = goal
        self.recall = RoundRecall()
        self._next_start_m: Place | None = scenario.start_m
        """Where the next round begins; None: at the end of the chain."""
        self._stateful: dict[str, Stateful] = {
            "belief": belief,
            "terrain": terrain,
            "round_log": round_log,
            "execution": execution,
            "refits": refits,
            "planning": planning,
            "budget": budget,
            "interests": interests,
            "goal": goal,
            "excursions": self._excursions,
            "rejections": self._rejections,
            "end": self._end,
            "recall": self.recall,
        }
        """The parts of which the director is made, each with a state of its own."""

    # --- what is reported -------------------------------------------------------------------------------------------

    @property
    def ended(self) -> bool:
        """Whether the mission is over."""
        return self._end.finish is not None

    @property
    def computing(self) -> bool:
        """Whether a fit or a plan is being computed."""
        return self._refits.busy or self._planning.busy

    def progress(self) -> MissionProgress:
        """The progress of the mission."""
        finish = self._end.finish
        return MissionProgress(
            rounds_completed=self._round_log.completed,
            samples=len(self._belief),
            driven_m=self._execution.driven_m,
            spent=self._costs.spent(self._round_log, self._execution.driven_m),
            plan_revision=self._planning.revision,
            planning=self._planning.busy,
            proposed=self._planning.proposed,
            executing=bool(self._round_log.open_rounds),
            detail=self._execution.detail if finish is None else finish.why,
            ended=finish,
        )

    def plan_ends(self, now: MissionTime) -> MissionTime | None:
        """Expected time at which the rover has done all planned rounds; None if there are none, or if it never will."""
        if not self._round_log.open_rounds:
            return None
        lasts_s = self._budget.lasts_s(self._costs.committed(self._round_log))
        return now + seconds(lasts_s) if isfinite(lasts_s) else None

    # --- events -----------------------------------------------------------------------------------------------------

    def go_on(self, now: MissionTime) -> list[Effect]:
        """Continue: the mission begins, or a wait is over."""
        return self._advance(now)

    def state(self, state: RoverState, made_at: MissionTime, now: MissionTime) -> list[Effect]:
        """Handle a report of the rover's state. If it has dropped the rounds on board, they are planned again."""
        if not self._execution.heard((state.x_m, state.y_m), state.driven_m, made_at):
            return []
        self._budget.heard(state.energy_wh)
        dropped = self._execution.rounds_dropped(state, self._planning.revision)
        if not dropped or self.ended:
            return []
        self._take_back(dropped, self._execution.place_m)
        text = f"the rover has dropped round {dropped[0].number} and later ones; planning them anew"
        return [LogRecord(Level.INFO, text), *self._advance(now)]

    def sample(self, report: SampleReport, now: MissionTime) -> list[Effect]:
        """Handle a measurement; a repeated or unplanned one changes nothing."""
        return self._follow(self._execution.sample(report), now)

    def event(self, event: RoverEvent, now: MissionTime) -> list[Effect]:
        """Handle an event of the rover; a repeated one changes nothing."""
        objection = self._execution.objection(event)
        if objection is not None:
            return [objection]
        self._execution.heard((event.x_m, event.y_m), event.driven_m, event.at)
        match event.kind:
            case EventKind.PLAN_ACCEPTED:
                self._rejections.accepted()
                return []
            case EventKind.PLAN_REJECTED:
                return self._plan_rejected(event, now)
            case EventKind.MISSION_COMPLETED:
                self._end.plan_completed(event.plan_revision)
                return self._advance(now)
            case _:
                return self._follow(self._execution.event(event, self._planning.revision), now)

    def computed(self, job: str, result: Any, error: Exception | None, now: MissionTime) -> list[Effect]:
        """Handle the result of a fit or a plan; an outdated one is dropped."""
        if self._refits.waits_for(job):
            return [*self._refits.finish(result, error), *self._advance(now)]
        task = self._planning.answered(job)
        if task is None:
            return []
        if error is not None:
            return self._planning_failed(task, error, now)
        return self._plan_made(task, result, now)

    def keep_out(self, area_id: str, polygons_m: Iterable[Sequence[Place]], now: MissionTime) -> list[Effect]:
        """Close the area of these polygons. Rounds that lead through it and have not begun are planned anew."""
        if not self._terrain.set_keep_out(area_id, polygons_m):
            return self._advance(now)
        area = self._terrain.areas[area_id]
        waiting = self._round_log.not_begun
        refuted = next((r for r in waiting if leads_through(self._terrain.grid, r.plan.path_m, area)), None)
        if refuted is not None:
            self._take_back([record for record in waiting if record.number >= refuted.number])
        else:
            self._planning.cancel()  # it is being planned on terrain that no longer is
        return self._advance(now)

    def set_interest(self, change: InterestChange, now: MissionTime) -> list[Effect]:
        """Set or remove an area of interest; rounds that have not begun are planned anew."""
        if not self._interests.change(change) or self.ended:
            return []
        self._take_back(self._round_log.not_begun)
        return self._advance(now)

    def objection_to_visit(self, target_m: Place) -> str | None:
        """One line on why the rover must not be sent straight to that place; None if nothing speaks against it.

        The rover drives in a straight line, as seen from Earth from where it was last heard of.
        """
        return self._terrain.objection_to_drive(self._execution.place_m, target_m)

    def excursion_begun(self, command_id: str) -> None:
        """Note that the operator moves the rover: no round is planned until it has arrived."""
        self._excursions.begin(command_id)
        self._planning.cancel()

    def excursion_ended(self, command_id: str, place_m: Place | None, now: MissionTime) -> list[Effect]:
        """End a move at that place (None: the last known place); rounds that have not begun are planned anew."""
        if not self._excursions.end(command_id):
            return []
        if not self.ended:
            if place_m is not None:
                self._execution.sent_to(place_m)
            self._take_back(self._round_log.not_begun)
            if self._round_log.idle:
                self._next_start_m = self._execution.place_m
        return self._advance(now)

    def command_ended(self, command_id: str, carried_out: bool, now: MissionTime) -> list[Effect]:
        """Handle the end of a command: after a recall the mission may end, or another recall may be due."""
        return self._advance(now) if self.recall.ended(command_id, carried_out) else []

    def send_back(self, now: MissionTime) -> list[Effect]:
        """Plan the round again whose plan the operator does not approve."""
        self._planning.send_back()
        return self._advance(now)

    def revise_plan(self, proposed: ProposedRound, places_m: Sequence[Place], now: MissionTime) -> None:
        """Replace the proposed round by one that samples these places [m]; it waits for approval in its place.

        Raises InvalidInput, and changes nothing, for a round that cannot be driven.
        """
        self._planning.revised(proposed, places_m, self._remaining(now), now)

    # --- plans ------------------------------------------------------------------------------------------------------

    def _follow(self, outcome: Outcome, now: MissionTime) -> list[Effect]:
        """Apply the outcome of a rover's report to the plans."""
        if outcome.begun_outdated:
            self._end.plan_outdated()
            self._planning.cancel()
            self._next_start_m = None
        if outcome.take_back:
            self._take_back(self._round_log.not_begun, outcome.start_m)
        return [*outcome.notes, *(self._advance(now) if outcome.changed else [])]

    def _plan_rejected(self, event: RoverEvent, now: MissionTime) -> list[Effect]:
        if event.plan_revision < self._planning.revision or self.ended:
            return []  # a newer plan is on its way and is judged by itself
        plan_again_at = self._rejections.rejected(now)
        why = f"plan {event.plan_revision} was rejected: {event.detail or 'no reason given'}"[:400]
        self._execution.detail = why
        effects: list[Effect] = [_warning(why)]
        self._take_back(self._round_log.not_begun)
        if self._rejections.too_many:
            count = self._rejections.in_a_row
            self._end.give_up_planning(
                f"{count} plans in a row were rejected, the last: {event.detail}"[:400], failed=True
            )
        elif self._round_log.idle:
            self._next_start_m = (event.x_m, event.y_m)
        if plan_again_at is not None:
            effects.append(SetTimer(REPLAN_TIMER, plan_again_at))
        return [*effects, *self._advance(now)]

    def _take_back(self, records: Sequence[RoundRecord], start_m: Place | None = None) -> None:
        """Remove rounds that have not begun; they are planned again from that place, or from the chain's end."""
        self._round_log.drop(records)
        self._planning.take_back(records)
        self._end.reopen()
        self._next_start_m = start_m or (None if self._round_log.chain else self._execution.place_m)

    # --- what comes next --------------------------------------------------------------------------------------------

    def _advance(self, now: MissionTime) -> list[Effect]:
        """Begin what is possible now: the next refit, else the next plan, else the end of the mission."""
        if self.ended or self._refits.busy:
            return []
        fit = self._refits.next()
        if fit is not None:
            return [fit]
        if self._goal.holds():
            self._planning.cancel()
            return self._end_with_goal()
        if self._planning.busy:
            return []
        if not self._end.nothing_more_to_plan and self._samples_wanted > 0:
            enough = len(self._round_log.open_rounds) > self._scenario.ground.pipeline
            if enough or self._excursions.under_way or self._rejections.waiting(now):
                return []
            effects = self._next_plan(now)
            if effects:
                return effects
        return self._end_if_over()

    def _end_with_goal(self) -> list[Effect]:
        """End the mission, or first recall what the rover has on board, and wait for all that it has measured."""
        log = self._round_log
        recalled = log.executing or next(iter(log.not_begun), None)
        if recalled is not None and recalled.pending and self.recall.want(recalled):
            return [LogRecord(Level.INFO, f"round {recalled.number} is recalled: {self._goal.why}")]
        if log.open_rounds or self.recall.under_way:
            return []
        self._end.goal_reached(self._goal.why)
        return [LogRecord(Level.INFO, self._goal.why), self._finish()]

    @property
    def _samples_missing(self) -> int:
        """Samples of the mission that are not measured."""
        return max(0, self._scenario.samples - len(self._belief))

    @property
    def _samples_wanted(self) -> int:
        """Samples of the mission that are neither measured nor planned."""
        return max(0, self._samples_missing - len(self._round_log.pending))

    def _remaining(self, now: MissionTime) -> RemainingBudget:
        """What may be planned beside the rounds that were sent."""
        log, driven_m = self._round_log, self._execution.driven_m
        return self._budget.left(
            now, driven_m, self._costs.committed(log), self._samples_wanted, self._costs.spent(log, driven_m)
        )

    def _next_plan(self, now: MissionTime) -> list[Effect]:
        log = self._round_log
        remaining = self._remaining(now)
        why = self._why_no_more_rounds(remaining)
        if why is not None:
            self._end.give_up_planning(why)
            return []
        start = self._next_start_m or log.end_m or self._execution.place_m
        return [self._planning.start(log.next_number, start, remaining)]

    def _why_no_more_rounds(self, remaining: RemainingBudget) -> str | None:
        number, fruitless = self._round_log.next_number, self._round_log.fruitless
        if remaining.samples >= 1 and fruitless < MAX_FRUITLESS and number <= MAX_ROUNDS:
            return None
        return remaining.why or f"{fruitless} rounds in a row brought no sample, of {number - 1}"

    def _plan_made(self, task: PlanningTask, planned: PlannedRound, now: MissionTime) -> list[Effect]:
        foreseen = self._goal.planned(planned, len(self._belief))
        proposed = self._planning.propose(task, planned, now)
        if self._scenario.ground.approval == "operator":
            return [*foreseen, *self._advance(now)]
        return [*foreseen, *self.send_plan(proposed, proposed.plan, now)]

    def send_plan(self, proposed: ProposedRound, round_plan: RoundPlan, now: MissionTime) -> list[Effect]:
        """Send the proposed round, as it was or as the operator has edited it."""
        task = proposed.task
        revision = self._planning.approve(proposed)
        self._round_log.append(round_plan, revision)
        self._next_start_m = None
        last = task.samples_left <= len(round_plan.samples)
        self._end.plan_sent(last)
        plan = MissionPlan(
            revision=revision,
            rounds=tuple(record.plan for record in self._round_log.not_begun),
            last=last,
            samples_known=task.known,
            samples_pending=task.pending,
            planned_at=now,
        )
        return [Send(PLAN, plan), *self._advance(now)]

    def _planning_failed(self, task: PlanningTask, error: Exception, now: MissionTime) -> list[Effect]:
        why = f"round {task.number} could not be planned: {error}"[:400]
        if self._planning.failed(task):
            self._end.give_up_planning(why, failed=not isinstance(error, NoRoute))
        return [_warning(why), *self._advance(now)]

    def give_up(self, why: str) -> list[Effect]:
        """End the mission with the samples it has, because nothing more will arrive."""
        if self.ended:
            return []
        if self._goal.holds():
            self._end.goal_reached(f"{self._goal.why}; {why}")
        else:
            self._end.give_up_planning(why, failed=self._samples_missing > 0)
        return [self._finish()]

    def _end_if_over(self) -> list[Effect]:
        log = self._round_log
        if log.open_rounds or (log.chain and self._end.awaits_completion(log.chain[-1].introduced)):
            return []
        return [self._finish()]

    def _finish(self) -> Finish:
        return self._end.over(len(self._belief), self._scenario.samples, self._execution.detail)

    # --- checkpoints ------------------------------------------------------------------------------------------------

    @property
    def functions(self) -> dict[str, Callable[..., Any]]:
        """The functions that its computations run, by name."""
        return {"fit": fit, **self._planning.functions}

    def checkpoint(self) -> SavedState:
        """The state of each part by its name, and the director's own."""
        parts = {name: part.checkpoint() for name, part in self._stateful.items()}
        return {**parts, "next_start_m": self._next_start_m}

    def restore(self, state: SavedState) -> None:
        """Restore the director from this state."""
        for name, part in self._stateful.items():
            part.restore(state[name])
        self._next_start_m = state["next_start_m"]


def _warning(text: str) -> LogRecord:
    return LogRecord(Level.WARNING, text)

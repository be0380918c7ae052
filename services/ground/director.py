"""What the rover is to do next: rounds, budget, pipeline depth, and what becomes of plans that the Moon refutes.

With pipeline = h, 1 + h rounds are planned that are not over: one being executed and h on board behind it. A round is
planned from where the rover will be when it begins, with the places of the measurements that are still under way
counted in, which the plan says. With h = 0 the rover waits for each round until the samples of the last are in the map.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import hypot, isfinite
from typing import Any

import numpy as np

from he3.errors import He3Error, NoRoute
from he3.frames import BoolArray, FloatArray, Place, SiteGrid
from he3.gp import Hyperparameters
from schemas.plans import MissionPlan
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState, SampleReport
from schemas.topics import PLAN
from services.ground.belief import Belief, Observation, fit
from services.ground.budget import Budget, Committed
from services.ground.planners import planner_named
from services.ground.planners.interface import Planner, PlannerOptions, PlanningRequest
from services.ground.round_log import RoundLog, RoundRecord
from services.ground.round_plans import PlanInWork, round_plan, run_planner, sample_id
from services.ground.terrain import GroundTerrain, along, cell_of, interest_weights
from services.mission.scenario import Scenario
from services.runtime.node import Compute, Effect, Finish, Level, LogRecord, MissionTime, Send, SetTimer, seconds

MAX_ATTEMPTS = 3  # plannings of one round, each with its own seed, before the ground gives up on it
MAX_FRUITLESS = 40  # rounds in a row from which no sample came
MAX_ROUNDS = 9_000  # in all; a plan can number 10,000
REPLAN_TIMER = "replan"
REJECTED_WAIT_S, MAX_WAIT_S = 30.0, 3600.0  # between a second rejection in a row and the next planning, and at most
MAX_REJECTIONS = 10  # plans in a row that the rover may reject
OBSTACLE_MARGIN_M = 1.5  # radius of what is closed around an obstacle that was met: it is seen from one side only
MAX_BACK = 200  # vertices of the driven path over which the rover may be sent back the way it came
OBSTACLE_REACH_M = 8.0  # obstacles met within this distance of each other are taken for one
_NOTHING_TO_DO = frozenset({RoverMode.IDLE, RoverMode.PARKED, RoverMode.SAFE})
_FIT, _PLAN = 1, 2  # what a seed is for


class Director:
    """The mission's state machine. It owns belief, terrain and ledger, and changes them on events alone."""

    def __init__(
        self, scenario: Scenario, grid: SiteGrid, belief: Belief, terrain: GroundTerrain, budget: Budget,
        planner: str | Planner | None = None,
    ) -> None:  # fmt: skip
        self.scenario = scenario
        self.grid = grid
        self.belief = belief
        self.terrain = terrain
        self.round_log = RoundLog()
        self.revision = 0
        """Of the last plan sent."""
        self.in_work: PlanInWork | None = None
        self.fitted = 0
        """Rounds that the hyperparameters have seen."""
        self.fitting: str | None = None
        self.driven_m = 0.0
        """Odometer of the rover, as last heard [m]."""
        self.place_m: Place = scenario.start_m
        """Where the rover was last heard of."""
        self.ended: Finish | None = None
        self.detail = ""
        """What an operator should know of how it goes."""
        self._budget = budget
        self._planner = planner if planner is not None else scenario.ground.planner
        if isinstance(self._planner, str) and ":" in self._planner:
            planner_named(self._planner)  # somebody's own is refused now or never
        self.interests: dict[str, tuple[Sequence[Place], float]] = {
            area_id: (area.polygon_m, area.weight) for area_id, area in scenario.ground.interests.items()
        }
        """Corners and weight of the areas that are worth more, or less, than the rest."""
        self._interest = interest_weights(grid, list(self.interests.values()))
        self._origin: Place | None = scenario.start_m
        self._plans_asked = 0
        self._attempt = 0
        self._outlook_m: FloatArray | None = None
        self._rejections = 0
        self._last_sent = False
        self._completed = 0
        self._exhausted = ""
        self._failed = False
        self._heard_at: MissionTime = -1
        self._on_the_move: set[str] = set()
        self._met: list[Place] = []
        self._not_before: MissionTime = 0
        self._refused: set[str] = set()

    # --- what the mission is made of --------------------------------------------------------------------------------

    @property
    def samples_wanted(self) -> int:
        """Samples of the mission that are neither measured nor planned."""
        return max(0, self.scenario.samples - len(self.belief) - len(self.round_log.pending))

    # --- events -----------------------------------------------------------------------------------------------------

    def begin(self, now: MissionTime) -> list[Effect]:
        """The mission begins, or what had to wait need not wait any longer."""
        return self._advance(now)

    def state(self, state: RoverState, made_at: MissionTime, now: MissionTime) -> list[Effect]:
        """The rover has told how it is. Should it have dropped what is on board, that is planned anew."""
        newest = made_at >= self._heard_at
        if newest:
            self._budget.heard(state.energy_wh)
        self.heard((state.x_m, state.y_m), state.driven_m, made_at)
        waiting = self.round_log.not_begun
        idle = state.mode in _NOTHING_TO_DO and state.rounds_on_board == 0 and state.plan_revision == self.revision
        if not (newest and idle and waiting and state.round < waiting[0].number) or self.ended is not None:
            return []
        self._drop(waiting)
        self._origin = self.place_m
        note = LogRecord(
            Level.INFO, f"the rover has dropped round {waiting[0].number} and later ones; planning them anew"
        )
        return [note, *self._advance(now)]

    def heard(self, place_m: Place, driven_m: float, made_at: MissionTime) -> None:
        """The rover was at that place at that time."""
        self.driven_m = max(self.driven_m, driven_m)
        if made_at < self._heard_at:
            return
        self._heard_at = made_at
        self.place_m = place_m
        executing = next((record for record in reversed(self.round_log.chain) if record.begun), None)
        if executing is not None and not executing.ended:
            executing.note_place(place_m)

    def sample(self, report: SampleReport, now: MissionTime) -> list[Effect]:
        """A measurement has arrived; one that is there already, or was never asked for, changes nothing."""
        if report.sample_id in self.belief or report.sample_id in self._refused:
            return []
        known = self.round_log.of_sample(report.sample_id)
        if known is None:
            return [_warning(f"sample {report.sample_id}: expected one that was planned; it is left out of the map")]
        record, index = known
        place = (report.x_m, report.y_m)
        try:
            self.belief.add(
                report.sample_id,
                Observation((record.number, record.introduced, index), place, report.helium3_ppb),
            )
        except He3Error as error:
            self._refused.add(report.sample_id)
            record.settled.add(report.sample_id)  # it came; nothing more will
            refusal = _warning(f"sample {report.sample_id} is left out of the map: {error}")
            return [refusal, *self._begun(record), *self._advance(now)]
        record.settled.add(report.sample_id)
        record.arrived += 1
        self.driven_m = max(self.driven_m, report.driven_m)
        effects = self._begun(record)
        record.note_place(place)
        return [*effects, *self._advance(now)]

    def event(self, event: RoverEvent, now: MissionTime) -> list[Effect]:
        """The rover has reported something; what was reported before changes nothing."""
        place = (event.x_m, event.y_m)
        if not self.grid.contains(np.array([place]))[0]:
            return [
                _warning(f"event {event.kind.value}: expected a place in the region, got ({place[0]:g}, {place[1]:g})")
            ]
        self.heard(place, event.driven_m, event.at)
        match event.kind:
            case EventKind.PLAN_ACCEPTED:
                self._rejections, self._not_before = 0, 0
                return []
            case EventKind.PLAN_REJECTED:
                return self._plan_rejected(event, now)
            case EventKind.MISSION_COMPLETED:
                self._completed = max(self._completed, event.plan_revision)
                return self._advance(now)
            case EventKind.BLOCKED if event.round == 0:  # on an errand of the operator's
                self._close_off(event)
                return self._advance(now)
            case EventKind.SAFE_MODE_ENTERED | EventKind.LOW_ENERGY | EventKind.INSTRUMENT_SILENT:
                self.detail = f"{event.kind.value.replace('_', ' ')}: {event.detail}"[:400]
                return []
            case EventKind.SAFE_MODE_LEFT | EventKind.CHARGED | EventKind.RESUMED:
                self.detail = ""
                return []
            case (
                EventKind.ROUND_STARTED
                | EventKind.ROUND_COMPLETED
                | EventKind.ROUND_ABORTED
                | EventKind.BLOCKED
                | EventKind.SAMPLE_SKIPPED
            ):
                return self._of_a_round(event, now)
            case _:
                return []

    def computed(self, job: str, result: Any, error: Exception | None, now: MissionTime) -> list[Effect]:
        """A fit or a plan that was asked for is there; one that is no longer wanted is dropped."""
        if job == self.fitting:
            self.fitting = None
            self.fitted += 1
            if isinstance(result, Hyperparameters):
                self.belief.adopt(result)
                return self._advance(now)
            return [_warning(f"{job}: the hyperparameters stay as they were: {error}"), *self._advance(now)]
        work = self.in_work
        if work is None or job != work.job:
            return []
        self.in_work = None
        if error is None:
            try:
                return self._plan_made(work, result, now)
            except He3Error as invalid:
                error = invalid
        return self._planning_failed(work, error, now)

    def keep_out(self, area_id: str, polygons_m: Iterable[Sequence[Place]], now: MissionTime) -> list[Effect]:
        """An area is what those polygons cover; rounds that lead through it and have not begun are planned anew."""
        if not self.terrain.set_keep_out(area_id, polygons_m):
            return self._advance(now)
        area = self.terrain.areas[area_id]
        refuted = next((r for r in self.round_log.not_begun if self._leads_through(r, area)), None)
        if refuted is not None:
            self._drop([r for r in self.round_log.not_begun if r.number >= refuted.number])
        elif self.in_work is not None:
            self.in_work = None  # it is being planned on terrain that no longer is
        return self._advance(now)

    def set_interest(
        self, area_id: str, polygon_m: Sequence[Place] | None, weight: float, now: MissionTime
    ) -> list[Effect]:
        """An area is worth that weight from now on, or no longer; rounds that have not begun are planned anew."""
        if polygon_m is None:
            if self.interests.pop(area_id, None) is None:
                return []
        else:
            self.interests[area_id] = (polygon_m, weight)
        self._interest = interest_weights(self.grid, list(self.interests.values()))
        if self.ended is not None:
            return []
        self._drop(self.round_log.not_begun)
        self.in_work = None
        return self._advance(now)

    def moving(self, command_id: str) -> None:
        """The operator sends the rover elsewhere: nothing is planned until it is there."""
        self._on_the_move.add(command_id)
        self.in_work = None

    def moved(self, command_id: str, place_m: Place | None, now: MissionTime) -> list[Effect]:
        """It is there (or, with None, did not go); the rounds that have not begun are planned anew from there."""
        if command_id not in self._on_the_move:
            return []
        self._on_the_move.discard(command_id)
        if place_m is not None and self.ended is None:
            self.place_m = place_m
            self._drop(self.round_log.not_begun)
            if not self.round_log.chain or self.round_log.chain[-1].closed or self.round_log.chain[-1].ended:
                self._origin = place_m
        return self._advance(now)

    # --- rounds -----------------------------------------------------------------------------------------------------

    def _of_a_round(self, event: RoverEvent, now: MissionTime) -> list[Effect]:
        record = self.round_log.version(event.round, event.plan_revision or self.revision)
        if event.sample_id is not None and (known := self.round_log.of_sample(event.sample_id)) is not None:
            record = known[0]
        if record is None:
            return [_warning(f"event {event.kind.value}: expected a round that was planned, got {event.round}")]
        effects = self._begun(record)
        if event.kind is EventKind.ROUND_STARTED and record.ended_early and event.at > record.ended_at:
            record.ended = record.ended_early = False  # it was aborted, and begun again from an older plan
        record.done.update(event.samples_done)
        if event.kind is EventKind.SAMPLE_SKIPPED and event.sample_id is not None:
            if event.sample_id not in record.settled:
                record.settled.add(event.sample_id)
                self.detail = f"sample {event.sample_id} was skipped: {event.detail or 'no reason given'}"[:400]
        elif event.kind is EventKind.ROUND_COMPLETED and not record.ended:
            record.ended = True
            record.reached_m = record.length_m
        elif event.kind in (EventKind.ROUND_ABORTED, EventKind.BLOCKED):
            effects += self._ended_early(record, event)
        return [*effects, *self._advance(now)]

    def _begun(self, record: RoundRecord) -> list[Effect]:
        if not self.round_log.begin(record):
            return []
        # The rover had begun a version that was to be replaced: what comes after it must fit its end.
        self._last_sent = False
        self.in_work = None
        self._origin = None
        return [
            LogRecord(
                Level.INFO, f"round {record.number} of revision {record.introduced} had begun; planning on from it"
            )
        ]

    def _ended_early(self, record: RoundRecord, event: RoverEvent) -> list[Effect]:
        first_word = not record.ended
        blocked = event.kind is EventKind.BLOCKED
        if blocked:
            self._close_off(event)
        if not first_word and not blocked:
            return []
        record.ended = record.ended_early = True
        record.ended_at = event.at
        self.detail = f"round {record.number} ended early: {event.detail or event.kind.value}"[:400]
        if not self.round_log.goes_on_after(record):
            self._drop(self.round_log.not_begun)
            self._origin = (event.x_m, event.y_m)
        return [LogRecord(Level.WARNING, self.detail, {"round": record.number, "x_m": event.x_m, "y_m": event.y_m})]

    def _close_off(self, event: RoverEvent) -> None:
        """What the rover met is closed on the ground's map too. A keep-out that it met is known here already."""
        if event.obstacle_m is not None and self.grid.contains(np.array([event.obstacle_m]))[0]:
            # Met again nearby, it is larger than was thought.
            met = sum(hypot(x - event.obstacle_m[0], y - event.obstacle_m[1]) < OBSTACLE_REACH_M for x, y in self._met)
            self._met.append(event.obstacle_m)
            self.terrain.block(event.obstacle_m, OBSTACLE_MARGIN_M * min(2**met, 4), (event.x_m, event.y_m))

    def _plan_rejected(self, event: RoverEvent, now: MissionTime) -> list[Effect]:
        if event.plan_revision < self.revision or self.ended is not None:
            return []  # a newer plan is on its way and is judged by itself
        self._rejections += 1
        self.detail = f"plan {event.plan_revision} was rejected: {event.detail or 'no reason given'}"[:400]
        note = _warning(self.detail)
        self._drop(self.round_log.not_begun)
        if self._rejections > MAX_REJECTIONS:
            self._exhausted = f"{self._rejections} plans in a row were rejected, the last: {event.detail}"[:400]
            self._failed = True
        elif not self.round_log.chain or self.round_log.chain[-1].ended or self.round_log.chain[-1].closed:
            self._origin = (event.x_m, event.y_m)
        if self._rejections == 1:
            return [note, *self._advance(now)]
        # It knows something that has not come down yet: the next plan waits for it, longer each time.
        self._not_before = now + seconds(min(REJECTED_WAIT_S * 2 ** (self._rejections - 2), MAX_WAIT_S))
        return [note, SetTimer(REPLAN_TIMER, self._not_before), *self._advance(now)]

    def _drop(self, records: Iterable[RoundRecord]) -> None:
        """Take back rounds that have not begun, and whatever is being planned to follow them."""
        dropped = list(records)
        self.round_log.drop(dropped)
        if self._outlook_m is not None:  # what they were to sample is still to be sampled
            ahead = [(planned.x_m, planned.y_m) for record in dropped for planned in record.plan.samples]
            self._outlook_m = np.vstack((np.array(ahead, dtype=np.float64).reshape(-1, 2), self._outlook_m))
        self.in_work = None
        self._last_sent = False
        self._exhausted = ""
        self._failed = False
        self._attempt = 0
        self._origin = None if self.round_log.chain else self.place_m

    def _leads_through(self, record: RoundRecord, area: BoolArray) -> bool:
        return any(area[cell_of(self.grid, place)] for place in along(record.plan.path_m, 0.5 * self.grid.resolution_m))

    def _committed(self) -> Committed:
        round_log = self.round_log
        metres = sum(record.to_drive_m for record in round_log.chain)
        return Committed(metres, len(round_log.pending), len(round_log.open_rounds))

    def plan_ends(self, now: MissionTime) -> MissionTime | None:
        """When the rover will have done what is planned, at the pace to be expected; None if nothing is, or never."""
        if not self.round_log.open_rounds:
            return None
        lasts_s = self._budget.lasts_s(self._committed())
        return now + seconds(lasts_s) if isfinite(lasts_s) else None

    # --- planning ---------------------------------------------------------------------------------------------------

    def _advance(self, now: MissionTime) -> list[Effect]:
        """Whatever can be begun now: the next refit, else the next plan, else the end."""
        if self.ended is not None or self.fitting is not None:
            return []
        effects = self._next_fit()
        if effects:
            return effects
        if self.in_work is not None:
            return []
        if not self._exhausted and self.samples_wanted > 0:
            enough = len(self.round_log.open_rounds) > self.scenario.ground.pipeline
            if enough or self._on_the_move or now < self._not_before:
                return []
            effects = self._next_plan(now)
            if effects:
                return effects
        return self._end_if_over()

    def _next_fit(self) -> list[Effect]:
        while self.fitted < len(self.round_log.chain) and self.round_log.chain[self.fitted].closed:
            number, record = self.fitted + 1, self.round_log.chain[self.fitted]
            request = None
            if record.arrived:
                request = self.belief.fit_request(record.number, (self.scenario.seed, _FIT, number))
            if request is not None:
                self.fitting = f"fit:{number}"
                return [Compute(self.fitting, fit, (request,))]
            self.fitted += 1
        return []

    def _next_plan(self, now: MissionTime) -> list[Effect]:
        pending = self.round_log.pending
        allowance = self._budget.left(now, self.driven_m, self._committed(), self.samples_wanted)
        number = self.round_log.next_number
        fruitless = self.round_log.fruitless
        if allowance.samples < 1 or fruitless >= MAX_FRUITLESS or number > MAX_ROUNDS:
            self._exhausted = allowance.why or f"{fruitless} rounds in a row brought no sample, of {number - 1}"
            return []
        start = self._origin or (self.round_log.chain[-1].end_m if self.round_log.chain else self.place_m)
        samples = min(self.scenario.samples_per_round, allowance.samples)
        self._plans_asked += 1
        self.in_work = PlanInWork(
            job=f"plan:{number}:{self._plans_asked}",
            number=number,
            start_m=start,
            samples=samples,
            samples_left=allowance.samples,
            attempt=self._attempt,
            known=len(self.belief),
            pending=tuple(planned.sample_id for planned in pending),
        )
        ahead = np.array([(planned.x_m, planned.y_m) for planned in pending], dtype=np.float64).reshape(-1, 2)
        ground = self.scenario.ground
        seed = np.random.SeedSequence((self.scenario.seed, _PLAN, number, self.revision + 1, self._attempt))
        request = PlanningRequest(
            grid=self.grid,
            traversable=self.terrain.open_from(start, self.round_log.paths()[0][-MAX_BACK:]),
            start_m=start,
            observed_m=np.vstack((self.belief.places_m, ahead)),
            std_ppb=self.belief.map.std_ppb,
            hyperparameters=self.belief.hyperparameters,
            samples=samples,
            samples_left=allowance.samples,
            budget_m=allowance.metres,
            seed=int(seed.generate_state(1)[0]),
            interest=self._interest,
            options=PlannerOptions(clearance_m=ground.clearance_m, information_exponent=ground.information_exponent),
            outlook_m=self._outlook_m,
        )
        return [Compute(self.in_work.job, run_planner, (self._planner, request, len(ahead)), ground.planning_s)]

    def _plan_made(self, work: PlanInWork, result: Any, now: MissionTime) -> list[Effect]:
        revision = self.revision + 1
        # The first plan of a round has the plain ids; they are never used for another place.
        known = self.round_log.of_sample(sample_id(work.number, "", 1)) is not None
        version = f"v{revision}" if known else ""
        planned = round_plan(work, result, self.grid, version, self.scenario.sample_depth_m)
        self.revision = revision
        self._outlook_m = result.outlook_m
        self.round_log.append(planned, revision)
        self._origin = None
        self._attempt = 0
        self._last_sent = work.samples_left <= len(planned.samples)
        plan = MissionPlan(
            revision=revision,
            rounds=tuple(record.plan for record in self.round_log.not_begun),
            last=self._last_sent,
            samples_known=work.known,
            samples_pending=work.pending,
            planned_at=now,
        )
        return [Send(PLAN, plan), *self._advance(now)]

    def _planning_failed(self, work: PlanInWork, error: Exception, now: MissionTime) -> list[Effect]:
        self._attempt = work.attempt + 1
        why = f"round {work.number} could not be planned: {error}"[:400]
        if self._attempt >= MAX_ATTEMPTS:
            self._attempt = 0
            self._exhausted = why
            self._failed = not isinstance(error, NoRoute)
        return [_warning(why), *self._advance(now)]

    # --- the end ----------------------------------------------------------------------------------------------------

    def _end_if_over(self) -> list[Effect]:
        if self.round_log.open_rounds:
            return []
        if self._last_sent and not self._exhausted and self._completed < self.round_log.chain[-1].introduced:
            return []  # the rover has still to say that it is through
        taken, total = len(self.belief), self.scenario.samples
        why = f"{taken} of {total} samples are in the map"
        if taken < total:
            why += f"; {self._exhausted or self.detail or 'the rover has completed its plan'}"
        self.detail = why
        self.ended = Finish(ok=not self._failed, why=why)
        return [self.ended]


def _warning(text: str) -> LogRecord:
    return LogRecord(Level.WARNING, text)

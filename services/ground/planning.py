"""The round that is being planned: the request to the planner, its seed, and the plan from the answer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from he3.errors import InvalidInput, NoRoute
from he3.frames import path_length
from he3.information import information_gain
from he3.posterior.grid import GridPosterior
from services.ground.bounded_task import BoundedTask
from services.ground.planners import planner_named
from services.ground.planners.interface import PlannedRound, Planner, PlannerOptions, PlanningGoal, PlanningRequest
from services.ground.planners.rounds import after_way_back
from services.ground.planners.validation import checked_answer
from services.ground.planners.visiting import visiting
from services.ground.round_plans import PlanningTask, ProposedRound, round_plan, sample_id
from services.runtime.node import Compute

if TYPE_CHECKING:
    from he3.driving_cost import TerrainCost
    from he3.frames import Float32Array, FloatArray, Place, SiteGrid
    from schemas.plans import PlannedSample, RoundPlan
    from services.ground.belief import Belief
    from services.ground.budget import RemainingBudget
    from services.ground.interests import InterestAreas
    from services.ground.round_log import RoundLog
    from services.ground.round_record import RoundRecord
    from services.ground.terrain import GroundTerrain
    from services.mission.mission_time import MissionTime
    from services.mission.scenario import Scenario
    from services.runtime.node import SavedState

MAX_ATTEMPTS = 3  # plannings of one round, each with its own seed, before the ground gives up on it
MAX_BACK = 200  # vertices of the driven path over which the rover may be sent back the way it came
IGNORE_STD = frozenset({"informative", "tour"})  # planners that never read the map's standard deviation
_SEED = 2  # tells the seeds of plans from those of fits


class RoundPlanning:
    """Plans one round at a time, and makes the plans' revisions."""

    def __init__(
        self,
        scenario: Scenario,
        grid: SiteGrid,
        belief: Belief,
        terrain: GroundTerrain,
        round_log: RoundLog,
        interests: InterestAreas,
        planner: str | Planner | None = None,
        cost: TerrainCost | None = None,
        goal: Callable[[], PlanningGoal | None] = lambda: None,
    ) -> None:
        """planner: in place of the scenario's. Raises InvalidInput for a plug-in planner that cannot be imported."""
        self._scenario = scenario
        self._grid = grid
        self._belief = belief
        self._terrain = terrain
        self._round_log = round_log
        self._interests = interests
        self._cost = cost
        self._goal = goal
        self._planner = planner if planner is not None else scenario.ground.planner
        self._run: Callable[..., PlannedRound] = run_planner
        if isinstance(self._planner, str) and ":" in self._planner:
            planner_named(self._planner)  # a bad name fails at start-up, not when the first round is planned
            # Ours end by iterations; a limit on their time would let the speed of the machine decide on the mission.
            self._run = BoundedTask(run_planner, scenario.ground.planner_limit_s)
        self.revision = 0
        """Revision of the last plan made."""
        self._task: PlanningTask | None = None
        self._tasks = 0
        self._attempt = 0
        self._sent_back = 0
        self.proposed: ProposedRound | None = None
        """The round that waits for the operator's approval."""
        self._outlook_m: FloatArray | None = None

    @property
    def functions(self) -> dict[str, Callable[..., Any]]:
        """The functions that a planning task refers to, by name."""
        named: dict[str, Callable[..., Any]] = {"run_planner": self._run}
        return named if isinstance(self._planner, str) else {**named, "planner": self._planner}

    @property
    def busy(self) -> bool:
        """Whether a round is being planned, or waits for approval."""
        return self._task is not None or self.proposed is not None

    def start(self, number: int, start_m: Place, remaining: RemainingBudget) -> Compute:
        """Plan the round of that number from that place, within the remaining budget."""
        pending = self._round_log.pending
        samples = min(self._scenario.samples_per_round, remaining.samples)
        self._tasks += 1
        self._task = PlanningTask(
            job=f"plan:{number}:{self._tasks}",
            number=number,
            samples_left=remaining.samples,
            attempt=self._attempt,
            known=len(self._belief),
            pending=tuple(planned.sample_id for planned in pending),
        )
        request = self._request(number, start_m, samples, remaining, pending)
        arguments = (self._planner, request, len(pending))
        return Compute(self._task.job, self._run, arguments, self._scenario.ground.planning_s)

    def _request(
        self, number: int, start_m: Place, samples: int, remaining: RemainingBudget, pending: Sequence[PlannedSample]
    ) -> PlanningRequest:
        ground = self._scenario.ground
        back_m = self._terrain.way_back(start_m, self._round_log.paths()[0][-MAX_BACK:])
        back = 0.0
        if back_m is not None:
            start_m = (float(back_m[-1, 0]), float(back_m[-1, 1]))
            back = path_length(back_m) if self._cost is None else self._cost.of_path(back_m)
        options = PlannerOptions(
            clearance_m=ground.clearance_m, information_exponent=ground.information_exponent
        ).on_site(self._grid)
        choices = (self._scenario.seed, _SEED, number, self.revision + 1, self._attempt)
        seed = np.random.SeedSequence((*choices, self._sent_back) if self._sent_back else choices)
        return PlanningRequest(
            grid=self._grid,
            traversable=self._terrain.open_from(start_m),
            start_m=start_m,
            observed_m=np.vstack((self._belief.places_m, _places(pending))),
            std_ppb=self._std_ppb(bool(pending)),
            hyperparameters=self._belief.hyperparameters,
            samples=samples,
            samples_left=remaining.samples,
            budget_m=remaining.metres - back,
            seed=int(seed.generate_state(1)[0]),
            interest=self._interests.weights,
            options=options,
            outlook_m=self._outlook_m,
            cost=self._cost,
            goal=self._goal(),
            back_m=back_m,
            margin_m=self._terrain.margin_m,
        )

    def _std_ppb(self, samples_pending: bool) -> Float32Array:
        """The map's standard deviation (rows, columns) [ppb]; zeros where nothing reads it, which costs no map."""
        ignored = isinstance(self._planner, str) and self._planner in IGNORE_STD
        if ignored or samples_pending:  # with samples pending, `run_planner` computes it
            return np.zeros(self._grid.shape, dtype=np.float32)
        return self._belief.map.std_ppb

    def cancel(self) -> None:
        """Cancel the round that is being planned or waits for approval; an answer is dropped when it arrives."""
        self._task = None
        self.proposed = None

    def take_back(self, records: Iterable[RoundRecord]) -> None:
        """Take back rounds that are to be planned again; their places join the outlook."""
        if self._outlook_m is not None:
            samples = [planned for record in records for planned in record.plan.samples]
            self._outlook_m = np.vstack((_places(samples), self._outlook_m))
        self.cancel()
        self._attempt = 0

    def answered(self, job: str) -> PlanningTask | None:
        """The task of that computation, which is then closed; None if it was cancelled."""
        if self._task is None or self._task.job != job:
            return None
        task, self._task = self._task, None
        return task

    def propose(self, task: PlanningTask, planned: PlannedRound, now: MissionTime) -> ProposedRound:
        """The planned round as a proposal: it waits in `proposed` for approval."""
        return self._proposed_of(task, planned, planned.outlook_m, now)

    def _proposed_of(
        self, task: PlanningTask, planned: PlannedRound, outlook_m: FloatArray | None, now: MissionTime
    ) -> ProposedRound:
        # The first plan of a round has the plain ids; they are never used for another place.
        known = self._round_log.of_sample(sample_id(task.number, "", 1)) is not None
        version = f"v{self.revision + 1}" if known else ""
        plan = round_plan(task.number, planned, version, self._scenario.sample_depth_m)
        self.proposed = ProposedRound(self._tasks, task, plan, outlook_m, now)
        return self.proposed

    def edited(self, proposed: ProposedRound, drop: Sequence[str]) -> RoundPlan:
        """The proposed round without these samples; raises InvalidInput for others, and unless one is left."""
        names = [planned.sample_id for planned in proposed.plan.samples]
        strange = next((name for name in drop if name not in names), None)
        if strange is not None:
            raise InvalidInput(f"plan: expected samples among {', '.join(names)}, got {strange}")
        if not drop:
            return proposed.plan
        kept = tuple(planned for planned in proposed.plan.samples if planned.sample_id not in drop)
        if not kept:
            raise InvalidInput("plan: expected at least one sample that is kept, got none: send the plan back instead")
        known = self._belief.process.condition_on_places(_places(self._round_log.pending))
        noise = self._belief.hyperparameters.noise_variance_ppb2
        nats = information_gain(known.posterior_covariance(_places(kept)), noise)
        return proposed.plan.model_copy(update={"samples": kept, "information_nats": max(0.0, nats)})

    def revised(
        self, proposed: ProposedRound, places_m: Sequence[Place], remaining: RemainingBudget, now: MissionTime
    ) -> ProposedRound:
        """A new proposal in place of that one, which samples these places [m] in this order; it waits in `proposed`.

        remaining: the budget of the rest of the mission, this round included. Raises InvalidInput for places that are
        too many, outside, or not to be reached, and for a path beyond the budget; the proposal then stays as it is.
        """
        places, most = np.array(places_m, dtype=np.float64).reshape(-1, 2), remaining.samples
        if not 1 <= len(places) <= most:
            raise InvalidInput(f"plan: expected 1 to {most} places to sample, as many as are left, got {len(places)}")
        inside = self._grid.contains(places)
        if not inside.all():
            x, y = places[int(np.argmin(inside))]
            raise InvalidInput(f"plan: expected places within the region, got ({x:g}, {y:g}) m")
        pending, number = self._round_log.pending, proposed.task.number
        request = self._request(number, proposed.plan.path_m[0], len(places), remaining, pending)
        try:
            planned = after_way_back(visiting(request, places), request)
        except NoRoute as error:
            raise InvalidInput(f"plan: {error}") from None
        cost = planned.length_m if self._cost is None else self._cost.of_path(planned.path_m)
        if cost > remaining.metres:
            level = "" if self._cost is None else " level"
            raise InvalidInput(f"plan: expected{level} {remaining.metres:,.1f} m at most, got {cost:,.1f} m")
        self._tasks += 1
        task = replace(
            proposed.task,
            samples_left=remaining.samples,
            known=len(self._belief),
            pending=tuple(sample.sample_id for sample in pending),
        )
        return self._proposed_of(task, planned, proposed.outlook_m, now)

    def approve(self, proposed: ProposedRound) -> int:
        """Note that this round is sent; returns the new plan's revision."""
        self.cancel()
        self.revision += 1
        self._outlook_m = proposed.outlook_m
        self._attempt = 0
        return self.revision

    def send_back(self) -> None:
        """Drop the proposed round; the round is planned again, with another seed."""
        self.cancel()
        self._sent_back += 1

    def failed(self, task: PlanningTask) -> bool:
        """Note that planning failed; returns whether to give up, else the round is planned again with another seed."""
        self._attempt = task.attempt + 1
        if self._attempt < MAX_ATTEMPTS:
            return False
        self._attempt = 0
        return True

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "revision": self.revision,
            "task": self._task,
            "tasks": self._tasks,
            "attempt": self._attempt,
            "sent_back": self._sent_back,
            "proposed": self.proposed,
            "outlook_m": self._outlook_m,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the planning from this state."""
        self.revision = state["revision"]
        self._task = state["task"]
        self._tasks = state["tasks"]
        self._attempt = state["attempt"]
        self._sent_back, self.proposed = state["sent_back"], state["proposed"]
        self._outlook_m = state["outlook_m"]


def run_planner(planner: str | Planner, request: PlanningRequest, pending: int) -> PlannedRound:
    """The planner's answer, checked, with the last `pending` of the observed places counted in first.

    Pure and picklable, made to run elsewhere. The posterior variance does not depend on values, so places whose values
    are not known yet lower it all the same. Raises NoRoute, or InvalidInput for an answer that cannot be driven.
    """
    if pending and not (isinstance(planner, str) and planner in IGNORE_STD):
        values = np.zeros(len(request.observed_m))
        ahead = GridPosterior.build(request.grid, request.hyperparameters, request.observed_m, values, followed=False)
        request = replace(request, std_ppb=ahead.std_ppb)
    if isinstance(planner, str):
        planned = planner_named(planner)(request)
    else:
        planned = checked_answer(getattr(planner, "__name__", type(planner).__name__), planner(request), request)
    if request.goal is not None and planned.forecast is None:
        from services.ground.planners.tour.covering import foreseen

        planned = replace(planned, forecast=foreseen(request, request.goal))
    return after_way_back(planned, request)


def _places(samples: Sequence[PlannedSample]) -> FloatArray:
    """(n, 2) [m]."""
    return np.array([(planned.x_m, planned.y_m) for planned in samples], dtype=np.float64).reshape(-1, 2)

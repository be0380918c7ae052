"""The programme: the plan that counts, the rounds of it that are on board, and what of the mission is done."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Final

from he3.frames import Place, SiteGrid
from schemas.plans import MissionPlan
from services.rover.activities import Activity
from services.rover.admission import Situation, admitted
from services.rover.geometry import Area

BEFORE_THE_FIRST: Final = 0  # the revision and the round before any


class PlanQueue:
    """Which round is next, and whether a new plan fits behind those that have begun."""

    def __init__(self) -> None:
        self.plan: MissionPlan | None = None
        self.on_board: deque[Activity] = deque()
        self.round = BEFORE_THE_FIRST
        """The last round that has begun."""
        self.measured: set[str] = set()
        """Samples whose number is known."""
        self._aborted = False
        self._completed = BEFORE_THE_FIRST

    @property
    def revision(self) -> int:
        """Of the last plan accepted."""
        return self.plan.revision if self.plan else BEFORE_THE_FIRST

    def take(
        self,
        plan: MissionPlan,
        under_way: Activity | None,
        place_m: Place,
        *,
        site: SiteGrid,
        areas: Mapping[str, Area],
        margin_m: float,
    ) -> str | None:
        """Takes the plan's rounds on board in place of all that have not begun; or one line on why it does not fit.

        place_m is where the rover will be when what is under way is done [m].
        """
        ids = [leg.sample.sample_id for leg in under_way.legs if leg.sample] if under_way else []
        situation = Situation(
            accepted=self.plan,
            begun=self.round,
            replannable=self._aborted,
            place_m=place_m,
            measured=self.measured.union(ids),
            site=site,
            areas=areas,
            margin_m=margin_m,
        )
        jobs = admitted(plan, situation)
        if isinstance(jobs, str):
            return jobs
        self.plan, self.on_board = plan, deque(jobs)
        return None

    def next_round(self) -> Activity:
        """The next round on board, which has begun with that."""
        job = self.on_board.popleft()
        self.round, self._aborted = job.round, False
        return job

    def abort(self, job: Activity | None) -> int:
        """Gives up the job and drops the rounds on board; returns how many those were."""
        self._aborted = self._aborted or (job is not None and job.round > 0)
        dropped = len(self.on_board)
        self.on_board.clear()
        return dropped

    def completes(self) -> bool:
        """Whether the last round of a mission's last plan is done; true once for each such plan."""
        plan = self.plan
        if plan is None or not plan.last or self._aborted or self.round != plan.rounds[-1].round:
            return False
        first_time = self._completed != plan.revision
        self._completed = plan.revision
        return first_time

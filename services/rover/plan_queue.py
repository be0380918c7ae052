"""The plan queue: the accepted plan, its rounds on board, and the samples already measured."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from services.rover.activities import Activity
from services.rover.admission import Admission, admit

if TYPE_CHECKING:
    from he3.frames import Place, SiteGrid
    from schemas.plans import MissionPlan
    from services.rover.keep_outs import KeepOuts
    from services.runtime.node import SavedState

BEFORE_THE_FIRST: Final = 0  # the plan revision and the round before the first


class PlanQueue:
    """Which round is next, and whether a new plan fits behind the rounds that have begun."""

    def __init__(self) -> None:
        self.plan: MissionPlan | None = None
        """The last plan accepted."""
        self.on_board: deque[Activity] = deque()
        """Rounds that have not begun."""
        self.round = BEFORE_THE_FIRST
        """The last round that has begun."""
        self.measured: set[str] = set()
        """Samples whose value is known."""
        self._aborted = False
        self._completed = BEFORE_THE_FIRST

    @property
    def revision(self) -> int:
        """Revision of the last plan accepted."""
        return self.plan.revision if self.plan else BEFORE_THE_FIRST

    def accept(
        self, plan: MissionPlan, current: Activity | None, start_m: Place, site: SiteGrid, keep_outs: KeepOuts
    ) -> str | None:
        """Replaces all rounds that have not begun by the plan's; or returns one line on why the plan does not fit.

        start_m: where the rover is when the current activity is done [m].
        """
        under_way = {leg.sample.sample_id for leg in current.legs if leg.sample} if current else set()
        admission = Admission(
            accepted=self.plan,
            last_begun=self.round,
            replannable=self._aborted,
            start_m=start_m,
            measured=self.measured | under_way,
            site=site,
            keep_outs=keep_outs,
        )
        rounds = admit(plan, admission)
        if isinstance(rounds, str):
            return rounds
        self.plan, self.on_board = plan, deque(rounds)
        return None

    def next_round(self) -> Activity:
        """Removes and returns the next round, which has then begun."""
        activity = self.on_board.popleft()
        self.round, self._aborted = activity.round, False
        return activity

    def abort(self, activity: Activity | None) -> int:
        """Marks the round, if it is one, as aborted, and drops the rounds on board; returns how many were dropped."""
        self._aborted = self._aborted or (activity is not None and activity.round > 0)
        dropped = len(self.on_board)
        self.on_board.clear()
        return dropped

    def completes(self) -> bool:
        """Whether the last round of the mission's last plan is done; True once for each such plan."""
        plan = self.plan
        if plan is None or not plan.last or self._aborted or self.round != plan.rounds[-1].round:
            return False
        first_time = self._completed != plan.revision
        self._completed = plan.revision
        return first_time

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "plan": self.plan,
            "on_board": [activity.checkpoint() for activity in self.on_board],
            "round": self.round,
            "measured": set(self.measured),
            "aborted": self._aborted,
            "completed": self._completed,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the queue from this state."""
        self.plan = state["plan"]
        self.on_board = deque(Activity.restored(activity) for activity in state["on_board"])
        self.round, self.measured = state["round"], state["measured"]
        self._aborted, self._completed = state["aborted"], state["completed"]

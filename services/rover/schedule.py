"""The schedule: the activity under way, and the rounds on board behind it.

This module begins and ends activities, and reports both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.commands import CommandStage
from schemas.telemetry import EventKind
from services.rover.activities import Activity
from services.runtime.node import Effect, Level, LogRecord

if TYPE_CHECKING:
    from he3.frames import Place, SiteGrid
    from schemas.plans import MissionPlan
    from services.mission.mission_time import MissionTime
    from services.rover.command_registry import CommandRegistry
    from services.rover.keep_outs import KeepOuts
    from services.rover.plan_queue import PlanQueue
    from services.rover.reporter import Reporter
    from services.rover.vehicle import Vehicle
    from services.runtime.node import SavedState


class Schedule:
    """The rover's present activity and its next ones."""

    def __init__(
        self,
        *,
        site: SiteGrid,
        vehicle: Vehicle,
        keep_outs: KeepOuts,
        plan_queue: PlanQueue,
        commands: CommandRegistry,
        reporter: Reporter,
        effects: list[Effect],
    ) -> None:
        self._site = site
        self._vehicle = vehicle
        self._keep_outs = keep_outs
        self._plan_queue = plan_queue
        self._commands = commands
        self._reporter = reporter
        self._effects = effects
        self._current: Activity | None = None
        self._begun = False

    @property
    def current(self) -> Activity | None:
        """The activity under way."""
        return self._current

    @property
    def empty(self) -> bool:
        """Whether no activity is under way and no round is on board."""
        return self._current is None and not self._plan_queue.on_board

    @property
    def end_m(self) -> Place:
        """Where the rover is when the current activity is done [m]."""
        return (self._current.end_m if self._current else None) or self._vehicle.standing_m

    def accept_plan(self, plan: MissionPlan, now: MissionTime) -> bool:
        """Replaces all rounds that have not begun by the plan's; False if the plan is rejected or known already."""
        queue = self._plan_queue
        if plan == queue.plan:
            self._effects.append(LogRecord(Level.DEBUG, "plan received again", {"revision": plan.revision}))
            return False
        why = queue.accept(plan, self._current, self.end_m, self._site, self._keep_outs)
        if why is not None:
            self._reporter.report_event(
                EventKind.PLAN_REJECTED, now, why, round_=plan.rounds[0].round, revision=plan.revision
            )
            return False
        first, last = queue.on_board[0].round, queue.on_board[-1].round
        self._reporter.report_event(EventKind.PLAN_ACCEPTED, now, f"rounds {first} to {last}", round_=first)
        return True

    def begin(self, activity: Activity) -> None:
        """Makes the activity the current one; it may leave the keep-outs that the rover stands in."""
        activity.exempt_keep_outs = self._keep_outs.around(self._vehicle.standing_m)
        self._current, self._begun = activity, True

    def begin_round(self, now: MissionTime) -> None:
        """Begins the next round on board."""
        activity = self._plan_queue.next_round()
        self.begin(activity)
        self._reporter.report_activity(EventKind.ROUND_STARTED, activity, now)

    def finish_leg(self, activity: Activity, now: MissionTime) -> None:
        """Begins the activity's next leg; after the last one the activity is done."""
        activity.finish_leg()
        if not activity.done:
            return
        self._current = None
        if activity.command is not None:
            self._reporter.report_command(self._commands.advance(activity.command, CommandStage.COMPLETED, now))
        else:
            self._reporter.report_activity(EventKind.ROUND_COMPLETED, activity, now)

    def abandon(self, now: MissionTime, why: str) -> None:
        """Gives up the current activity, and the rounds on board: the rover will not be where they begin."""
        activity, self._current = self._current, None
        dropped = self._plan_queue.abort(activity)
        if activity is not None and activity.round:
            self._reporter.report_activity(EventKind.ROUND_ABORTED, activity, now, why)
        elif dropped:  # no round is there to report, so the plan is
            detail = f"the rover will not be where its rounds begin: {why}"
            self._reporter.report_event(EventKind.PLAN_REJECTED, now, detail)
        if activity is not None and activity.command is not None:
            self._reporter.report_command(self._commands.advance(activity.command, CommandStage.FAILED, now, why))

    def take_begun(self) -> bool:
        """Whether an activity has begun since the last call."""
        begun, self._begun = self._begun, False
        return begun

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {"current": None if self._current is None else self._current.checkpoint(), "begun": self._begun}

    def restore(self, state: SavedState) -> None:
        """Restore the schedule from this state."""
        current = state["current"]
        self._current = None if current is None else Activity.restored(current)
        self._begun = state["begun"]

"""What a command would do: answered by the ground from its own knowledge, without a change of anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, isfinite
from typing import TYPE_CHECKING, Any, Final

from he3.errors import InvalidInput
from he3.track import return_path
from schemas.commands import MAX_PREVIEW_VERTICES, CommandKind, CommandPreview, Telecommand
from schemas.telemetry import RoverMode, RoverState
from services.ground.terrain import cells_touched, leads_through

if TYPE_CHECKING:
    from he3.frames import Place
    from services.ground.budget import Budget
    from services.ground.command_history import CommandHistory
    from services.ground.driving_costs import DrivingCosts
    from services.ground.execution import ExecutionMonitor
    from services.ground.round_log import RoundLog
    from services.ground.round_record import RoundRecord
    from services.ground.terrain import GroundTerrain
    from services.mission.mission_time import MissionTime

EFFECTS: Final = {
    CommandKind.PAUSE: "the rover stops at its next safe point and waits for resume",
    CommandKind.RESUME: "the rover goes on with its plan",
    CommandKind.ABORT_ROUND: "the rover gives up the present round; the ground plans anew from there",
    CommandKind.GO_TO: "the rover drives straight to the place and waits there for the next plan",
    CommandKind.SET_KEEP_OUT: "the area is closed: for planning at once, for the rover when it has the command",
    CommandKind.RETURN_TO_START: "the rover drives back over its own track to the landing place",
    CommandKind.SAFE: "the rover enters safe mode at its next safe point and waits for resume",
}
REMOVAL = "the area is open again once the rover has carried out the command"
_DRIVES = frozenset({CommandKind.GO_TO, CommandKind.RETURN_TO_START})
_GIVES_UP = _DRIVES | {CommandKind.ABORT_ROUND}


@dataclass(frozen=True, slots=True)
class _Rounds:
    """Rounds that a command ends early, and those that are planned again."""

    given_up: tuple[RoundRecord, ...] = ()
    anew: tuple[RoundRecord, ...] = ()


class CommandPreviews:
    """Says what commands would do."""

    def __init__(
        self,
        history: CommandHistory,
        terrain: GroundTerrain,
        round_log: RoundLog,
        execution: ExecutionMonitor,
        budget: Budget,
        costs: DrivingCosts,
    ) -> None:
        self._history = history
        self._terrain = terrain
        self._round_log = round_log
        self._execution = execution
        self._budget = budget
        self._costs = costs

    def of(self, command: Telecommand, rover: RoverState | None, now: MissionTime) -> CommandPreview:
        """What that command would do if it were issued now. rover: its newest state; None if there is none.

        Who may command is not considered.
        """
        path_m = self._path_m(command)
        drive_m = sum(hypot(bx - ax, by - ay) for (ax, ay), (bx, by) in pairwise(path_m))
        drive = self._budget.drive(self._costs.figures(path_m))
        rounds = self._rounds(command)
        return CommandPreview(
            command=command,
            at=now,
            objection=self._objection(command, now),
            warning=self._warning(command, rover, path_m),
            effect=REMOVAL if _removes(command) else EFFECTS[command.kind],
            path_m=path_m,
            drive_m=drive_m,
            drive_s=drive.duration_s if isfinite(drive.duration_s) else None,
            energy_wh=drive.energy_wh,
            charge_wh=drive.charge_wh,
            closed_cells=self._terrain.closed_on(path_m) if path_m else 0,
            rounds_given_up=tuple(record.number for record in rounds.given_up),
            samples_given_up=sum(len(record.pending) for record in rounds.given_up),
            rounds_planned_anew=tuple(record.number for record in rounds.anew),
            **self._cells(command),
        )

    def _objection(self, command: Telecommand, now: MissionTime) -> str:
        """Why the ground would refuse it, in one line; empty if it would not."""
        try:
            self._history.expect_sound(command, now)
        except InvalidInput as error:
            return str(error)
        target = command.target_m
        why = None if target is None else self._terrain.objection_to_drive(self._execution.place_m, target)
        return why or ""

    def _warning(self, command: Telecommand, rover: RoverState | None, path_m: Sequence[Place]) -> str:
        """Why the rover would reject the command or not complete it, as it was last heard of; may be empty."""
        kind = command.kind
        if kind is CommandKind.RETURN_TO_START and (closed := self._terrain.closed_on(path_m)):
            return f"the way leads over {closed} cells that are closed now"
        if kind is CommandKind.ABORT_ROUND and self._round_log.executing is None:
            return "no round is under way"
        if _removes(command) and command.area_id not in self._terrain.areas:
            return f"there is no keep-out {command.area_id} to remove"
        if rover is None:
            return "nothing was heard of the rover yet"
        if kind is CommandKind.RESUME and rover.mode not in (RoverMode.PAUSED, RoverMode.SAFE):
            return f"expected a rover that is paused or in safe mode, got one that is {rover.mode.value}"
        if kind is CommandKind.PAUSE and rover.mode is RoverMode.SAFE:
            return "the rover is in safe mode already"
        return ""

    def _path_m(self, command: Telecommand) -> tuple[Place, ...]:
        """The way that the rover takes; empty if it does not move."""
        here = self._execution.place_m
        if command.target_m is not None:
            return (here, command.target_m)
        if command.kind is not CommandKind.RETURN_TO_START:
            return ()
        track = [*self._round_log.paths()[0], here]
        # A longer track would keep the ground from its mission for too long; its loops are kept then.
        home = return_path(track) if len(track) <= MAX_PREVIEW_VERTICES else tuple(reversed(track))
        way = (here, *home)
        step = -(-len(way) // (MAX_PREVIEW_VERTICES - 1))
        return way if step == 1 else (*way[:-1:step], way[-1])

    def _cells(self, command: Telecommand) -> dict[str, Any]:
        """How many cells a keep-out closes or opens."""
        if command.kind is not CommandKind.SET_KEEP_OUT:
            return {}
        if command.polygon_m is None:
            area = self._terrain.areas.get(str(command.area_id))
            return {"cells_to_open": 0 if area is None else int(area.sum())}
        closes = cells_touched(self._terrain.grid, command.polygon_m) & self._terrain.traversable
        return {"cells_to_close": int(closes.sum())}

    def _rounds(self, command: Telecommand) -> _Rounds:
        log = self._round_log
        executing = () if log.executing is None else (log.executing,)
        waiting = tuple(log.not_begun)
        if command.kind in _GIVES_UP:
            return _Rounds(executing, waiting)
        if command.polygon_m is None:
            return _Rounds()
        area = cells_touched(self._terrain.grid, command.polygon_m)
        blocked = tuple(each for each in executing if leads_through(self._terrain.grid, each.ahead(), area))
        refuted = [each.number for each in waiting if leads_through(self._terrain.grid, each.plan.path_m, area)]
        if blocked:
            return _Rounds(blocked, waiting)
        return _Rounds((), tuple(each for each in waiting if refuted and each.number >= refuted[0]))


def _removes(command: Telecommand) -> bool:
    return command.kind is CommandKind.SET_KEEP_OUT and command.polygon_m is None

"""Telecommands: accepted or rejected on arrival, executed at the next safe point. The table has one row per kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from he3.track import return_path
from schemas.commands import CommandKind, CommandStage, Telecommand
from schemas.topics import COMMAND
from services.mission.mission_time import MissionTime
from services.rover.activities import Activity, Leg
from services.rover.admission import outside
from services.rover.command_registry import MAX_WAITING, CommandRegistry, is_past
from services.rover.states import Hold
from services.runtime.node import Cause, Effect, Level, LogRecord

if TYPE_CHECKING:
    from he3.frames import Place, SiteGrid
    from schemas.wire import Header
    from services.rover.keep_outs import KeepOuts
    from services.rover.operating_state import OperatingState
    from services.rover.reporter import Reporter
    from services.rover.schedule import Schedule
    from services.rover.vehicle import Vehicle

MAX_KEEP_OUTS: Final = 100


@dataclass(frozen=True, slots=True)
class Controls:
    """The operations of the rover that telecommands use."""

    site: SiteGrid
    vehicle: Vehicle
    keep_outs: KeepOuts
    operating: OperatingState
    schedule: Schedule


Objection = Callable[[Controls, Telecommand], str | None]
"""One line on why the command cannot be executed at present; None if it can."""
Action = Callable[[Controls, Telecommand, MissionTime], bool]
"""Executes the command; returns whether it is completed with that. A drive is completed on arrival."""


class CommandHandlers:
    """Takes telecommands through their stages."""

    def __init__(
        self, controls: Controls, registry: CommandRegistry, reporter: Reporter, effects: list[Effect]
    ) -> None:
        self._controls = controls
        self._registry = registry
        self._reporter = reporter
        self._effects = effects

    @property
    def waiting(self) -> bool:
        """Whether accepted commands wait for a safe point."""
        return bool(self._registry.waiting)

    def receive(self, command: Telecommand, header: Header, now: MissionTime) -> None:
        """Accepts the command or rejects it. The same id again is reported on, and never executed again."""
        registry = self._registry
        last_report = registry.reported(command)
        if last_report is not None:
            if registry.differs(command):
                fields = {"command_id": command.command_id}
                cause = Cause(f"{COMMAND.name}: known id", header.source)
                text = "another command under a known id is ignored"
                self._effects.append(LogRecord(Level.WARNING, text, fields, cause))
            else:
                self._reporter.report_command(last_report)
            return
        self._advance(command, CommandStage.RECEIVED, now)
        if is_past(command, now):
            self._advance(command, CommandStage.EXPIRED, now, command.objection or "it came after its time")
            return
        if command.objection is not None:
            self._advance(command, CommandStage.REJECTED, now, command.objection)
            return
        why = registry.overtaken(command, header, now) or self._refusal(command)
        if why is not None:
            self._advance(command, CommandStage.REJECTED, now, why)
            return
        self._advance(command, CommandStage.ACCEPTED, now)
        if command.kind is CommandKind.SET_KEEP_OUT:  # needs no safe point
            self._execute(command, now)
        else:
            registry.waiting.append(command)

    def execute_waiting(self, now: MissionTime) -> None:
        """Executes the accepted commands, oldest first. The rover is at a safe point."""
        waiting = self._registry.waiting
        while waiting:
            command = waiting.popleft()
            if is_past(command, now):
                self._advance(command, CommandStage.EXPIRED, now, "no safe point came in time")
                continue
            why = OBJECTIONS[command.kind](self._controls, command)
            if why is not None:
                self._advance(command, CommandStage.FAILED, now, why)
            else:
                self._execute(command, now)

    def _execute(self, command: Telecommand, now: MissionTime) -> None:
        self._advance(command, CommandStage.STARTED, now)
        if ACTIONS[command.kind](self._controls, command, now):
            self._advance(command, CommandStage.COMPLETED, now)

    def _advance(self, command: Telecommand, stage: CommandStage, now: MissionTime, why: str = "") -> None:
        self._reporter.report_command(self._registry.advance(command, stage, now, why))

    def _refusal(self, command: Telecommand) -> str | None:
        waiting = self._registry.waiting
        if len(waiting) >= MAX_WAITING:
            return f"expected at most {MAX_WAITING} commands waiting, got one more"
        # The commands that wait may change what is true now, so the objection is raised when this one's turn comes.
        if waiting and command.kind not in (CommandKind.SET_KEEP_OUT, CommandKind.GO_TO):
            return None
        return OBJECTIONS[command.kind](self._controls, command)


# --- objections ---------------------------------------------------------------------------------------------------


def _no_objection(controls: Controls, command: Telecommand) -> str | None:
    return None


def _in_safe_mode(controls: Controls, command: Telecommand) -> str | None:
    hold = controls.operating.hold
    if hold in (None, Hold.PAUSE, Hold.ENERGY):
        return None
    return f"the rover is in safe mode already ({hold.value})" if hold else None


def _not_held(controls: Controls, command: Telecommand) -> str | None:
    if controls.operating.hold is None:
        return "expected a rover that is paused or in safe mode, got one that is neither"
    if controls.operating.hold is Hold.ENERGY:
        return "the rover charges, and goes on by itself"
    return None


def _no_round(controls: Controls, command: Telecommand) -> str | None:
    current = controls.schedule.current
    return None if current is not None and current.round else "no round is under way"


def _charging(controls: Controls, command: Telecommand) -> str | None:
    return "the rover charges, its energy is too low to drive" if controls.operating.hold is Hold.ENERGY else None


def _target_closed(controls: Controls, command: Telecommand) -> str | None:
    target = _target(command)
    stray = outside(controls.site, (target,))
    if stray is not None:
        return stray
    if controls.keep_outs.around(target):
        return f"({target[0]:g}, {target[1]:g}) lies within a keep-out"
    # While a step is under way it is not known yet where the drive will begin.
    path = (controls.vehicle.standing_m, target) if controls.operating.interruptible else (target,)
    return controls.keep_outs.objection(path) or _charging(controls, command)


def _no_such_keep_out(controls: Controls, command: Telecommand) -> str | None:
    known = command.area_id in controls.keep_outs
    if command.polygon_m is None and not known:
        return f"there is no keep-out {command.area_id} to remove"
    if command.polygon_m is not None and not known and len(controls.keep_outs) >= MAX_KEEP_OUTS:
        return f"expected at most {MAX_KEEP_OUTS} keep-outs, got one more"
    return None


# --- actions ------------------------------------------------------------------------------------------------------


def _pause(controls: Controls, command: Telecommand, now: MissionTime) -> bool:
    if controls.operating.hold is not Hold.PAUSE:
        controls.operating.hold_for(Hold.PAUSE, now, _by(command))
    return True


def _resume(controls: Controls, command: Telecommand, now: MissionTime) -> bool:
    controls.operating.release(now, _by(command))
    return True


def _abort_round(controls: Controls, command: Telecommand, now: MissionTime) -> bool:
    controls.schedule.abandon(now, _by(command))
    return True


def _safe(controls: Controls, command: Telecommand, now: MissionTime) -> bool:
    if controls.operating.hold is not Hold.COMMAND:
        controls.operating.hold_for(Hold.COMMAND, now, _by(command))
    return True


def _go_to(controls: Controls, command: Telecommand, now: MissionTime) -> bool:
    return _drive(controls, command, (_target(command),), now)


def _return_to_start(controls: Controls, command: Telecommand, now: MissionTime) -> bool:
    return _drive(controls, command, return_path(controls.vehicle.track_m), now)


def _drive(controls: Controls, command: Telecommand, path_m: tuple[Place, ...], now: MissionTime) -> bool:
    controls.schedule.abandon(now, _by(command))
    controls.operating.release(now, _by(command))
    controls.schedule.begin(Activity((Leg(path_m, None),), command=command))
    return False


def _set_keep_out(controls: Controls, command: Telecommand, now: MissionTime) -> bool:
    name = str(command.area_id)
    if command.polygon_m is None:
        controls.keep_outs.open(name)
    else:
        controls.keep_outs.close(name, command.polygon_m)
    return True


def _by(command: Telecommand) -> str:
    return f"{command.kind.value} {command.command_id}"


def _target(command: Telecommand) -> Place:
    assert command.target_m is not None  # the schema refuses a go_to without a target
    return command.target_m


OBJECTIONS: Final[dict[CommandKind, Objection]] = {
    CommandKind.PAUSE: _in_safe_mode,
    CommandKind.RESUME: _not_held,
    CommandKind.ABORT_ROUND: _no_round,
    CommandKind.GO_TO: _target_closed,
    CommandKind.SET_KEEP_OUT: _no_such_keep_out,
    CommandKind.RETURN_TO_START: _charging,
    CommandKind.SAFE: _no_objection,
}

ACTIONS: Final[dict[CommandKind, Action]] = {
    CommandKind.PAUSE: _pause,
    CommandKind.RESUME: _resume,
    CommandKind.ABORT_ROUND: _abort_round,
    CommandKind.GO_TO: _go_to,
    CommandKind.SET_KEEP_OUT: _set_keep_out,
    CommandKind.RETURN_TO_START: _return_to_start,
    CommandKind.SAFE: _safe,
}

"""Telecommands, judged when they come and carried out at the next safe point: one row a kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from he3.frames import Place
from schemas.commands import CommandKind, CommandStage, Telecommand
from schemas.wire import Header
from services.rover.activities import Activity, Leg
from services.rover.admission import closed_off, outside
from services.rover.command_registry import MAX_WAITING, is_past
from services.rover.executive import Executive
from services.rover.geometry import Area
from services.rover.states import Hold
from services.rover.track import way_home
from services.runtime.node import Level, LogRecord, MissionTime

MAX_AREAS: Final = 100

Objection = Callable[[Executive, Telecommand], str | None]
Action = Callable[[Executive, Telecommand, MissionTime], bool]
"""Whether the command is completed with that; an errand completes when it is done."""


def take(executive: Executive, command: Telecommand, header: Header, now: MissionTime) -> None:
    """Receives a telecommand and reports what becomes of it; the same id again is reported on, never executed again."""
    table = executive.commands
    earlier = table.reported(command)
    if earlier is not None:
        if table.differs(command):
            executive.out.append(
                LogRecord(
                    Level.WARNING, "another command under a known id is ignored", {"command_id": command.command_id}
                )
            )
        else:
            executive.reporter.report(earlier)
        return
    _pass(executive, command, CommandStage.RECEIVED, now)
    if is_past(command, now):
        _pass(executive, command, CommandStage.EXPIRED, now, "it came after its time")
        return
    why = table.overtaken(command, header) or _refusal(executive, command)
    if why is not None:
        _pass(executive, command, CommandStage.REJECTED, now, why)
        return
    _pass(executive, command, CommandStage.ACCEPTED, now)
    if command.kind is CommandKind.SET_KEEP_OUT:  # the rover need not stand still for it
        _start(executive, command, now)
        return
    table.waiting.append(command)
    if executive.interruptible:
        executive.proceed(now)


def carry_out_waiting(executive: Executive, now: MissionTime) -> None:
    """Carries out what was accepted, oldest first; the rover is at a safe point."""
    waiting = executive.commands.waiting
    while waiting:
        command = waiting.popleft()
        if is_past(command, now):
            _pass(executive, command, CommandStage.EXPIRED, now, "no safe point came in time")
            continue
        why = OBJECTIONS[command.kind](executive, command)
        if why is not None:
            _pass(executive, command, CommandStage.FAILED, now, why)
        else:
            _start(executive, command, now)


def _start(executive: Executive, command: Telecommand, now: MissionTime) -> None:
    _pass(executive, command, CommandStage.STARTED, now)
    if ACTIONS[command.kind](executive, command, now):
        _pass(executive, command, CommandStage.COMPLETED, now)


def _pass(executive: Executive, command: Telecommand, stage: CommandStage, now: MissionTime, why: str = "") -> None:
    executive.reporter.report(executive.commands.passed(command, stage, now, why))


def _refusal(executive: Executive, command: Telecommand) -> str | None:
    waiting = executive.commands.waiting
    if len(waiting) >= MAX_WAITING:
        return f"expected at most {MAX_WAITING} commands waiting, got one more"
    # What is true now may change with those that wait; then the question is asked when its turn comes.
    if waiting and command.kind not in (CommandKind.SET_KEEP_OUT, CommandKind.GO_TO):
        return None
    return OBJECTIONS[command.kind](executive, command)


# --- what speaks against each -------------------------------------------------------------------------------------


def _never(executive: Executive, command: Telecommand) -> str | None:
    return None


def _safe_already(executive: Executive, command: Telecommand) -> str | None:
    if executive.hold in (None, Hold.PAUSE, Hold.ENERGY):
        return None
    return f"the rover is in safe mode already ({executive.hold.value})" if executive.hold else None


def _nothing_held(executive: Executive, command: Telecommand) -> str | None:
    if executive.hold is None:
        return "expected a rover that is paused or in safe mode, got one that is neither"
    if executive.hold is Hold.ENERGY:
        return "the rover charges, and goes on by itself"
    return None


def _no_round(executive: Executive, command: Telecommand) -> str | None:
    return None if executive.job is not None and executive.job.round else "no round is under way"


def _cannot_drive(executive: Executive, command: Telecommand) -> str | None:
    return "the rover charges, its energy is too low to drive" if executive.hold is Hold.ENERGY else None


def _target_closed(executive: Executive, command: Telecommand) -> str | None:
    target = _target(command)
    stray = outside(executive.site, (target,))
    if stray is not None:
        return stray
    way = (executive.vehicle.standing_m, target) if executive.interruptible else (target,)
    margin = executive.config.footprint_radius_m
    if any(area.is_near(target, target, margin) for area in executive.areas.values()):
        return f"({target[0]:g}, {target[1]:g}) lies within a keep-out"
    return closed_off(way, executive.areas, margin) or _cannot_drive(executive, command)


def _no_such_area(executive: Executive, command: Telecommand) -> str | None:
    known = command.area_id in executive.areas
    if command.polygon_m is None and not known:
        return f"there is no keep-out {command.area_id} to remove"
    if command.polygon_m is not None and not known and len(executive.areas) >= MAX_AREAS:
        return f"expected at most {MAX_AREAS} keep-outs, got one more"
    return None


# --- what each does -----------------------------------------------------------------------------------------------


def _pause(executive: Executive, command: Telecommand, now: MissionTime) -> bool:
    if executive.hold is not Hold.PAUSE:
        executive.hold_for(Hold.PAUSE, now, _by(command))
    return True


def _resume(executive: Executive, command: Telecommand, now: MissionTime) -> bool:
    executive.release(now, _by(command))
    return True


def _abort_round(executive: Executive, command: Telecommand, now: MissionTime) -> bool:
    executive.abandon(now, _by(command))
    return True


def _safe(executive: Executive, command: Telecommand, now: MissionTime) -> bool:
    if executive.hold is not Hold.COMMAND:
        executive.hold_for(Hold.COMMAND, now, _by(command))
    return True


def _go_to(executive: Executive, command: Telecommand, now: MissionTime) -> bool:
    return _errand(executive, command, (_target(command),), now)


def _return_to_start(executive: Executive, command: Telecommand, now: MissionTime) -> bool:
    return _errand(executive, command, way_home(executive.vehicle.track_m), now)


def _errand(executive: Executive, command: Telecommand, way: tuple[Place, ...], now: MissionTime) -> bool:
    executive.abandon(now, _by(command))
    executive.release(now, _by(command))
    executive.start(Activity((Leg(way, None),), command_id=command.command_id))
    return False


def _set_keep_out(executive: Executive, command: Telecommand, now: MissionTime) -> bool:
    name = str(command.area_id)
    executive.areas.pop(name, None)
    if command.polygon_m is not None:
        executive.areas[name] = Area.within(command.polygon_m)
    return True


def _by(command: Telecommand) -> str:
    return f"{command.kind.value} {command.command_id}"


def _target(command: Telecommand) -> Place:
    assert command.target_m is not None  # a go_to without one is refused at the edge
    return command.target_m


OBJECTIONS: Final[dict[CommandKind, Objection]] = {
    CommandKind.PAUSE: _safe_already,
    CommandKind.RESUME: _nothing_held,
    CommandKind.ABORT_ROUND: _no_round,
    CommandKind.GO_TO: _target_closed,
    CommandKind.SET_KEEP_OUT: _no_such_area,
    CommandKind.RETURN_TO_START: _cannot_drive,
    CommandKind.SAFE: _never,
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

"""The telecommands that the rover has received. Each is executed at most once, in the order in which it was made."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from schemas.commands import CommandKind, CommandReport, CommandStage, Telecommand

if TYPE_CHECKING:
    from schemas.wire import Header
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState

MAX_WAITING: Final = 32
MAX_REMEMBERED: Final = 10_000  # commands whose ids are kept; a mission sends hundreds
MAX_WHY: Final = 500  # characters of a reason; the limit of the message's field

STAGES: Final[dict[CommandStage | None, frozenset[CommandStage]]] = {
    None: frozenset({CommandStage.RECEIVED}),
    CommandStage.RECEIVED: frozenset({CommandStage.ACCEPTED, CommandStage.REJECTED, CommandStage.EXPIRED}),
    CommandStage.ACCEPTED: frozenset({CommandStage.STARTED, CommandStage.FAILED, CommandStage.EXPIRED}),
    CommandStage.STARTED: frozenset({CommandStage.COMPLETED, CommandStage.FAILED}),
}
"""Which stage may follow which on the rover; a stage that is not a key here ends the command."""


class IllegalStage(Exception):
    """The program moved a command to a stage that cannot follow: an error in the program, not in its input."""


@dataclass(slots=True)
class CommandRegistry:
    """Every command received with its last report, and the accepted ones that wait for the next safe point."""

    waiting: deque[Telecommand] = field(default_factory=deque)
    _known: OrderedDict[str, tuple[Telecommand, CommandReport]] = field(default_factory=OrderedDict)
    _newest: dict[str, tuple[tuple[int, int, int], str]] = field(default_factory=dict)

    def reported(self, command: Telecommand) -> CommandReport | None:
        """The last report on a command of the same id; None if it is new."""
        known = self._known.get(command.command_id)
        return known and known[1]

    def differs(self, command: Telecommand) -> bool:
        """Whether another command is known under the same id."""
        known = self._known.get(command.command_id)
        return known is not None and known[0].order != command.order

    def advance(self, command: Telecommand, stage: CommandStage, now: MissionTime, why: str = "") -> CommandReport:
        """The report that the command has reached that stage; raises IllegalStage, naming both, if it cannot follow."""
        known = self._known.get(command.command_id)
        before = known[1].stage if known else None
        if stage not in STAGES.get(before, frozenset()):
            raise IllegalStage(f"rover: command {command.command_id} is {before or 'new'} and cannot be {stage} next")
        report = CommandReport(command_id=command.command_id, stage=stage, at=now, why=why[:MAX_WHY])
        self._known[command.command_id] = (command, report)
        if len(self._known) > MAX_REMEMBERED:
            ended = (key for key, (_, last) in self._known.items() if last.stage not in STAGES)
            self._known.pop(next(ended, command.command_id))
        return report

    def overtaken(self, command: Telecommand, header: Header, now: MissionTime) -> str | None:
        """One line on the command that was made later but came earlier; None if there is none.

        The newest command counts: a pause that arrives after the resume that should end it would hold the rover for
        ever. Commands on motion are ordered among themselves, and those on each keep-out; `safe` is never outdated.
        No command was made after it came, so a time from the future rejects later commands for one light time at most.
        """
        if command.kind is CommandKind.SAFE:
            return None
        subject = f"area {command.area_id}" if command.kind is CommandKind.SET_KEEP_OUT else "motion"
        made = (min(header.made_at, now), header.incarnation, header.sequence)
        newest = self._newest.get(subject)
        if newest is not None and newest[0] > made:
            return f"{newest[1]} was made later and came first"
        self._newest[subject] = (made, f"{command.kind} {command.command_id}")
        return None

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {"waiting": deque(self.waiting), "known": dict(self._known), "newest": dict(self._newest)}

    def restore(self, state: SavedState) -> None:
        """Restore the registry from this state."""
        self.waiting = state["waiting"]
        self._known = OrderedDict(state["known"])
        self._newest = state["newest"]


def is_past(command: Telecommand, now: MissionTime) -> bool:
    """Whether the command, or the consent to it, has expired; at the very instant of its expiry it may still start."""
    consent = command.authorization
    return (command.expires_at is not None and now > command.expires_at) or (
        consent is not None and now > consent.expires_at
    )

"""The telecommands that the rover has received: each is executed at most once, in the order in which it was made."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field
from typing import Final

from schemas.commands import CommandKind, CommandReport, CommandStage, Telecommand
from schemas.wire import Header
from services.runtime.node import MissionTime

MAX_WAITING: Final = 32
MAX_REMEMBERED: Final = 10_000  # commands whose ids are known; a mission sees hundreds
MAX_WHY: Final = 500  # characters of a reason, as the message admits

STAGES: Final[dict[CommandStage | None, frozenset[CommandStage]]] = {
    None: frozenset({CommandStage.RECEIVED}),
    CommandStage.RECEIVED: frozenset({CommandStage.ACCEPTED, CommandStage.REJECTED, CommandStage.EXPIRED}),
    CommandStage.ACCEPTED: frozenset({CommandStage.STARTED, CommandStage.FAILED, CommandStage.EXPIRED}),
    CommandStage.STARTED: frozenset({CommandStage.COMPLETED, CommandStage.FAILED}),
}
"""The stages on the rover, and which may follow which; those that are no key end a command."""


class IllegalStage(Exception):
    """The program moved a command to a stage that cannot follow: a mistake in it, not a reaction to input."""


@dataclass(slots=True)
class CommandRegistry:
    """Every command received, its last report, and those accepted that wait for the next safe point."""

    waiting: deque[Telecommand] = field(default_factory=deque)
    _known: OrderedDict[str, tuple[Telecommand, CommandReport]] = field(default_factory=OrderedDict)
    _newest: dict[str, tuple[tuple[int, int, int], str]] = field(default_factory=dict)

    def reported(self, command: Telecommand) -> CommandReport | None:
        """The last report on a command of the same id; None if it is new."""
        known = self._known.get(command.command_id)
        return known and known[1]

    def differs(self, command: Telecommand) -> bool:
        """Whether the id is known for another command than this one."""
        known = self._known.get(command.command_id)
        return known is not None and known[0] != command

    def passed(self, command: Telecommand, stage: CommandStage, now: MissionTime, why: str = "") -> CommandReport:
        """The report that the command has passed that stage; raises IllegalStage, naming both, for any other order."""
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

    def find(self, command_id: str) -> Telecommand:
        """The command of that id; it must be known."""
        return self._known[command_id][0]

    def overtaken(self, command: Telecommand, header: Header) -> str | None:
        """One line naming the command that was made later but came earlier; None if there is none.

        The operator's newest word counts: a pause that arrives after the resume that was meant to end it would hold
        the rover for good. Each keep-out area is a matter of its own; going safe is never out of date.
        """
        if command.kind is CommandKind.SAFE:
            return None
        matter = f"area {command.area_id}" if command.kind is CommandKind.SET_KEEP_OUT else "motion"
        made = (header.made_at, header.incarnation, header.sequence)
        newest = self._newest.get(matter)
        if newest is not None and newest[0] > made:
            return f"{newest[1]} was made later and came first"
        self._newest[matter] = (made, f"{command.kind} {command.command_id}")
        return None


def is_past(command: Telecommand, now: MissionTime) -> bool:
    """Whether the command has expired: it may still be started at the very instant at which it expires."""
    return command.expires_at is not None and now > command.expires_at

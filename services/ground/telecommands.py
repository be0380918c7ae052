"""Telecommands: issued by the operator, sent to the rover, followed until they end.

A command's departure from Earth is read from the link's status, which the ground asks for while one has not left. Where
there is no link, nothing answers and the stage is not reported.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from schemas.commands import (
    ENDS,
    CommandKind,
    CommandList,
    CommandReport,
    CommandStage,
    CommandStatus,
    NoParameters,
    Telecommand,
)
from schemas.link import LinkStatus
from schemas.topics import COMMAND, COMMAND_STATUS, LINK_SHOW
from services.ground.authority import CommandAuthority
from services.ground.command_history import LOOK_AGAIN_S, CommandHistory
from services.mission.mission_time import MissionTime, seconds
from services.runtime.node import Effect, Level, LogRecord, RefuseQuery, Send, SendQuery, SendReply, SetTimer

if TYPE_CHECKING:
    from services.ground.director import Director
    from services.mission.scenario import Scenario
    from services.runtime.node import SavedState

LOOK_QUERY, LOOK_TIMER = "commands-on-the-link", "look"
LOST_TIMER = "lost:"
"""Prefix of the timer at whose time a command without a report counts as lost; its id follows."""
_EXCURSIONS = frozenset({CommandKind.GO_TO, CommandKind.RETURN_TO_START})


class TelecommandHandler:
    """Issues telecommands, follows them, and tells the director of those that change what is planned."""

    def __init__(
        self, scenario: Scenario, source: str, history: CommandHistory, director: Director, authority: CommandAuthority
    ) -> None:
        """source: name of this service in message headers."""
        self._start_m = scenario.start_m
        self._keep_outs = scenario.ground.keep_outs
        self._source = source
        self._history = history
        self._authority = authority
        self._director = director

    def restarted(self) -> None:
        """Note a start of the process."""
        self._history.restarted()

    def listed(self) -> CommandList:
        """The newest commands with their stages."""
        return CommandList(commands=self._history.listed())

    @property
    def holds_rover(self) -> bool:
        """Whether a command of the operator holds the rover still."""
        return self._history.holds_rover

    def issue(self, command: Telecommand, token: int, now: MissionTime) -> Iterable[Effect]:
        """Answer the operator's query with the command's status or a refusal, and send the command if it is new."""
        try:
            if not self._history.knows(command):
                self._expect_sound(command)
            status, new = self._history.issue(command, now)
        except InvalidInput as error:
            yield RefuseQuery(token, str(error))
            return
        yield SendReply(token, status)
        if new:
            self._authority.commanded(command, now)
            yield from self._sent(status, now)

    def recall(self, now: MissionTime) -> Iterable[Effect]:
        """Send the command that recalls the rover's rounds, if the director wants one."""
        command = self._director.recall.due()
        if command is None:
            return
        try:
            status, _ = self._history.issue(command, now)
        except InvalidInput as error:
            yield LogRecord(Level.WARNING, f"the rounds on board are not recalled: {error}")
            yield from self._director.command_ended(command.command_id, False, now)
            return
        yield from self._sent(status, now)

    def _sent(self, status: CommandStatus, now: MissionTime) -> Iterable[Effect]:
        command = status.command
        yield Send(COMMAND, command)
        yield from self.look()
        overdue = self._history.overdue_at(command)
        if overdue is not None:
            yield SetTimer(LOST_TIMER + command.command_id, overdue)
        yield Send(COMMAND_STATUS, status)
        yield from self._set_keep_out(command, now)

    def _expect_sound(self, command: Telecommand) -> None:
        """Raise InvalidInput, in one line, unless its sender may command and the way that it orders is open."""
        if (why := self._authority.objection(command)) is not None:
            raise InvalidInput(why)
        if command.target_m is not None and (why := self._director.objection_to_visit(command.target_m)) is not None:
            raise InvalidInput(f"command {command.command_id}: {why}")

    def reported(self, report: CommandReport, now: MissionTime) -> Iterable[Effect]:
        """Handle a rover's report on a command."""
        status = self._history.report(report)
        if status is None:
            return
        yield Send(COMMAND_STATUS, status)
        passed = {known.stage for known in status.stages}
        if report.stage is CommandStage.RECEIVED and CommandStage.RADIATED not in passed:
            yield SendQuery(LINK_SHOW, NoParameters(), LOOK_QUERY)  # it left between two looks
        command = status.command
        if report.stage in ENDS:
            yield from self._set_keep_out(command, now)
            carried_out = report.stage is CommandStage.COMPLETED
            yield from self._director.command_ended(command.command_id, carried_out, now)
        if command.kind in _EXCURSIONS:
            yield from self._follow_excursion(status, report.stage, now)

    def look(self) -> Iterable[Effect]:
        """Ask the link whether the commands that were sent have left the Earth, if there are any."""
        if self._history.leaving():
            yield SendQuery(LINK_SHOW, NoParameters(), LOOK_QUERY)

    def seen_on_link(self, link: LinkStatus, now: MissionTime) -> Iterable[Effect]:
        """Handle the link's answer."""
        left, again = self._history.seen_on_link(link, self._source, now)
        for departed in left:
            yield Send(COMMAND_STATUS, departed)
        if self._history.leaving():
            yield SetTimer(LOOK_TIMER, again)

    def look_failed(self, now: MissionTime) -> Iterable[Effect]:
        """Handle a missing answer of the link."""
        yield SetTimer(LOOK_TIMER, now + seconds(LOOK_AGAIN_S))

    def overdue(self, command_id: str, now: MissionTime) -> Iterable[Effect]:
        """Handle the expiry of a command: without a report it counts as lost."""
        status = self._history.give_up(command_id, now)
        if status is not None:
            yield Send(COMMAND_STATUS, status)

    def _set_keep_out(self, command: Telecommand, now: MissionTime) -> Iterable[Effect]:
        """Close the area of a command at once; open an area when the rover has carried out the command."""
        if command.kind is CommandKind.SET_KEEP_OUT and command.area_id is not None:
            at_first = self._keep_outs.get(command.area_id)
            polygons = self._history.closed_by(command.area_id, () if at_first is None else (at_first,))
            yield from self._director.keep_out(command.area_id, polygons, now)

    def _follow_excursion(self, status: CommandStatus, stage: CommandStage, now: MissionTime) -> Iterable[Effect]:
        command = status.command
        if stage is CommandStage.STARTED and status.end is None:
            self._director.excursion_begun(command.command_id)
        elif stage is CommandStage.COMPLETED:
            target = command.target_m if command.target_m is not None else self._start_m
            self._director.excursion_begun(command.command_id)  # it is over, even if its begin was never reported
            yield from self._director.excursion_ended(command.command_id, target, now)
        elif stage in ENDS:
            yield from self._director.excursion_ended(command.command_id, None, now)

    def checkpoint(self) -> SavedState:
        """The command history, as named parts."""
        return self._history.checkpoint()

    def restore(self, state: SavedState) -> None:
        """Restore the handler from this state."""
        self._history.restore(state)

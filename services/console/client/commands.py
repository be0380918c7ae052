"""Telecommands: how one is issued, and the handle that follows it through its stages."""

from __future__ import annotations

import queue
import time
import uuid
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from he3.errors import InvalidInput, OutcomeUnknown, PeerUnreachable
from schemas.authority import AuthorityAction, AuthorityChange, AuthorityState
from schemas.commands import CommandKind, CommandList, CommandStage, CommandStatus, NoParameters, Telecommand
from schemas.topics import COMMAND_STATUS, ISSUE_COMMAND, LIST_COMMANDS, SET_AUTHORITY, SHOW_AUTHORITY
from schemas.validation import one_line
from services.console.client.clock import ClockQueries
from services.console.client.person import Acting
from services.mission.mission_time import seconds

if TYPE_CHECKING:
    from schemas.wire import Header
    from services.console.client.map_queries import Polygon
    from services.runtime.transport.client import Client

MAX_EXPIRY_S = 1e9
"""Longest time for which a command may stay valid [s]: 30 years."""
ASK_AGAIN_S = 1.0
"""Wall time without a report after which the list of commands is queried, because a report may be lost."""


class CommandHandle:
    """A telecommand that was issued."""

    def __init__(self, session: Client, status: CommandStatus) -> None:
        self._session = session
        self.status = status
        """The command and the stages that it has passed, as last reported."""

    @property
    def command_id(self) -> str:
        return self.status.command.command_id

    @property
    def stages(self) -> tuple[CommandStage, ...]:
        """The stages passed so far, as last reported."""
        return tuple(report.stage for report in self.status.stages)

    def wait(self, stage: CommandStage | str = CommandStage.COMPLETED, timeout_s: float = 60.0) -> CommandStatus:
        """The status once the command has reached that stage or a later one, or has ended; see `CommandStatus.end`.

        timeout_s: wall time. Raises PeerUnreachable when it runs out, InvalidInput for a stage that does not exist.
        """
        wanted = stage_named(stage)
        deadline = time.monotonic() + timeout_s
        heard: queue.SimpleQueue[CommandStatus] = queue.SimpleQueue()

        def keep(_: Header, status: CommandStatus) -> None:
            if status.command.command_id == self.command_id:
                heard.put(status)

        end = self._session.subscribe(COMMAND_STATUS, keep)
        try:
            self._ask()  # a report between the issue and the subscription is in the list
            while not self.status.has_reached(wanted):
                left = deadline - time.monotonic()
                if left <= 0:
                    raise PeerUnreachable(
                        f"command {self.command_id}: expected {wanted.value} within {timeout_s:g} s, got "
                        f"{self.stages[-1].value if self.stages else 'no report'} so far"
                    )
                try:
                    self._take(heard.get(timeout=min(ASK_AGAIN_S, left)))
                except queue.Empty:
                    self._ask()
        finally:
            end()
        return self.status

    def _ask(self) -> None:
        listed: CommandList = self._session.query(LIST_COMMANDS, NoParameters())
        for status in listed.commands:
            if status.command.command_id == self.command_id:
                self._take(status)

    def _take(self, status: CommandStatus) -> None:
        if len(status.stages) >= len(self.status.stages):  # reports are only ever added
            self.status = status


class Commanding(ClockQueries, Acting):
    """The part of `MissionClient` that sends telecommands."""

    _session: Client

    def command(
        self,
        kind: CommandKind | str,
        *,
        target_m: tuple[float, float] | None = None,
        area_id: str | None = None,
        polygon_m: Polygon | None = None,
        expires_in_s: float | None = None,
        command_id: str | None = None,
    ) -> CommandHandle:
        """Send a telecommand; the handle follows it through its stages. Equal ids execute once.

        expires_in_s: mission time from now after which the rover does not execute it any more. Raises InvalidInput or
        He3Error, in one line, for a command that cannot be sent, and OutcomeUnknown, with its id, for one that may have
        been.
        """
        command = telecommand(
            kind, target_m=target_m, area_id=area_id, polygon_m=polygon_m, command_id=command_id
        )  # checked before the clock is asked
        valid_s = None if expires_in_s is None else _duration_s(expires_in_s)
        if valid_s is not None:
            expires_at = self.now() + seconds(valid_s)
            command = _checked(command.model_dump() | {"expires_at": expires_at})
        if self.identity is None:
            command = command.model_copy(update={"issued_by": self.person})
        try:
            status = self._session.query(ISSUE_COMMAND, command)
        except InvalidInput as refusal:
            raise InvalidInput(without_id(str(refusal), command)) from None
        except OutcomeUnknown as silence:
            raise OutcomeUnknown(f"command {command.command_id}: {silence}") from None
        return CommandHandle(self._session, status)

    def authority(self) -> AuthorityState:
        """Who holds command authority."""
        state: AuthorityState = self._session.query(SHOW_AUTHORITY, NoParameters())
        return state

    def take_authority(self, over_from: str | None = None) -> AuthorityState:
        """Take command authority: others' commands are refused then, but `safe`.

        over_from: the present holder, to take it over from them. Raises InvalidInput while another person holds it.
        """
        return self._change_authority(AuthorityAction.TAKE, over_from)

    def release_authority(self) -> AuthorityState:
        """Release command authority. Raises InvalidInput if another person holds it."""
        return self._change_authority(AuthorityAction.RELEASE, None)

    def _change_authority(self, action: AuthorityAction, over_from: str | None) -> AuthorityState:
        try:
            change = AuthorityChange(action=action, by=self.person, over_from=over_from)
        except ValidationError as error:
            raise InvalidInput(f"authority: {one_line(error)}") from None
        state: AuthorityState = self._session.query(SET_AUTHORITY, change)
        return state

    def commands(self) -> tuple[CommandStatus, ...]:
        """All commands with the stages they passed, oldest first."""
        listed: CommandList = self._session.query(LIST_COMMANDS, NoParameters())
        return listed.commands


def _duration_s(value: object) -> float:
    """The value, if it is a number of seconds; a list would be multiplied, too. Raises InvalidInput for another."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= MAX_EXPIRY_S:
        raise InvalidInput(
            f"command: expires_in_s: expected seconds over 0 and up to {MAX_EXPIRY_S:g}, got {value!r:.60}"
        )
    return value


def new_command_id() -> str:
    """An id that no other command has."""
    return f"op-{uuid.uuid4().hex[:10]}"


def telecommand(
    kind: CommandKind | str,
    *,
    target_m: tuple[float, float] | None = None,
    area_id: str | None = None,
    polygon_m: Polygon | None = None,
    command_id: str | None = None,
) -> Telecommand:
    """The telecommand with these values, and a new id if none is given; raises InvalidInput with one line."""
    try:
        known = CommandKind(str(kind).replace("-", "_"))
    except ValueError:
        kinds = ", ".join(each.value for each in CommandKind)
        raise InvalidInput(f"command: expected one of {kinds}; got '{kind}'") from None
    return _checked(
        {
            "command_id": command_id or new_command_id(),
            "kind": known,
            "target_m": None if target_m is None else tuple(map(float, target_m)),
            "area_id": area_id,
            "polygon_m": None if polygon_m is None else tuple((float(x), float(y)) for x, y in polygon_m),
        }
    )


def without_id(said: str, command: Telecommand) -> str:
    """The ground's refusal of a command, without the command's id.

    The operator never saw the id of a command that was not sent.
    """
    return said.removeprefix(f"command {command.command_id}: ")


def _checked(values: dict[str, Any]) -> Telecommand:
    try:
        return Telecommand(**values)
    except ValidationError as error:
        raise InvalidInput(f"command: {one_line(error)}") from None


def stage_named(stage: CommandStage | str) -> CommandStage:
    """The stage of that name; raises InvalidInput, listing the names, for an unknown one."""
    try:
        return CommandStage(stage)
    except ValueError:
        known = ", ".join(each.value for each in CommandStage)
        raise InvalidInput(f"expected a stage out of {known}; got '{stage}'") from None

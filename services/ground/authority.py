"""Command authority: one holder at a time, whose commands alone go to the rover.

While no one holds it, the sender of the next command becomes its holder. In a mission with keys, the commands of others
are refused from then on. In a mission without keys a name is not proven, and one person may use several terminals:
until `take`, each sender of a command becomes the holder. The command `safe` is accepted from every sender.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from schemas.authority import AuthorityAction, AuthorityChange, AuthorityState
from schemas.commands import CommandKind, Telecommand
from services.runtime.node import Effect, Level, LogRecord, RefuseQuery, SendReply

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState

RELEASE_HINT = "he3 authority take --force"


class CommandAuthority:
    """The holder, and who may command."""

    def __init__(self) -> None:
        self.state = AuthorityState()
        self._proven = False

    def objection(self, command: Telecommand) -> str | None:
        """One line on why the sender of this command may not command now; None if they may."""
        if command.kind is CommandKind.SAFE:
            return None
        name = name_of(command)
        return self.objection_to(name, f"command {command.command_id} of {name or 'a sender without a name'}")

    def objection_to(self, name: str, what: str) -> str | None:
        """One line on why a person of that name may not do that now; None if they may."""
        holder, firm = self.state.holder, self.state.explicit or self._proven
        if holder is None or name == holder or not firm:
            return None
        return f"{what}: expected the holder of command authority, {holder} ({RELEASE_HINT} {holder})"

    def commanded(self, command: Telecommand, now: MissionTime) -> None:
        """Note a command that was sent. Its sender becomes the holder, unless the present one keeps others out."""
        holder, name = self.state.holder, name_of(command)
        firm = self.state.explicit or self._proven
        if name and name != holder and (holder is None or not firm):
            self.state = AuthorityState(holder=name, since=now)
            self._proven = command.authorization is not None

    def answer(self, change: AuthorityChange, token: int, now: MissionTime) -> Iterable[Effect]:
        """Make the change, and answer the query for it with the state after it, or with a refusal."""
        earlier = self.state.holder
        try:
            state = self.change(change, now)
        except InvalidInput as error:
            yield RefuseQuery(token, str(error))
            return
        yield SendReply(token, state)
        fields = {"holder": state.holder or "none", "earlier": earlier or "none"}
        yield LogRecord(Level.INFO, "command authority", fields)

    def change(self, change: AuthorityChange, now: MissionTime) -> AuthorityState:
        """The state after that change; raises InvalidInput, in one line, for one that is not to be made."""
        holder = self.state.holder
        if change.action is AuthorityAction.RELEASE:
            if holder not in (None, change.by):
                raise InvalidInput(f"authority: expected its holder, {holder}, to release it, got {change.by}")
            self.state, self._proven = AuthorityState(), False
            return self.state
        firm = self.state.explicit or self._proven
        if change.over_from is not None and change.over_from != holder:
            raise InvalidInput(
                f"authority: expected the name of its present holder, {holder or 'no one'}, got {change.over_from}"
            )
        if holder not in (None, change.by) and firm and change.over_from is None:
            raise InvalidInput(f"authority: held by {holder}: to take it over, {RELEASE_HINT} {holder}")
        same = holder == change.by and self.state.explicit
        self.state = AuthorityState(holder=change.by, since=self.state.since if same else now, explicit=True)
        return self.state

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {"state": self.state, "proven": self._proven}

    def restore(self, state: SavedState) -> None:
        """Restore the authority from this state."""
        self.state, self._proven = state["state"], state["proven"]


def name_of(command: Telecommand) -> str:
    """The name under which the sender of a command holds authority; empty if they gave none."""
    return command.authorization.signer if command.authorization is not None else command.issued_by or ""

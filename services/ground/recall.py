"""The recall of the rover's rounds, which are of no more use once the mission's goal holds.

A recall is the telecommand that aborts a round: the rover stops at its next safe point, and drops the rounds behind it.
What it has measured until then still arrives. A recall that comes when no round is under way is rejected. It is sent
again only if another round turns out to have begun. What is not recalled is waited for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.commands import CommandKind, Telecommand

if TYPE_CHECKING:
    from services.ground.round_record import RoundRecord
    from services.runtime.node import SavedState

ISSUED_BY = "ground"


class RoundRecall:
    """The recall that is wanted or under way, and the round for which it was sent."""

    def __init__(self) -> None:
        self._sent = 0
        self._sent_for = (0, 0, False)
        """Number and revision of the round, and whether it was known to have begun."""
        self._wanted: Telecommand | None = None
        self._under_way: str | None = None

    def want(self, record: RoundRecord) -> bool:
        """Ask that the rover gives up that round; returns whether a command is to be sent for it."""
        sent_for = record.number, record.introduced, record.begun
        if self._under_way is not None or sent_for <= self._sent_for:
            return False
        self._sent += 1
        self._sent_for = sent_for
        self._under_way = f"{ISSUED_BY}-recall-{self._sent}"
        self._wanted = Telecommand(command_id=self._under_way, kind=CommandKind.ABORT_ROUND, issued_by=ISSUED_BY)
        return True

    @property
    def under_way(self) -> bool:
        """Whether the end of a recall is still to be reported."""
        return self._under_way is not None

    def due(self) -> Telecommand | None:
        """The command that is to be sent now; None if there is none, and from then on."""
        wanted, self._wanted = self._wanted, None
        return wanted

    def ended(self, command_id: str, carried_out: bool) -> bool:
        """Note the end of that command; returns whether it was the recall under way.

        carried_out: the round is given up, even if its begin and its end are still to be reported.
        """
        if command_id != self._under_way:
            return False
        self._under_way = None
        if carried_out:
            self._sent_for = (*self._sent_for[:2], True)
        return True

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "sent": self._sent,
            "sent_for": self._sent_for,
            "wanted": self._wanted,
            "under_way": self._under_way,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the recall from this state."""
        self._sent, self._sent_for = state["sent"], state["sent_for"]
        self._wanted, self._under_way = state["wanted"], state["under_way"]

"""Moves of the rover that the operator commands: while one is under way, no round is planned."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from services.runtime.node import SavedState


class Excursions:
    """The go-to and return-to-start commands that the rover has begun and not ended."""

    def __init__(self) -> None:
        self._commands: set[str] = set()

    @property
    def under_way(self) -> bool:
        return bool(self._commands)

    def begin(self, command_id: str) -> None:
        """Note that the rover has begun that command."""
        self._commands.add(command_id)

    def end(self, command_id: str) -> bool:
        """Note the end of that command; returns whether it was under way."""
        if command_id not in self._commands:
            return False
        self._commands.discard(command_id)
        return True

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "commands": set(self._commands),
        }

    def restore(self, state: SavedState) -> None:
        """Restore the excursions from this state."""
        self._commands = state["commands"]

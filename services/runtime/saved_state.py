"""What an object keeps over a restart, and the contract of objects that keep something."""

from __future__ import annotations

from typing import Any, Protocol

SavedState = dict[str, Any]
"""What an object keeps of itself: named parts, each of which the codec can encode."""


class Stateful(Protocol):
    """An object that names what it keeps."""

    def checkpoint(self) -> SavedState:
        """All that a new object of the same making needs to become this one."""

    def restore(self, state: SavedState) -> None:
        """Become the object that had this state."""

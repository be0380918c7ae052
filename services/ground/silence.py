"""Watches for silence of the rover."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.mission.mission_time import SECOND, MissionTime, seconds
from services.runtime.node import Level, LogRecord

if TYPE_CHECKING:
    from services.runtime.node import SavedState


class SilenceWatch:
    """When the rover was last heard from; a silence that is too long is reported once."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout = seconds(timeout_s)
        self._heard_at: MissionTime | None = None
        self.silent = False
        """Whether the rover is reported as silent."""

    @property
    def ever_heard(self) -> bool:
        return self._heard_at is not None

    def lasts_s(self, now: MissionTime) -> float | None:
        """Seconds since the rover was last heard from; None if it never was."""
        return None if self._heard_at is None else (now - self._heard_at) / SECOND

    def heard(self, now: MissionTime) -> None:
        """Note the arrival of a rover's message."""
        self._heard_at = now
        self.silent = False

    def check(self, now: MissionTime) -> list[LogRecord]:
        """A warning, once, when the silence exceeds the limit."""
        if self._heard_at is None or self.silent or now - self._heard_at <= self._timeout:
            return []
        self.silent = True
        since_s = (now - self._heard_at) / SECOND
        return [LogRecord(Level.WARNING, f"nothing heard from the rover for {since_s:.0f} s")]

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "heard_at": self._heard_at,
            "silent": self.silent,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the watch from this state."""
        self._heard_at = state["heard_at"]
        self.silent = state["silent"]

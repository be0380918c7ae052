"""Plans that the rover rejects, and how long the ground waits before it plans again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.mission.mission_time import MissionTime, seconds

if TYPE_CHECKING:
    from services.runtime.node import SavedState

FIRST_WAIT_S, LONGEST_WAIT_S = 30.0, 3600.0  # from the second rejection in a row until the next planning
MAX_REJECTIONS = 10  # plans in a row that the rover may reject


class PlanRejections:
    """Counts rejections in a row. The first is answered at once, each later one after a longer wait."""

    def __init__(self) -> None:
        self.in_a_row = 0
        self._not_before: MissionTime = 0

    @property
    def too_many(self) -> bool:
        return self.in_a_row > MAX_REJECTIONS

    def accepted(self) -> None:
        """Reset the count, because the rover has accepted a plan."""
        self.in_a_row, self._not_before = 0, 0

    def rejected(self, now: MissionTime) -> MissionTime | None:
        """Count a rejection; returns when planning may continue, None for at once.

        A rover that rejects twice in a row knows more than the ground does so far; the next plan waits for
        it.
        """
        self.in_a_row += 1
        if self.in_a_row == 1:
            return None
        self._not_before = now + seconds(min(FIRST_WAIT_S * 2 ** (self.in_a_row - 2), LONGEST_WAIT_S))
        return self._not_before

    def waiting(self, now: MissionTime) -> bool:
        """Whether planning has to wait."""
        return now < self._not_before

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "in_a_row": self.in_a_row,
            "not_before": self._not_before,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the rejections from this state."""
        self.in_a_row = state["in_a_row"]
        self._not_before = state["not_before"]

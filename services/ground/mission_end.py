"""Whether the mission is over, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.runtime.node import Finish

if TYPE_CHECKING:
    from services.runtime.node import SavedState


class MissionEnd:
    """The facts that decide the end: the last plan is sent, the rover has completed it, nothing more can be planned."""

    def __init__(self) -> None:
        self.finish: Finish | None = None
        """How the mission ended; None while it runs."""
        self._last_sent = False
        self._completed = 0
        self._exhausted = ""
        self._failed = False

    @property
    def nothing_more_to_plan(self) -> bool:
        """Whether planning has been given up, until `reopen`."""
        return bool(self._exhausted)

    def plan_sent(self, last: bool) -> None:
        """Note that a plan was sent; last: no sample is left to plan after it."""
        self._last_sent = last

    def plan_outdated(self) -> None:
        """Note that the rover follows another plan than the last one."""
        self._last_sent = False

    def plan_completed(self, revision: int) -> None:
        """Note the rover's report that it has completed the plan of that revision."""
        self._completed = max(self._completed, revision)

    def give_up_planning(self, why: str, failed: bool = False) -> None:
        """Note that no further round can be planned; the mission ends after the present ones. failed: as a failure."""
        self._exhausted = why
        self._failed = failed

    def reopen(self) -> None:
        """Undo `give_up_planning`, because rounds were taken back and are planned anew."""
        self._last_sent = False
        self._exhausted = ""
        self._failed = False

    def goal_reached(self, why: str) -> None:
        """Note that the map is good enough, so that no further sample is needed."""
        self._exhausted = why
        self._failed = False

    def awaits_completion(self, introduced: int) -> bool:
        """Whether the rover's report of completion is still missing for the plan whose last round has that revision."""
        return self._last_sent and not self._exhausted and self._completed < introduced

    def over(self, samples: int, samples_total: int, detail: str) -> Finish:
        """End the mission with that number of samples in the map; detail: the last note for the operator."""
        why = f"{samples} of {samples_total} samples are in the map"
        if samples < samples_total:
            why += f"; {self._exhausted or detail or 'the rover has completed its plan'}"
        self.finish = Finish(ok=not self._failed, why=why)
        return self.finish

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "finish": self.finish,
            "last_sent": self._last_sent,
            "completed": self._completed,
            "exhausted": self._exhausted,
            "failed": self._failed,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the end from this state."""
        self.finish = state["finish"]
        self._last_sent = state["last_sent"]
        self._completed = state["completed"]
        self._exhausted = state["exhausted"]
        self._failed = state["failed"]

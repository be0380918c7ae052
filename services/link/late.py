"""Reports the processes that virtual time waits for, and the last sign of life of each.

The liveliness token shows at once that a process has ended. A process that does not finish its step may be slow or
hang: virtual time waits for it, and an operator is told when it was last heard from. Every process sends a
heartbeat every two seconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from schemas.lockstep import StepBusy

REPORT_AFTER_S = 5.0
"""A process that has not finished a step after this time is reported."""
REPORT_COMPUTING_AFTER_S = 120.0
"""This time for a process that reports a running computation."""


class SignsOfLife:
    """When each process was last heard from, and its report on the present step. Wall time comes from `now_s` [s]."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._heard_at_s: dict[str, float] = {}
        self._busy: dict[str, StepBusy] = {}
        self._step_began_s = now_s()

    def heard(self, name: str) -> None:
        """Note a message of that process."""
        self._heard_at_s[name] = self._now_s()

    def begin_step(self) -> None:
        """Begin a step: drop the reports on the step before."""
        self._step_began_s = self._now_s()
        self._busy.clear()

    def busy(self, busy: StepBusy) -> None:
        """Note the report of a process that cannot finish the step yet."""
        self.heard(busy.name)
        self._busy[busy.name] = busy

    def overdue(self, outstanding: Collection[str]) -> bool:
        """Whether it is time to report the processes that have not finished the step."""
        if not outstanding:
            return False
        computing = {name for name, busy in self._busy.items() if busy.computing}
        bound = REPORT_COMPUTING_AFTER_S if set(outstanding) <= computing else REPORT_AFTER_S
        return self._now_s() - self._step_began_s > bound

    def report(self, step: int, outstanding: Collection[str]) -> str:
        """One line: the processes that the step waits for, with the last report of each."""
        waits = ", ".join(f"{name} ({self._known_of(name)})" for name in sorted(outstanding))
        return f"step {step} waits for {waits}; mission time stands"

    def _known_of(self, name: str) -> str:
        busy = self._busy.get(name)
        if busy is not None and busy.lacks:
            lacks = ", ".join(f"{count} from {sender}" for sender, count in sorted(busy.lacks.items()))
            return f"has not received {lacks}"
        if busy is not None:
            return f"computing {', '.join(busy.computing)}"
        heard_at_s = self._heard_at_s.get(name)
        return "not heard from yet" if heard_at_s is None else f"last heard from {self._now_s() - heard_at_s:.0f} s ago"

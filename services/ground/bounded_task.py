"""A task with a limit on the wall clock, for code whose end nothing else ensures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class BoundedTask:
    """The function, to be ended when it has computed for that long.

    The planner process ends it. Where a function is called in the caller's own process, nothing can.
    """

    function: Callable[..., Any]
    limit_s: float
    """Seconds of wall-clock time."""

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)

"""A task with a limit on wall-clock time, for code that may never end by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class BoundedTask:
    """A function with its time limit; it is ended when it exceeds the limit.

    The planner process ends it. Where a function is called in the caller's own process, nothing can.
    """

    function: Callable[..., Any]
    limit_s: float
    """Seconds of wall-clock time."""

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)

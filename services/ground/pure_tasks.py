"""Computes a mission's tasks for a driver in one process: in that process where the result cannot depend on it.

A task in a process of its own costs a fork, two pickles and all that earlier tasks have cached. Fits and the built-in
planners are computed here: `tour` uses no global state, and the others seed OMPL's before each tree. A plug-in may do
anything, so its tasks go to the planner process, which starts with the first of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future
from types import TracebackType
from typing import Any, Self

from services.ground.fitting import fit, fit_kernel
from services.ground.planner_process import PlannerProcess
from services.ground.planners import PLANNERS
from services.ground.planning import run_planner
from services.runtime.scheduler import InlineExecutor


class MissionExecutor:
    """An executor of fits and plans; to be closed."""

    def __init__(self) -> None:
        self._here = InlineExecutor()
        self._elsewhere: PlannerProcess | None = None
        # The planner process computes with one thread, and a result may depend on the number of threads.
        self._one_thread = os.environ.get("OPENBLAS_NUM_THREADS") == "1"

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """The future result; of a task that is computed here it has ended."""
        if self._one_thread and is_pure(function, arguments):
            return self._here.submit(function, *arguments)
        if self._elsewhere is None:
            self._elsewhere = PlannerProcess()
        return self._elsewhere.submit(function, *arguments)

    def close(self) -> None:
        """End the planner process, if there is one."""
        if self._elsewhere is not None:
            self._elsewhere.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def is_pure(function: Callable[..., Any], arguments: tuple[Any, ...]) -> bool:
    """Whether the task's result is a function of its arguments alone, whatever ran before in the process."""
    if function is run_planner:
        return isinstance(arguments[0], str) and arguments[0] in PLANNERS
    return function in (fit, fit_kernel)

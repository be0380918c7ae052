"""The tasks of a benchmark as a campaign: results as they come, resumed from a store, orderly at Ctrl-C and SIGTERM.

    with Tasks(jobs, engine, store) as pool:
        for task, result in pool.results(function, tasks):
            ...             # in the order in which results come
        write(...)          # all results, or those that came before a signal: pool.stopped tells

Engines, worker processes and store are those of ``he3 campaign``. Within the ``with`` statement SIGINT and SIGTERM do
not interrupt this process. They end the iteration, so that the benchmark prints and writes the results that it has. At
the end of the statement the workers are killed and the signal is raised again.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Final, Self, TypeVar

from benchmarks.values import decoded, encoded
from he3.errors import He3Error, InvalidInput
from services.console.campaign.engines import Engine, engine_named
from services.console.campaign.identity import planner_checksum, region_checksum, software_identity
from services.console.campaign.runner import Progress, replies
from services.console.campaign.store import IN_MEMORY, Store
from services.console.campaign.task import DONE, Task

Asked = TypeVar("Asked")
Result = TypeVar("Result")

WORK: Final = f"{__name__}:compute"
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


def compute(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The result of a task, in a worker process. What a generator yields is a list."""
    result = decoded(arguments["function"])(decoded(arguments["task"]))
    return {"result": encoded(list(result) if isinstance(result, Iterator) else result)}


class Tasks:
    """Tasks on an engine. Only one thread may use it: for signals, the main thread."""

    def __init__(self, jobs: int, engine: str = "local", store: Path | None = None) -> None:
        """jobs: at once, except on a cluster at an address. store: of the results, so that a run that was ended
        continues; None: they are kept while this runs. Raises InvalidInput for less than one job.
        """
        if jobs < 1:
            raise InvalidInput(f"expected one job at least, got {jobs}")
        self._jobs, self._name, self._path = jobs, engine, store or IN_MEMORY
        self._engine: Engine | None = None
        self._stack = ExitStack()
        self._stopped: signal.Signals | None = None
        self._handlers: dict[signal.Signals, Any] = {}

    @property
    def stopped(self) -> signal.Signals | None:
        """The signal that ended the tasks; None if there was none."""
        return self._stopped

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # other threads may not set handlers
            self._handlers = {number: signal.signal(number, self._stop) for number in _SIGNALS}
        self._store = self._stack.enter_context(Store(self._path, write=True))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._stack.close()
        finally:
            for number, handler in self._handlers.items():
                signal.signal(number, handler)
        if self._stopped is not None:
            signal.raise_signal(self._stopped)

    def results(self, function: Callable[[Asked], Result], tasks: Sequence[Asked]) -> Iterator[tuple[Asked, Result]]:
        """Each task with what ``function(task)`` returns, in the order in which results come.

        function: of a module, or a partial of one. Raises He3Error if a task fails. Ends early when a signal comes.
        """
        for task, result in self.outcomes(function, tasks):
            if isinstance(result, He3Error):
                raise result
            yield task, result

    def items(
        self, function: Callable[[Asked], Iterable[Result]], tasks: Sequence[Asked]
    ) -> Iterator[tuple[Asked, Result]]:
        """Each task with each item of ``function(task)``, when the task is done; otherwise like `results`."""
        for task, found in self.results(function, tasks):
            for item in found:
                yield task, item

    def outcomes(
        self, function: Callable[[Asked], Result], tasks: Sequence[Asked]
    ) -> Iterator[tuple[Asked, Result | He3Error]]:
        """Like `results`, but the error of a task that fails is its result."""
        named = encoded(function)
        software = software_identity("benchmarks")
        asked: dict[str, Asked] = {}
        wanted = []
        for each in tasks:
            task = Task(WORK, {"function": named, "task": encoded(each), **_content(each)}, software)
            asked[task.key] = each
            wanted.append(task)
        for key, each in asked.items():
            row = self._store.row(key)
            if row is not None and row.status == DONE and self._stopped is None:
                yield each, _result(row.status, row.result, row.error)
        if not wanted or self._stopped is not None:
            return
        if self._engine is None:
            jobs = None if self._name.partition(":")[2] else self._jobs
            self._engine = self._stack.enter_context(engine_named(self._name, jobs))
        for found in replies(wanted, self._store, self._engine, Progress(len(asked)), retry_failed=True):
            if self._stopped is not None:
                return
            if found is not None:
                task, reply = found
                yield asked[task.key], _result(reply.status, reply.result, reply.error)

    def _stop(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal: the wait for results ends."""
        if self._stopped is None:
            self._stopped = signal.Signals(number)


def progress(line: str) -> None:
    """Print a line on standard error about what has been done so far."""
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


def _content(task: Any) -> dict[str, str]:
    """Checksums of the region and of the plug-in planner that a task names, as their content may change."""
    region, planner = getattr(task, "region", None), getattr(task, "planner", None)
    found = {} if not isinstance(region, str) else {"region_sha256": region_checksum(region)}
    return found if not isinstance(planner, str) else found | {"planner_sha256": planner_checksum(planner)}


def _result(status: str, result: Mapping[str, Any] | None, error: str) -> Any:
    return decoded(result["result"]) if status == DONE and result is not None else He3Error(error)

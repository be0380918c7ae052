"""Worker processes for the tasks of a benchmark: results as they come, and an orderly end on Ctrl-C and SIGTERM.

    with WorkerPool(jobs) as pool:
        for task, result in pool.results(function, tasks):
            ...             # in the order in which results come
        write(...)          # all results, or those that came before a signal: pool.stopped tells

Within the ``with`` statement SIGINT and SIGTERM do not interrupt this process. They end the iteration, so that the
benchmark prints and writes the results that it has. At the end of the statement the workers are killed and the signal
is raised again. Work that takes more than a moment belongs in a task, or after the statement.

A worker computes one task at a time and keeps what it has imported and cached. It leads a separate process group, which
is killed when the pool ends or this process dies.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import FrameType, TracebackType
from typing import Any, Self, TypeVar

from he3.errors import He3Error, InvalidInput

Task = TypeVar("Task")
Result = TypeVar("Result")

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_STARTING = -1


@dataclass(slots=True)
class _Worker:
    process: SpawnProcess
    connection: Connection
    task: int | None = _STARTING
    """Index of the task that the worker computes; None while it waits for one."""


@dataclass(frozen=True, slots=True)
class _Item:
    value: Any


@dataclass(frozen=True, slots=True)
class _Done:
    error: Exception | None = None


class WorkerPool:
    """Up to `jobs` worker processes, started on demand. Only one thread may use it: for signals, the main thread."""

    def __init__(self, jobs: int) -> None:
        """Raises InvalidInput for less than one job."""
        if jobs < 1:
            raise InvalidInput(f"expected one job at least, got {jobs}")
        self._jobs = jobs
        self._workers: list[_Worker] = []
        self._stopped: signal.Signals | None = None
        self._handlers: dict[signal.Signals, Any] = {}
        self._signalled, self._signal = os.pipe()

    @property
    def stopped(self) -> signal.Signals | None:
        """The signal that ended the tasks; None if there was none."""
        return self._stopped

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # other threads may not set handlers
            self._handlers = {number: signal.signal(number, self._stop) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end(self._workers)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        os.close(self._signalled)
        os.close(self._signal)
        if self._stopped is not None:
            signal.raise_signal(self._stopped)

    def results(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[tuple[Task, Result]]:
        """Each task with what ``function(task)`` returns, in the order in which results come.

        Functions, tasks and results are pickled. What a function raises is raised here. Raises He3Error if a worker
        dies. Ends early when a signal comes.
        """
        return self.items(partial(_once, function), tasks)

    def items(
        self, function: Callable[[Task], Iterable[Result]], tasks: Sequence[Task]
    ) -> Iterator[tuple[Task, Result]]:
        """Each task with each item of ``function(task)``, as soon as it arrives; otherwise like `results`."""
        # A worker that is still busy belongs to an iteration that was left.
        self._end([worker for worker in self._workers if worker.task not in (None, _STARTING)])
        waiting = deque(range(len(tasks)))
        while len(self._workers) < min(self._jobs, len(tasks)) and self._stopped is None:
            self._workers.append(_start())
        while self._stopped is None:
            for worker in self._workers:
                if worker.task is None and waiting:
                    worker.task = waiting.popleft()
                    worker.connection.send((function, tasks[worker.task]))
            busy = {worker.connection: worker for worker in self._workers if worker.task is not None}
            if not waiting and all(worker.task == _STARTING for worker in busy.values()):
                return
            for ready in wait([*busy, self._signalled]):
                if self._stopped is not None or not isinstance(ready, Connection):
                    break
                worker = busy[ready]
                number, message = worker.task, _received(worker)
                assert number is not None, "only workers with a task are waited for"
                if isinstance(message, _Item):
                    yield tasks[number], message.value
                    continue
                worker.task = None
                if message.error is not None:
                    raise message.error

    def _stop(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal: the wait for results ends."""
        if self._stopped is None:
            self._stopped = signal.Signals(number)
            os.write(self._signal, b"!")

    def _end(self, workers: Iterable[_Worker]) -> None:
        ending = list(workers)
        for worker in ending:
            pid = worker.process.pid
            if pid is not None:
                with suppress(ProcessLookupError):  # it has ended, or does not lead its group yet
                    os.killpg(pid, signal.SIGKILL)
            worker.process.kill()
        for worker in ending:
            worker.process.join()
            worker.connection.close()
            self._workers.remove(worker)


def progress(line: str) -> None:
    """Print a line on standard error about what has been done so far."""
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


def _start() -> _Worker:
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs,), name="benchmark worker", daemon=True)
    # A Ctrl-C of the terminal reaches the worker, too. It stays pending until the worker ignores it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    theirs.close()
    return _Worker(process, ours)


def _received(worker: _Worker) -> _Item | _Done:
    try:
        message: _Item | _Done = worker.connection.recv()
    except (EOFError, ConnectionResetError):
        worker.process.join()
        raise He3Error(
            f"a worker process ended with exit code {worker.process.exitcode}; its task has no result"
        ) from None
    return message


# --- in the worker --------------------------------------------------------------------------------------------------


def _serve(connection: Connection) -> None:
    """Compute the tasks that come until the connection is closed."""
    os.setpgid(0, 0)
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    connection.send(_Done())
    while True:
        try:
            function, task = connection.recv()
        except EOFError:
            return
        connection.send(_computed(connection, function, task))


def _computed(connection: Connection, function: Callable[[Any], Iterable[Any]], task: Any) -> _Done:
    try:
        for value in function(task):
            connection.send(_Item(value))
    except Exception as error:  # noqa: BLE001 - it is raised again where the results are wanted
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # noqa: BLE001 - an exception that cannot be pickled is sent as text
            return _Done(He3Error(f"{type(error).__name__}: {error}"))
        return _Done(error)
    return _Done()


def _once(function: Callable[[Task], Result], task: Task) -> Iterator[Result]:
    yield function(task)


def _end_with_parent() -> None:
    """Kill this process group as soon as the parent process has ended."""
    parent = parent_process()
    assert parent is not None, "a worker has a parent"
    parent.join()
    os.killpg(0, signal.SIGKILL)

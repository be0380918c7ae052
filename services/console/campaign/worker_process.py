"""The owner's end of a worker process: send it a task, have its reply, replace it when it dies.

Each thread that computes has a worker process of its own; together they are the crew of an engine.
"""

from __future__ import annotations

import subprocess
import threading
from contextlib import suppress
from typing import Final

from services.console.campaign.task import FAILED, LOST, Reply, canonical, reply_of
from services.runtime.child import child_environment, exit_in_words, python_command
from services.runtime.instructions import common_instructions

ATTEMPTS: Final = 3
"""How often a task is computed whose worker process dies: something from outside may have killed it."""
FIXED: Final = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "PYTHONHASHSEED": "0",
    "PYTHONUTF8": "1",
    "LC_ALL": "C",
    "LANGUAGE": "C",
    "TZ": "UTC",
}
"""Environment of every worker process, whatever its host has set."""


class WorkerProcess:
    """A child process that computes one task at a time. Only the thread that made it may use it, but for `kill`."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            python_command("services.console.campaign.worker"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**child_environment(), **FIXED, **common_instructions()},
            start_new_session=True,
            text=True,
            encoding="ascii",
        )

    def computed(self, request: str) -> Reply | None:
        """The reply to a task's line of text; None if the process ended before it."""
        assert self._process.stdin is not None, "made with pipes"
        assert self._process.stdout is not None, "made with pipes"
        try:
            self._process.stdin.write(request + "\n")
            self._process.stdin.flush()
            return reply_of(self._process.stdout.readline())
        except (OSError, ValueError):
            return None

    def ended(self) -> str:
        """How the process ended, in words; it is killed if it runs."""
        self.kill()
        code = exit_in_words(self._process.wait())
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return code

    def kill(self) -> None:
        """Kill the process; what it has started ends with it."""
        if self._process.poll() is None:
            self._process.kill()


class Crew:
    """The worker processes of one engine in this process: one for each thread that computes."""

    def __init__(self) -> None:
        self._mine = threading.local()
        self._lock = threading.Lock()
        self._running: set[WorkerProcess] = set()
        self._ended = False

    def computed(self, request: str) -> Reply:
        """The reply to a task's line of text, by this thread's worker process.

        A worker process that dies is replaced, and its task computed again, up to ATTEMPTS times in all.
        """
        how = ""
        for _ in range(ATTEMPTS):
            worker = self._worker()
            if worker is None:
                return Reply(LOST, error="the campaign is ending")
            reply = worker.computed(request)
            if reply is not None:
                return reply
            self._mine.worker = None
            how = worker.ended()
            with self._lock:
                self._running.discard(worker)
        return Reply(FAILED, error=f"the worker process ended {ATTEMPTS} times, at last with {how}")

    def _worker(self) -> WorkerProcess | None:
        """This thread's worker process, started if it has none; None at the end."""
        with self._lock:
            if self._ended:
                return None
            worker: WorkerProcess | None = getattr(self._mine, "worker", None)
            if worker is None:
                worker = self._mine.worker = WorkerProcess()
                self._running.add(worker)
            return worker

    def end(self) -> None:
        """Kill every worker process, and start no other."""
        with self._lock:
            self._ended = True
            running = list(self._running)
        for worker in running:
            worker.kill()

    def close(self) -> None:
        """Free what the worker processes held, after `end`, when no thread waits for one."""
        while self._running:
            self._running.pop().ended()


_HERE: Final = Crew()


def computed(request: str) -> str:
    """The reply to a task's line of text as such a line, computed in this process's crew: what a cluster calls."""
    reply = _HERE.computed(request)
    return canonical({name: getattr(reply, name) for name in Reply.__slots__})

"""A process that computes for its owner: each task runs in a new child, can be killed, and returns a Future.

    with PlannerProcess() as planners:
        future = planners.plan("rrtstar", request)          # at once; the caller's threads stay free
        round = future.result()                             # or NoRoute, InvalidInput ... as raised by the planner
        fitted = planners.submit(fit_hyperparameters, ...)  # any picklable callable of an importable module

Three parties. The *owner* (a service, with its Zenoh session and threads) must never fork. So it starts a *server*
(`services.ground.planner_server`), which forks a *child* for each task.

Endings. The server lives as long as the owner holds its end of their socket: it ignores Ctrl-C, which is for the owner
to judge, and ends, killing its children, when the socket closes, for any end of the owner. A child dies with the
server. A child that dies otherwise, a task whose time is up, or a dead server, is reported as He3Error in the futures
concerned; the next task gets a new server.

Bounds. At most ``parallel`` children compute at once and at most ``MAX_WAITING`` tasks wait. A `BoundedTask` is killed
when its time is up.

Pebble's ProcessPool (5.2.3, ``max_tasks=1`` over a fork server that has imported the planners), measured on two cores,
starts as fast (0.6 s against 0.5 s), but takes 51 ms a task against 4 ms, and 524 ms for eight at once against 38 ms.
It kills a task's process and not what that has started, and each of its children imports the owner's main module.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from math import inf
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

from he3.errors import He3Error, InvalidInput
from services.ground.bounded_task import BoundedTask
from services.ground.planner_channel import CANCEL, DIED, ERROR, EXIT_CODE, LATE, LIMIT_S, TASK, receive, send
from services.ground.planners import PLANNERS, plan, planner_named

if TYPE_CHECKING:
    from services.ground.planners.interface import PlannedRound, PlanningRequest

T = TypeVar("T")

MAX_WAITING = 1000
CLOSE_S = 0.5
"""Time [s] that the server has to end before the owner kills it and its children."""


class PlannerProcess:
    """A server process for tasks of one owner. ``submit`` and ``cancel`` may be called from any thread."""

    def __init__(self, parallel: int = 2) -> None:
        if parallel < 1:
            raise InvalidInput(f"expected at least one task at a time, got {parallel}")
        self._parallel = parallel
        self._lock = threading.Lock()
        # Sending may have to wait for the server, which may wait for the reader: never send while the lock is held.
        self._sending = threading.Lock()
        self._pending: dict[int, tuple[socket.socket, Future[Any]]] = {}
        self._last = 0
        self._server: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._reader: threading.Thread | None = None
        self._closed = False

    def start(self) -> None:
        """Start the server if it does not run; it needs about half a second until its first answer."""
        with self._lock:
            self._started()

    def submit(self, task: Callable[..., T], *arguments: Any) -> Future[T]:
        """The future result of ``task(*arguments)``, computed in a child of the server.

        The task is a function of an importable module, or such a one in a `BoundedTask`. What it raises is raised by
        ``result()``. Cancelling the future kills the child. Raises InvalidInput if the task cannot be pickled, He3Error
        when too many are waiting.
        """
        limit_s = task.limit_s if isinstance(task, BoundedTask) else inf
        try:
            payload = pickle.dumps((task, arguments), protocol=pickle.HIGHEST_PROTOCOL)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InvalidInput(f"expected a task that can be pickled, got {task!r}: {error}") from None
        future: Future[T] = Future()
        with self._lock:
            if len(self._pending) >= MAX_WAITING:
                raise He3Error(f"{MAX_WAITING} tasks are waiting for the planner process: expected fewer")
            channel = self._started()
            self._last += 1
            number = self._last
            self._pending[number] = channel, future
        self._send(channel, number, TASK, LIMIT_S.pack(limit_s) + payload)
        future.add_done_callback(lambda done: self._forget(number, done))
        return future

    def plan(self, planner_name: str, request: PlanningRequest) -> Future[PlannedRound]:
        """The future round of the named planner. Raises InvalidInput at once for a name that no planner of ours has."""
        if planner_name not in PLANNERS and ":" not in planner_name:
            planner_named(planner_name)
        return self.submit(plan, planner_name, request)

    def cancel(self) -> None:
        """Cancel everything that is waiting or being computed."""
        with self._lock:
            pending = list(self._pending.values())
        for _, future in pending:
            future.cancel()

    def close(self) -> None:
        """Cancel open tasks and end the server; returns when it has ended. Further tasks are refused."""
        with self._lock:
            self._closed = True
            server, channel, reader = self._server, self._socket, self._reader
        self.cancel()
        if server is None or channel is None or reader is None:
            return
        with suppress(OSError):  # the server may have been faster
            channel.shutdown(socket.SHUT_RDWR)
        try:
            server.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()
        if reader is not threading.current_thread():
            reader.join()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _started(self) -> socket.socket:
        """The socket to a server that runs; the lock is held."""
        if self._closed:
            raise He3Error("the planner process was closed: expected no further task")
        if self._socket is not None:
            return self._socket
        ours, theirs = socket.socketpair()
        with theirs:
            # One thread, so that forking is safe; and its children share the cores with everything else anyway.
            environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
            command = (
                f"import sys; sys.path[:] = {sys.path!r}; "
                f"from services.ground.planner_server import serve; serve({theirs.fileno()}, {self._parallel})"
            )
            self._server = subprocess.Popen(
                [sys.executable, "-P", "-c", command], pass_fds=[theirs.fileno()], env=environment,
                stdin=subprocess.DEVNULL, stdout=2,  # a plug-in planner's prints are not output of the owner
            )  # fmt: skip
        self._socket = ours
        self._reader = threading.Thread(
            target=self._read, args=(ours, self._server), name="planner-process", daemon=True
        )
        self._reader.start()
        return ours

    def _read(self, channel: socket.socket, server: subprocess.Popen[bytes]) -> None:
        """Pass answers to their futures until the server ends; then fail all open futures."""
        while (message := receive(channel)) is not None:
            number, kind, payload = message
            with self._lock:
                _, future = self._pending.pop(number, (None, None))
            if future is not None and future.set_running_or_notify_cancel():
                _settle(future, kind, payload)
        status = server.wait()
        with self._lock:
            if self._socket is channel:
                self._socket = None
            orphans = [number for number, (served_by, _) in self._pending.items() if served_by is channel]
            futures = [self._pending.pop(number)[1] for number in orphans]
        with self._sending:
            channel.close()
        for future in futures:
            if future.set_running_or_notify_cancel():
                future.set_exception(He3Error(f"the planner process ended ({_in_words(status)}): nothing was planned"))

    def _forget(self, number: int, future: Future[Any]) -> None:
        """Kill the child of a task that was cancelled."""
        if not future.cancelled():
            return
        with self._lock:
            channel, _ = self._pending.pop(number, (None, None))
        if channel is not None:
            self._send(channel, number, CANCEL, b"")

    def _send(self, channel: socket.socket, number: int, kind: bytes, payload: bytes) -> None:
        # When the server has died its reader notices, and fails all that was pending there, this task too.
        with self._sending, suppress(OSError):
            send(channel, number, kind, payload)


def _settle(future: Future[Any], kind: bytes, payload: bytes) -> None:
    if kind == DIED:
        (status,) = EXIT_CODE.unpack(payload)
        future.set_exception(He3Error(f"the child that computed the task died ({_in_words(status)})"))
        return
    if kind == LATE:
        (limit_s,) = LIMIT_S.unpack(payload)
        why = f"expected an answer within {limit_s:g} s of wall-clock time, got none; the task was ended"
        future.set_exception(He3Error(why))
        return
    try:
        value = pickle.loads(payload)
    except Exception as error:  # noqa: BLE001 - unpickling a foreign class may raise anything, and the future must end
        future.set_exception(He3Error(f"the task's answer could not be read: {type(error).__name__}: {error}"))
        return
    if kind == ERROR:
        future.set_exception(value)
    else:
        future.set_result(value)


def _in_words(status: int) -> str:
    if status >= 0:
        return f"exit status {status}"
    try:
        return f"signal {signal.Signals(-status).name}"
    except ValueError:
        return f"signal {-status}"

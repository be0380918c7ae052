"""A process that computes for another one: each task in a child of its own, fresh, killable, its answer a Future.

    with PlannerProcess() as planners:
        future = planners.plan("rrtstar", request)          # at once; the caller's threads stay free
        round = future.result()                             # or NoRoute, InvalidInput ... as raised by the planner
        fitted = planners.submit(fit_hyperparameters, ...)  # any picklable callable of an importable module

Three parties. The *owner* (a service, with its Zenoh session and threads) must never fork. So it starts a *server*, a
new interpreter with one thread, that imports what planning needs, once, and then only waits. For each task the server
forks a *child*, which computes and exits: a result depends on the task alone, never on what ran before, and a task can
be killed at any instant without harm to the others.

Endings. The server lives as long as the owner holds its end of their socket: it ignores Ctrl-C, which is for the owner
to judge, and ends, killing its children, when the socket does, however the owner died. A child dies with the server. A
child that dies otherwise, or a dead server, is reported as He3Error in the futures concerned; the next task gets a new
server.

Bounds. At most ``parallel`` children compute at once and at most ``MAX_WAITING`` tasks wait. A message has a length
of eight bytes, an identifier of eight, a kind of one, and a pickle. The socket joins two processes of one program: it
is no way in for others.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import selectors
import signal
import socket
import struct
import subprocess
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from types import TracebackType
from typing import Any, Self, TypeVar

from he3.errors import He3Error, InvalidInput
from services.ground.planners import PLANNERS, plan, planner_named
from services.ground.planners.interface import PlannedRound, PlanningRequest

T = TypeVar("T")

MAX_WAITING = 1000
MAX_BYTES = 1 << 30
"""Longest message [bytes]; a planning request of 500 x 500 cells has about 2 MB."""
CLOSE_S = 0.5
"""How long the owner waits for the server to end before it kills it, and its children with it [s]."""
PRELOADED = ("scipy.optimize", "he3.gp", *sorted(set(PLANNERS.values())))
"""What the server imports before the first fork, so that no child spends its time on it."""

_HEADER = struct.Struct("!QQc")
_LENGTH = struct.Struct("!Q")
_TASK, _CANCEL, _RESULT, _ERROR, _DIED = b"t", b"c", b"r", b"e", b"d"
_PR_SET_PDEATHSIG = 1  # Linux, prctl(2)


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

        The task is a function of an importable module. What it raises is raised by ``result()``. Cancelling the future
        kills the child. Raises InvalidInput if the task cannot be pickled, He3Error when too many are waiting.
        """
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
        self._send(channel, number, _TASK, payload)
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
        """Cancel what is left and end the server; returns when it has ended. Further tasks are refused."""
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
                f"from services.ground.planner_process import serve; serve({theirs.fileno()}, {self._parallel})"
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
        """Give answers to their futures until the server ends; then fail whatever is pending."""
        while (message := _received(channel)) is not None:
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
            self._send(channel, number, _CANCEL, b"")

    def _send(self, channel: socket.socket, number: int, kind: bytes, payload: bytes) -> None:
        # When the server has died its reader notices, and fails all that was pending there, this task too.
        with self._sending, suppress(OSError):
            _send(channel, number, kind, payload)


def _settle(future: Future[Any], kind: bytes, payload: bytes) -> None:
    if kind == _DIED:
        (status,) = struct.unpack("!q", payload)
        future.set_exception(He3Error(f"the child that computed the task died ({_in_words(status)})"))
        return
    try:
        value = pickle.loads(payload)
    except Exception as error:  # noqa: BLE001 - whatever a foreign class does when it is unpickled, the future must end
        future.set_exception(He3Error(f"the task's answer could not be read: {type(error).__name__}: {error}"))
        return
    if kind == _ERROR:
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


def _send(channel: socket.socket, number: int, kind: bytes, payload: bytes) -> None:
    channel.sendall(_HEADER.pack(len(payload), number, kind))
    if payload:
        channel.sendall(payload)


def _received(channel: socket.socket) -> tuple[int, bytes, bytes] | None:
    """The next message (number, kind, payload), or None when the other side is gone."""
    try:
        header = _exactly(channel, _HEADER.size)
        if header is None:
            return None
        size, number, kind = _HEADER.unpack(header)
        payload = _exactly(channel, size) if size <= MAX_BYTES else None
        return None if payload is None else (number, kind, bytes(payload))
    except OSError:
        return None


def _exactly(channel: socket.socket, size: int) -> bytearray | None:
    data = bytearray(size)
    view, got = memoryview(data), 0
    while got < size:
        count = channel.recv_into(view[got:])
        if count == 0:
            return None
        got += count
    return data


# The server's side: one thread, nothing but system calls between forks.


@dataclass(slots=True)
class _Child:
    number: int
    pid: int
    output: int
    answer: bytearray = field(default_factory=bytearray)

    @property
    def has_answered(self) -> bool:
        """Whether all of the answer, which tells its own length, has come."""
        read = len(self.answer) - _LENGTH.size
        return read >= 0 and read >= _LENGTH.unpack_from(self.answer)[0]


def serve(file_descriptor: int, parallel: int) -> None:
    """Answer the tasks that come in by the socket until its other end is closed; then return."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for module in PRELOADED:
        with suppress(ImportError):  # a task that needs what is missing says so itself
            import_module(module)
    channel = socket.socket(fileno=file_descriptor)
    channel.set_inheritable(False)
    selector = selectors.DefaultSelector()
    selector.register(channel, selectors.EVENT_READ)
    waiting: deque[tuple[int, bytes]] = deque()
    children: dict[int, _Child] = {}
    try:
        while True:
            for key, _ in selector.select():
                if key.fileobj is channel:
                    message = _received(channel)
                    if message is None:
                        return
                    number, kind, payload = message
                    if kind == _TASK:
                        waiting.append((number, payload))
                    else:
                        waiting = deque(task for task in waiting if task[0] != number)
                        _kill(child for child in children.values() if child.number == number)
                    continue
                child = children[key.fd]
                chunk = os.read(child.output, 1 << 20)
                child.answer += chunk
                if not chunk or child.has_answered:  # whoever it forked may hold the other end open
                    selector.unregister(child.output)
                    del children[child.output]
                    _report(channel, child)
            while waiting and len(children) < parallel:
                number, payload = waiting.popleft()
                child = _forked(number, payload)
                children[child.output] = child
                selector.register(child.output, selectors.EVENT_READ)
    except (BrokenPipeError, ConnectionResetError):
        return  # the owner is gone, nobody wants the answer
    finally:
        _kill(children.values())


def _kill(children: Iterable[_Child]) -> None:
    """Kill children, with all that they started."""
    for child in children:  # none of them is reaped before its output ends, so each process id is still its own
        with suppress(ProcessLookupError):  # it has not yet got as far as to lead a group
            os.killpg(child.pid, signal.SIGKILL)
        os.kill(child.pid, signal.SIGKILL)


def _forked(number: int, payload: bytes) -> _Child:
    output, inside = os.pipe()
    server = os.getpid()
    pid = os.fork()
    if pid:
        os.close(inside)
        return _Child(number, pid, output)
    status = 1
    try:
        os.setsid()
        _die_with(server)
        answer = _computed(payload)
        with os.fdopen(inside, "wb") as stream:
            stream.write(_LENGTH.pack(len(answer)) + answer)
        status = 0
    finally:
        os._exit(status)  # no exit handlers, no buffers: those are the server's


def _computed(payload: bytes) -> bytes:
    """Kind and pickle of what the task returns or raises."""
    try:
        task, arguments = pickle.loads(payload)
        return _RESULT + pickle.dumps(task(*arguments), protocol=pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001 - it is raised again, where the result is asked for
        if not isinstance(error, He3Error):
            error.add_note("in the planner process:\n" + traceback.format_exc())
        try:
            answer = _ERROR + pickle.dumps(error)
            pickle.loads(answer[1:])
        except Exception:  # noqa: BLE001 - an exception that does not survive pickling travels as its text
            answer = _ERROR + pickle.dumps(He3Error(f"{type(error).__name__}: {error}"))
        return answer


def _report(channel: socket.socket, child: _Child) -> None:
    os.close(child.output)
    if child.has_answered:
        _kill([child])
    _, wait_status = os.waitpid(child.pid, 0)
    if child.has_answered:
        answer = memoryview(child.answer)[_LENGTH.size :]
        _send(channel, child.number, bytes(answer[:1]), bytes(answer[1:]))
    else:
        _send(channel, child.number, _DIED, struct.pack("!q", os.waitstatus_to_exitcode(wait_status)))


def _die_with(server: int) -> None:
    """Have the kernel kill this process when the server is gone; elsewhere than on Linux it just finishes its task."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != server:
            os._exit(1)

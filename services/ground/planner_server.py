"""The server of the planner process: one thread that forks a child for each task, and makes only system calls between.

It runs in an interpreter of its own (`services.ground.planner_process` starts it), imports the planning modules once,
and then only waits. A child computes one task and exits: a result depends on the task alone, never on what ran before,
and a task can be killed at any instant without harm to the others. A child leads a process group, so processes that a
plug-in planner started end with the child. The child ends with the server.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import selectors
import signal
import socket
import struct
import sys
import time
import traceback
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from math import inf
from typing import Final

from he3.errors import He3Error
from services.ground.planner_channel import DIED, ERROR, EXIT_CODE, LATE, LIMIT_S, RESULT, TASK, receive, send
from services.ground.planners import PLANNERS

PRELOADED: Final = ("scipy.optimize", "he3.gp", *sorted(set(PLANNERS.values())))
"""Modules that the server imports before the first fork, so that no child has to import them."""

EXIT_S: Final = 1.0  # how long a child that has closed its output may take to exit by itself

_LENGTH = struct.Struct("!Q")
_PR_SET_PDEATHSIG = 1  # Linux, prctl(2)


@dataclass(slots=True)
class _Child:
    number: int
    pid: int
    output: int
    limit_s: float
    ends_at: float
    """Deadline on the monotonic clock [s]."""
    answer: bytearray = field(default_factory=bytearray)

    @property
    def has_answered(self) -> bool:
        """Whether the whole answer, which begins with its length, has arrived."""
        read = len(self.answer) - _LENGTH.size
        return read >= 0 and read >= _LENGTH.unpack_from(self.answer)[0]


def serve(file_descriptor: int, parallel: int) -> None:
    """Answer the tasks that arrive on the socket until its other end is closed; then return."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for module in PRELOADED:
        with suppress(ImportError):  # a task that needs what is missing says so itself
            import_module(module)
    channel = socket.socket(fileno=file_descriptor)
    channel.set_inheritable(False)
    _Server(channel, parallel).run()


class _Server:
    """The tasks that wait, and the children that compute."""

    def __init__(self, channel: socket.socket, parallel: int) -> None:
        self._channel = channel
        self._parallel = parallel
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._children: dict[int, _Child] = {}
        self._selector = selectors.DefaultSelector()
        self._selector.register(channel, selectors.EVENT_READ)

    def run(self) -> None:
        """Compute until the owner is gone."""
        try:
            while True:
                ready = {key.fd for key, _ in self._selector.select(self._until_next_limit())}
                if self._channel.fileno() in ready and not self._take_message():
                    return
                for child in [child for output, child in self._children.items() if output in ready]:
                    self._read(child)
                for child in [child for child in self._children.values() if child.ends_at <= time.monotonic()]:
                    self._end(child)
                    send(self._channel, child.number, LATE, LIMIT_S.pack(child.limit_s))
                self._fork_waiting()
        except (BrokenPipeError, ConnectionResetError):
            return  # the owner is gone, and with it the need for an answer
        finally:
            for child in self._children.values():
                _kill(child)

    def _take_message(self) -> bool:
        """Receive a task, or kill one; False if the owner is gone."""
        message = receive(self._channel)
        if message is None:
            return False
        number, kind, payload = message
        if kind == TASK:
            self._waiting.append((number, payload))
            return True
        self._waiting = deque(task for task in self._waiting if task[0] != number)
        for child in [child for child in self._children.values() if child.number == number]:
            self._end(child)
        return True

    def _read(self, child: _Child) -> None:
        """Read what a child has written; a process that the child started may keep the pipe open after the answer."""
        chunk = os.read(child.output, 1 << 20)
        child.answer += chunk
        if child.has_answered:
            self._end(child)
            answer = memoryview(child.answer)[_LENGTH.size :]
            send(self._channel, child.number, bytes(answer[:1]), bytes(answer[1:]))
        elif not chunk:
            status = self._end(child, EXIT_S)
            send(self._channel, child.number, DIED, EXIT_CODE.pack(status))

    def _end(self, child: _Child, patience_s: float = 0.0) -> int:
        """The exit code of a child; one that does not exit by itself is killed with every process that it started."""
        self._selector.unregister(child.output)
        del self._children[child.output]
        os.close(child.output)
        until = time.monotonic() + patience_s
        exited = os.WEXITED | os.WNOHANG | os.WNOWAIT  # it is not reaped yet, so that its process id is still its own
        while os.waitid(os.P_PID, child.pid, exited) is None and time.monotonic() < until:
            time.sleep(0.001)
        _kill(child)
        return os.waitstatus_to_exitcode(os.waitpid(child.pid, 0)[1])

    def _until_next_limit(self) -> float | None:
        """Seconds until the next deadline of a child; None if no child has a limit."""
        ends_at = min((child.ends_at for child in self._children.values()), default=inf)
        return None if ends_at == inf else max(0.0, ends_at - time.monotonic())

    def _fork_waiting(self) -> None:
        while self._waiting and len(self._children) < self._parallel:
            child = _forked(*self._waiting.popleft())
            self._children[child.output] = child
            self._selector.register(child.output, selectors.EVENT_READ)


def _kill(child: _Child) -> None:
    """Kill a running child with every process that it started."""
    with suppress(ProcessLookupError):  # it does not lead a group yet
        os.killpg(child.pid, signal.SIGKILL)
    os.kill(child.pid, signal.SIGKILL)


def _forked(number: int, payload: bytes) -> _Child:
    (limit_s,) = LIMIT_S.unpack_from(payload)
    output, inside = os.pipe()
    server = os.getpid()
    pid = os.fork()
    if pid:
        os.close(inside)
        return _Child(number, pid, output, limit_s, time.monotonic() + limit_s)
    status = 1
    try:
        os.setsid()
        _die_with(server)
        answer = _computed(payload[LIMIT_S.size :])
        with os.fdopen(inside, "wb") as stream:
            stream.write(_LENGTH.pack(len(answer)) + answer)
        status = 0
    finally:
        os._exit(status)  # no exit handlers, no buffers: those are the server's


def _computed(payload: bytes) -> bytes:
    """Kind and pickle of what the task returns or raises."""
    try:
        task, arguments = pickle.loads(payload)
        return RESULT + pickle.dumps(task(*arguments), protocol=pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001 - it is raised again, where the result is asked for
        if not isinstance(error, He3Error):
            error.add_note("in the planner process:\n" + traceback.format_exc())
        try:
            answer = ERROR + pickle.dumps(error)
            pickle.loads(answer[1:])
        except Exception:  # noqa: BLE001 - an exception that does not survive pickling travels as its text
            answer = ERROR + pickle.dumps(He3Error(f"{type(error).__name__}: {error}"))
        return answer


def _die_with(server: int) -> None:
    """Have the kernel kill this process when the server ends; on systems other than Linux it finishes its task."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != server:
            os._exit(1)

"""Operators' questions, answered in a process of their own: whatever is asked, the node next door does not feel it.

The *owner* (a service's process) hands over each snapshot, pickled, through a pipe; only the newest waits. The
*answerer* has a Zenoh session of its own, keeps what it needs of earlier snapshots, and answers in threads. It ends
with its pipe, however the owner died, and is started again if it dies itself. The pipe joins two processes of one
program and one user: it is no way in for others.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, BinaryIO, Protocol

from he3.errors import He3Error
from schemas.topics import Side
from services.runtime.child import child_environment, python_command
from services.runtime.queries.server import QueryServer, QueryService
from services.runtime.transport.session import Session, connect_client

READY = b"ready\n"
START_WITHIN_S = 30.0
"""How long an answerer may take until it answers, on a machine with much else to do."""
START_AGAIN_S = 1.0
CLOSE_WITHIN_S = 0.3
"""How long an answerer may take to end by itself; it has nothing to lose."""

SETTLE_WITHIN_S = 5.0

_HEAD = struct.Struct("<QQ")  # number and length of a snapshot


class QueryProcess:
    """The owner's end. `show` may be called from any thread and returns at once."""

    def __init__(self, module: str, side: Side, endpoint: str, mission: str, warn: Callable[[str], None]) -> None:
        self._module = module
        self._command = python_command(module, side.value, endpoint, mission)
        self._warn = warn
        self._changed = threading.Condition()
        self._newest: tuple[int, Any] = (0, None)
        self._closed = False
        self._answered_from = 0
        self._ready = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._work, name="answering", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int | None:
        """Process id of the answerer; None before the first has started."""
        return None if self._process is None else self._process.pid

    def show(self, snapshot: object) -> None:
        """Answer from that snapshot from now on."""
        with self._changed:
            self._newest = (self._newest[0] + 1, snapshot)
            self._changed.notify_all()

    def settle(self, within_s: float = SETTLE_WITHIN_S) -> bool:
        """Wait until questions are answered from what was shown last; whether that came about in time."""
        deadline = time.monotonic() + within_s
        with self._changed:
            while self._answered_from < self._newest[0] and not self._closed:
                left = deadline - time.monotonic()
                if left <= 0:
                    return False
                self._changed.wait(left)
        return True

    def wait_until_ready(self, stop: threading.Event) -> None:
        """Return when questions are answered, or when `stop` is set; raises He3Error when they are not in time."""
        deadline = time.monotonic() + START_WITHIN_S
        while not self._ready.wait(0.05):
            if stop.is_set():
                return
            if time.monotonic() > deadline:
                raise He3Error(f"{self._module}: expected it to be ready within {START_WITHIN_S:g} s")

    def close(self) -> None:
        """End the answerer."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(CLOSE_WITHIN_S)
        process = self._process
        if self._thread.is_alive() and process is not None:
            process.kill()  # it is being started still, and does not read what it is given
        self._thread.join(CLOSE_WITHIN_S)

    def _work(self) -> None:
        while not self._closed:
            process = self._start()
            try:
                self._hand_over(process)
            except (BrokenPipeError, OSError):
                if not self._closed:
                    self._warn("the process that answers operators has died; starting another")
                    time.sleep(START_AGAIN_S)
            finally:
                self._end(process)

    def _start(self) -> subprocess.Popen[bytes]:
        # Not of the owner's group: Ctrl-C is for the owner to judge.
        process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            process_group=0,
            env=child_environment(),
        )
        self._process = process
        stdout = process.stdout
        assert stdout is not None
        threading.Thread(target=self._await_ready, args=(stdout,), name="answering-ready", daemon=True).start()
        return process

    def _await_ready(self, stdout: Any) -> None:
        while line := stdout.readline():
            if line == READY:
                self._ready.set()
            elif line.strip().isdigit():
                with self._changed:
                    self._answered_from = int(line)
                    self._changed.notify_all()

    def _hand_over(self, process: subprocess.Popen[bytes]) -> None:
        given = 0
        while True:
            with self._changed:
                while self._newest[0] == given and not self._closed:
                    # A dead answerer is noticed even when there is nothing to hand over.
                    self._changed.wait(START_AGAIN_S)
                    if process.poll() is not None:
                        raise BrokenPipeError
                if self._closed:
                    return
                given, snapshot = self._newest
            assert process.stdin is not None
            payload = pickle.dumps(snapshot, protocol=pickle.HIGHEST_PROTOCOL)
            _write_all(process.stdin, _HEAD.pack(given, len(payload)))
            _write_all(process.stdin, payload)

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        with contextlib.suppress(OSError):
            if process.stdin is not None:
                process.stdin.close()
        try:
            process.wait(CLOSE_WITHIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


def _write_all(pipe: Any, payload: bytes) -> None:
    rest = memoryview(payload)
    while rest:
        rest = rest[pipe.write(rest) :]


class SnapshotPublisher(Protocol):
    """Publishes what it likes of each snapshot, beside the replies to queries."""

    def begin(self, session: Session) -> None:
        """Publish on that session from now on."""

    def show(self, snapshot: Any) -> None:
        """Publish from that snapshot from now on; never blocks."""

    def end(self) -> None:
        """Publish no more."""


def serve_from_pipe(service: QueryService, name: str, publisher: SnapshotPublisher, arguments: Sequence[str]) -> int:
    """Answer that service's queries from the snapshots that come in on standard input; returns when it ends.

    arguments: side, endpoint and mission. publisher: is shown each snapshot as well.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # A thread that computes hands over after 0.5 ms, so that a question waits no longer for it than for the network.
    sys.setswitchinterval(0.0005)
    side, endpoint, mission = arguments
    ended = threading.Event()
    session: list[Session] = []
    server = QueryServer(service, name, mission)

    def connect() -> None:
        opened = connect_client(Side(side), endpoint, mission, ended, lambda _: None)
        if opened is None:
            return
        session.append(opened)
        for topic in service.topics:
            server.serve(topic, opened)
        publisher.begin(opened)
        os.write(1, READY)

    connecting = threading.Thread(target=connect, name="connect", daemon=True)
    connecting.start()
    pipe = sys.stdin.buffer
    while (given := _read(pipe)) is not None:
        number, snapshot = given
        publisher.show(server.show(snapshot))
        os.write(1, b"%d\n" % number)
    ended.set()
    publisher.end()
    for opened in session:
        opened.close()
    # Threads of Zenoh may still hold on to what is going away.
    os._exit(0)


def _read(pipe: BinaryIO) -> tuple[int, Any] | None:
    """Number and content of the next snapshot; None at the end."""
    head = pipe.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    number, length = _HEAD.unpack(head)
    payload = pipe.read(length)
    return (number, pickle.loads(payload)) if len(payload) == length else None

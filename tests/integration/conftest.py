"""Fixtures of real services, each a process on free loopback ports: started, watched, and ended in time.

Every wait is for a line, a message or an end of a process. No process outlives the test run, however that ends.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from schemas.topics import Side, Topic
from schemas.wire import Header, Wire
from services.runtime.child import python_command
from services.runtime.transport.client import Client
from tests.processes import start
from tests.waiting import PATIENCE_S, expect_within, until

GONE_WITHIN_S = 2.0
"""From the first signal to the end of the process, as promised."""


class Process:
    """One service's process, its lines on standard error, and its end."""

    def __init__(self, name: str, command: Sequence[str]) -> None:
        self.name = name
        self.lines: list[str] = []
        self._news = threading.Condition()
        self._signalled_at: float | None = None
        self._ended_at: float | None = None
        """Time at which the process and its children had closed their output."""
        self.popen = start(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={"PYTHONUNBUFFERED": "1"},
        )
        self._reader = threading.Thread(target=self._read, name=f"lines of {name}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        with self.popen.stdout as stream:
            for line in stream:
                with self._news:
                    self.lines.append(line.rstrip("\n"))
                    self._news.notify_all()
        with self._news:
            self._ended_at = time.monotonic()
            self._news.notify_all()

    @property
    def pid(self) -> int:
        return self.popen.pid

    @property
    def running(self) -> bool:
        return self.popen.poll() is None

    @property
    def text(self) -> str:
        return "\n".join(self.lines)

    def line(self, part: str, after: int = 0) -> str:
        """The first line from number `after` on that contains `part`; waits for it."""

        def found() -> str | None:
            return next((line for line in self.lines[after:] if part in line), None)

        with self._news:
            self._news.wait_for(lambda: found() is not None or self._ended_at, PATIENCE_S)
            line = found()
        if line is None:
            ended = f"it ended with {self.popen.wait()}" if self._ended_at else f"waited {PATIENCE_S:g} s"
            pytest.fail(f"{self.name}: no line with '{part}', {ended}:\n{self.text}")
        return line

    def wait_for_handlers(self) -> None:
        """Wait until the process takes SIGTERM itself: from its first line of code on."""
        status = Path(f"/proc/{self.pid}/status")

        def handled() -> bool:
            caught = next((line for line in status.read_text().splitlines() if line.startswith("SigCgt:")), "SigCgt: 0")
            return bool(int(caught.split()[1], 16) & 1 << (signal.SIGTERM - 1))

        until(handled, f"{self.name} to take signals")

    def send(self, number: int) -> None:
        if self._signalled_at is None:
            self._signalled_at = time.monotonic()
        self.popen.send_signal(number)

    def end(self) -> int:
        """The exit code, once it has ended; fails the test if it took longer than promised after its first signal."""
        try:
            code = self.popen.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.kill()
            pytest.fail(f"{self.name}: not gone after {PATIENCE_S:g} s:\n{self.text}")
        self._reader.join(PATIENCE_S)
        assert self._ended_at is not None, f"{self.name}: it has ended, but something that it started has not"
        if self._signalled_at is not None:
            took_s = self._ended_at - self._signalled_at
            expect_within(GONE_WITHIN_S, took_s, f"the end of {self.name} after a signal")
        return code

    def stop(self, number: int = signal.SIGTERM) -> int:
        """The exit code after that signal."""
        if self.running:
            self.send(number)
        return self.end()

    def kill(self) -> None:
        """End it as a power failure would."""
        self.popen.kill()
        self.popen.wait()
        self._reader.join(PATIENCE_S)


class Heard(NamedTuple):
    """A message, and when it was received in wall time [ns]."""

    header: Header
    body: Any
    wall_ns: int


class Listener:
    """Keeps every message of one topic that reaches a client."""

    def __init__(self, client: Client, topic: Topic) -> None:
        self.heard: list[Heard] = []
        self._news = threading.Condition()
        self._topic = topic
        client.subscribe(topic, self._take)

    def _take(self, header: Header, body: Any) -> None:
        with self._news:
            self.heard.append(Heard(header, body, time.time_ns()))
            self._news.notify_all()

    def wait(self, wanted: Callable[[Header, Any], bool] = lambda *_: True) -> Heard:
        """The first wanted message, among past and future ones."""

        def found() -> Heard | None:
            return next((each for each in self.heard if wanted(each.header, each.body)), None)

        with self._news:
            self._news.wait_for(lambda: found() is not None, PATIENCE_S)
            each = found()
        if each is None:
            last = self.heard[-1].body if self.heard else None
            pytest.fail(f"{self._topic.name}: waited {PATIENCE_S:g} s; {len(self.heard)} came, last {last}")
        return each


class PatientClient(Client):
    """A client whose timeout is the test's."""

    def query(self, topic: Topic, request: Wire, timeout_s: float = PATIENCE_S) -> Any:
        return super().query(topic, request, timeout_s)

    def fetch(
        self, topic: Topic, parameters: Mapping[str, object], timeout_s: float = PATIENCE_S
    ) -> tuple[bytes, bytes]:
        return super().fetch(topic, parameters, timeout_s)

    def latest(self, topic: Topic, timeout_s: float = PATIENCE_S) -> tuple[Header, Any]:
        return super().latest(topic, timeout_s)


class Mission:
    """The processes of one mission, on separate ports."""

    def __init__(self, scenario: str, flags: Sequence[str] = (), name: str | None = None) -> None:
        self.scenario = scenario
        self.name = name or Path(scenario).stem
        self.moon, self.earth = free_endpoints()
        self._flags = tuple(flags)
        self.processes: dict[str, Process] = {}
        self.past: list[Process] = []
        self._clients: list[Client] = []

    def start(self, *names: str, flags: Sequence[str] = ()) -> None:
        """Start those services, at once, without waiting for any of them."""
        for name in names:
            if name in self.processes:
                self.past.append(self.processes[name])
            command = python_command(f"services.{name}", self.scenario, "--moon", self.moon)
            self.processes[name] = Process(name, [*command, "--earth", self.earth, *self._flags, *flags])

    def run(self, name: str, command: Sequence[str]) -> None:
        """Start a process of the test's own under that name."""
        self.processes[name] = Process(name, command)

    def ready(self, *names: str) -> None:
        """Wait until those services (all, if none is named) take part."""
        for name in names or tuple(self.processes):
            self.processes[name].line(" ready")

    def __getitem__(self, name: str) -> Process:
        return self.processes[name]

    def client(self, side: Side = Side.EARTH, name: str = "operator") -> Client:
        """A session on that side, closed with the mission; the router must be there."""
        client = PatientClient(self.earth if side is Side.EARTH else self.moon, self.name, name, side)
        self._clients.append(client)
        return client

    def close_clients(self) -> None:
        while self._clients:
            self._clients.pop().close()

    def stop(self, number: int = signal.SIGTERM) -> dict[str, int]:
        """The exit code of every service that still ran, after that signal to all of them."""
        self.close_clients()
        running = {name: process for name, process in self.processes.items() if process.running}
        for process in running.values():
            process.send(number)
        return {name: process.end() for name, process in running.items()}

    def close(self) -> None:
        """End the remaining processes; fails if one of them failed."""
        try:
            codes = self.stop()
        finally:
            for process in self.processes.values():
                if process.running:
                    process.kill()
        for process in [*self.past, *self.processes.values()]:
            assert "Traceback" not in process.text, f"{process.name}:\n{process.text}"
        assert set(codes.values()) <= {0}, f"expected exit code 0 of all, got {codes}"


def free_endpoints() -> tuple[str, str]:
    """Two endpoints on loopback with free ports."""
    with socket.socket() as first, socket.socket() as second:
        for each in (first, second):
            each.bind(("127.0.0.1", 0))
        return tuple(f"tcp/127.0.0.1:{each.getsockname()[1]}" for each in (first, second))  # type: ignore[return-value]


Missions = Callable[..., Mission]


def _missions() -> Iterator[Missions]:
    made: list[Mission] = []

    def make(scenario: str, *flags: str, name: str | None = None) -> Mission:
        mission = Mission(scenario, flags, name)
        made.append(mission)
        return mission

    yield make
    problems = []
    for mission in made:
        try:
            mission.close()
        except (AssertionError, pytest.fail.Exception) as problem:
            problems.append(str(problem))
    assert not problems, "\n".join(problems)


@pytest.fixture
def missions() -> Iterator[Missions]:
    """Makes missions of a scenario and flags; all of their processes are gone, in order, when the test ends."""
    yield from _missions()


@pytest.fixture(scope="module")
def shared_missions() -> Iterator[Missions]:
    """Missions that a whole module shares."""
    yield from _missions()


@pytest.fixture
def listen() -> Callable[[Client, Topic], Listener]:
    """Collects a topic's messages at a client."""
    return Listener

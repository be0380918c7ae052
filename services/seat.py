"""A host with its timers and computations, in virtual time: what every driver needs to know of one node.

What reaches a node at one instant is handled in a fixed order: messages by sender and order of sending, then answers,
results and timers. No scheduling, and no order in which messages happen to come in, can change that.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from concurrent.futures import Future
from enum import IntEnum
from typing import Any, Protocol

from services.host import Action, Host
from services.node import Compute, MissionTime, WakeAt, seconds


class Executor(Protocol):
    """Runs pure functions; a process of its own where a result must not depend on what was run before."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]: ...


class InlineExecutor:
    """Runs each function at once, here: for functions that draw on no global state."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as error:  # noqa: BLE001 - carried to whoever asked, who sees exactly this error
            future.set_exception(error)
        return future


class Kind(IntEnum):
    """In which order inputs of one instant are handled."""

    MESSAGE = 0
    QUESTION = 1
    RESULT = 2
    TIMER = 3


Order = tuple[Kind, str, int]
"""Kind, sender (or name), number: the place of an input among those of its instant."""


class Seat:
    """One host's inputs, timers and computations."""

    def __init__(self, host: Host, executor: Executor) -> None:
        self.host = host
        self.emitted = 0
        """Messages published so far."""
        self._executor = executor
        self._inbox: list[tuple[Order, Callable[[MissionTime], list[Action]]]] = []
        self._timers: dict[str, MissionTime] = {}
        self._heap: list[tuple[MissionTime, str]] = []
        self._running: list[tuple[MissionTime, str, Future[Any]]] = []

    @property
    def name(self) -> str:
        return self.host.interface.name

    def put(self, order: Order, handle: Callable[[MissionTime], list[Action]]) -> None:
        """Keep an input for the next `run`; `handle` is a host's method that lacks only the time."""
        self._inbox.append((order, handle))

    @property
    def waiting(self) -> int:
        """Inputs that wait for the next `run`."""
        return len(self._inbox)

    def next_wake(self, wait: bool = True) -> MissionTime | None:
        """When the next timer is due or the next computation ends; None when there is neither.

        wait: whether computations count that are still at work (virtual time), or only those that have ended.
        """
        while self._heap and self._timers.get(self._heap[0][1]) != self._heap[0][0]:
            heapq.heappop(self._heap)
        times = [self._heap[0][0]] if self._heap else []
        times.extend(ends for ends, _, future in self._running if wait or future.done())
        return min(times) if times else None

    def computations(self) -> list[str]:
        """Names of the computations under way."""
        return sorted(job for _, job, _ in self._running)

    def due_computations(self, now: MissionTime) -> list[Future[Any]]:
        """The computations whose end is due by `now`, ended or not."""
        return [future for ends, _, future in self._running if ends <= now]

    def run(self, now: MissionTime, wait: bool = True) -> list[Action]:
        """Handle everything that is there or due by `now`; returns the actions that concern others, in order.

        wait: whether a computation that is due is waited for (virtual time), or passed over until it has ended.
        """
        self._collect_results(now, wait)
        self._collect_timers(now)
        batch = sorted(self._inbox, key=lambda entry: entry[0])
        self._inbox = []
        outward: list[Action] = []
        for _, handle in batch:
            outward.extend(action for action in handle(now) if not self._performed(action, now))
        return outward

    def _collect_results(self, now: MissionTime, wait: bool) -> None:
        ready = [entry for entry in self._running if entry[0] <= now and (wait or entry[2].done())]
        for number, (ends, job, future) in enumerate(ready):
            self._running.remove((ends, job, future))
            error = future.exception()
            if error is not None and not isinstance(error, Exception):
                raise error
            result = None if error is not None else future.result()
            handle = _computed(self.host, job, result, error)
            self._inbox.append(((Kind.RESULT, job, number), handle))

    def _collect_timers(self, now: MissionTime) -> None:
        while self._heap and self._heap[0][0] <= now:
            at, timer = heapq.heappop(self._heap)
            if self._timers.get(timer) == at:
                del self._timers[timer]
                self._inbox.append(((Kind.TIMER, timer, 0), _due(self.host, timer)))

    def _performed(self, action: Action, now: MissionTime) -> bool:
        match action:
            case WakeAt(timer, None):
                self._timers.pop(timer, None)
            case WakeAt(timer, at) if at is not None:
                self._timers[timer] = at
                heapq.heappush(self._heap, (at, timer))
            case Compute(job, function, arguments, takes_s):
                self._running.append((now + seconds(takes_s), job, self._executor.submit(function, *arguments)))
            case _:
                return False
        return True


def _computed(host: Host, job: str, result: Any, error: Exception | None) -> Callable[[MissionTime], list[Action]]:
    return lambda now: host.computed(job, result, error, now)


def _due(host: Host, timer: str) -> Callable[[MissionTime], list[Action]]:
    return lambda now: host.due(timer, now)

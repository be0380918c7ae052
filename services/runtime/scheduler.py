"""A node's scheduler: the inputs, timers and computations of one host, in an order that no driver can change.

Inputs of one instant are handled in a fixed order: messages by sender and order of sending, then queries, replies,
results and timers. The order in which they happen to arrive does not matter.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from enum import IntEnum
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, Protocol

from he3.errors import InvalidInput
from services.mission.mission_time import MissionTime, seconds
from services.runtime.inputs import ComputationEnded, Input, TimerElapsed
from services.runtime.node import Compute, Finish, PublishSnapshot, SetTimer

if TYPE_CHECKING:
    from services.runtime.actions import Action, PutQuery
    from services.runtime.host import Host
    from services.runtime.node import SavedState

CHECKPOINT_EVERY: Final = 300
"""Inputs between two checkpoints, and so handled again after a restart, at most."""


class Executor(Protocol):
    """Runs pure functions; in a separate process where the result would depend on earlier runs."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]: ...


class InlineExecutor:
    """Runs each function at once, in this process: for functions that use no global state."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as error:  # noqa: BLE001 - the future raises it where the result is asked for
            future.set_exception(error)
        return future


class Kind(IntEnum):
    """The order in which inputs of one instant are handled."""

    MESSAGE = 0
    QUERY = 1
    REPLY = 2
    RESULT = 3
    TIMER = 4


Order = tuple[Kind, str, int]
"""Kind, sender (or name), number: the place of an input among those of its instant."""


class Journal(Protocol):
    """Where inputs are kept before they are acted on."""

    def append(self, now: MissionTime, inputs: Sequence[Input]) -> None:
        """Keep inputs that are about to be handled; when it returns, the end of this process does not lose them."""

    def checkpoint(self, state: SavedState) -> None:
        """Keep the state after everything appended so far, in place of an earlier one; it may be lost."""


@dataclass(frozen=True, slots=True)
class _Computation:
    """A computation under way: when it ends, what it is, and its result."""

    ends: MissionTime
    what: Compute
    future: Future[Any]

    @property
    def job(self) -> str:
        return self.what.job


class NodeScheduler:
    """One host's inputs, timers and computations."""

    def __init__(self, host: Host, executor: Executor, journal: Journal | None = None) -> None:
        self.host = host
        self.name = host.interface.name
        self._journal = journal
        self.emitted = 0
        """Messages published so far."""
        self._executor = executor
        self._inbox: list[tuple[Order, Input]] = []
        self._timers: dict[str, MissionTime] = {}
        self._heap: list[tuple[MissionTime, str]] = []
        self._running: list[_Computation] = []
        self._lasting: dict[type, Action] = {}  # what still holds after a restart: the last snapshot, the end
        self._since_checkpoint = 0
        self._wake: tuple[MissionTime | None] | None = None  # what `next_wake` has found, until something changes
        self.last: MissionTime = 0
        """Mission time of the last `run` [ns]."""

    def put(self, order: Order, given: Input) -> None:
        """Keep an input for the next `run`."""
        self._inbox.append((order, given))

    @property
    def waiting(self) -> int:
        """Inputs that wait for the next `run`."""
        return len(self._inbox)

    def is_due(self, now: MissionTime) -> bool:
        """Whether `run` has anything to handle at that time."""
        if self._inbox:
            return True
        wake = self.next_wake() if self._wake is None else self._wake[0]
        return wake is not None and wake <= now

    def next_wake(self, wait: bool = True) -> MissionTime | None:
        """When the next timer elapses or the next computation ends; None if there is neither.

        wait: whether computations that still run count (virtual time), or only those that have ended.
        """
        if wait and self._wake is not None:
            return self._wake[0]
        heap, timers = self._heap, self._timers
        while heap and timers.get(heap[0][1]) != heap[0][0]:
            heapq.heappop(heap)
        earliest = heap[0][0] if heap else None
        for each in self._running:
            if (earliest is None or each.ends < earliest) and (wait or each.future.done()):
                earliest = each.ends
        if wait:
            self._wake = (earliest,)
        return earliest

    def computations(self) -> list[str]:
        """Names of the computations under way."""
        return sorted(each.job for each in self._running)

    def due_computations(self, now: MissionTime) -> list[Future[Any]]:
        """The computations that are to end by `now`, whether or not they have."""
        return [each.future for each in self._running if each.ends <= now]

    def run(self, now: MissionTime, wait: bool = True) -> list[Action]:
        """Handle all inputs, and the timers and computations due by `now`; returns the actions for the driver.

        wait: whether to wait for a computation that is due (virtual time), or to leave it until it has ended.
        """
        self._wake = None
        if self._running:
            self._collect_results(now, wait)
        if self._heap and self._heap[0][0] <= now:
            self._collect_timers(now)
        if len(self._inbox) > 1:
            self._inbox.sort(key=itemgetter(0))
        batch = [given for _, given in self._inbox]
        self._inbox = []
        outward: list[Action] = []
        audited = not self.host.admits_all
        if audited or self._journal is not None:
            batch = self._admitted(batch, now, outward)
        if self._journal is not None and batch:
            self._journal.append(now, batch)
        self.last = now
        for given in batch:
            for action in self.host.handle(given, now):
                if self._performed(action, now):
                    continue
                if audited:
                    self.host.answered(action, now)
                outward.append(action)
        if self._journal is not None and batch:
            self._keep_state(batch)
        return outward

    def _admitted(self, batch: Iterable[Input], now: MissionTime, outward: list[Action]) -> list[Input]:
        """The inputs that the host admits; the actions that follow from refusals are added to `outward`."""
        admitted = []
        for given in batch:
            kept, actions = self.host.admit(given, now)
            outward += actions
            if kept is not None:
                admitted.append(kept)
        return admitted

    def _keep_state(self, batch: Sequence[Input]) -> None:
        """Make a checkpoint every `CHECKPOINT_EVERY` inputs, and after each result: that takes longest to recompute."""
        self._since_checkpoint += len(batch)
        if self._since_checkpoint >= CHECKPOINT_EVERY or any(isinstance(given, ComputationEnded) for given in batch):
            assert self._journal is not None, "a checkpoint belongs to a journal"
            self._journal.checkpoint(self.checkpoint())
            self._since_checkpoint = 0

    def checkpoint(self) -> SavedState:
        """The state that all inputs so far have led to, for `replay`."""
        return {
            "host": self.host.checkpoint(),
            "last": self.last,
            "timers": dict(self._timers),
            "begun": {each.job: (each.ends, each.what) for each in self._running},
            "lasting": [*self._lasting.values()],
        }

    def _restore(self, state: SavedState) -> dict[str, tuple[MissionTime, Compute]]:
        """Restore the scheduler from this state; returns the computations that were under way.

        Raises InvalidInput for a state that lacks a part.
        """
        try:
            self.host.restore(state["host"])
            self.last, self._timers = state["last"], state["timers"]
            self._lasting = {type(action): action for action in state["lasting"]}
            begun: dict[str, tuple[MissionTime, Compute]] = state["begun"]
        except KeyError as error:
            raise InvalidInput(f"{self.name}: expected the state of this program, got one without {error}") from None
        self._heap = sorted((at, timer) for timer, at in self._timers.items())
        return begun

    def replay(self, kept: Iterable[tuple[MissionTime, Input]], state: SavedState | None = None) -> list[Action]:
        """Handle the inputs of a journal again, without their actions; returns the actions that are still to be done.

        They are the latest snapshot, the end of the mission, and the queries that have not ended. Timers stand as they
        did; computations whose result is not in the journal begin again. state: from a checkpoint before these inputs.
        """
        self._wake = None
        begun = {} if state is None else self._restore(state)
        for now, given in kept:
            self.last = now
            match given:
                case TimerElapsed(timer):
                    self._timers.pop(timer, None)
                case ComputationEnded(job):
                    begun.pop(job, None)
            for action in self.host.handle(given, now):
                match action:
                    case Compute(job, takes_s=takes_s):
                        begun[job] = (now + seconds(takes_s), action)
                    case SetTimer() | PublishSnapshot() | Finish():
                        self._performed(action, now)
        for ends, computation in begun.values():
            self._begin(computation, ends)
        queries: list[PutQuery] = self.host.open_queries()
        return [*self._lasting.values(), *queries]

    def _collect_results(self, now: MissionTime, wait: bool) -> None:
        ready = [each for each in self._running if each.ends <= now and (wait or each.future.done())]
        self._running = [each for each in self._running if not any(each is other for other in ready)]
        for number, each in enumerate(ready):
            error = each.future.exception()
            if error is not None and not isinstance(error, Exception):
                raise error
            result = None if error is not None else each.future.result()
            self._inbox.append(((Kind.RESULT, each.job, number), ComputationEnded(each.job, result, error)))

    def _collect_timers(self, now: MissionTime) -> None:
        while self._heap and self._heap[0][0] <= now:
            at, timer = heapq.heappop(self._heap)
            if self._timers.get(timer) == at:
                del self._timers[timer]
                self._inbox.append(((Kind.TIMER, timer, 0), TimerElapsed(timer)))

    def _performed(self, action: Action, now: MissionTime) -> bool:
        match action:
            case SetTimer(timer, None):
                self._timers.pop(timer, None)
            case SetTimer(timer, at) if at is not None:
                self._timers[timer] = at
                heapq.heappush(self._heap, (at, timer))
            case Compute(takes_s=takes_s):
                self._begin(action, now + seconds(takes_s))
            case PublishSnapshot() | Finish():
                self._lasting[type(action)] = action
                return False
            case _:
                return False
        return True

    def _begin(self, computation: Compute, ends: MissionTime) -> None:
        future = self._executor.submit(computation.function, *computation.arguments)
        self._running.append(_Computation(ends, computation, future))

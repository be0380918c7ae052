"""A host with its timers and computations, in virtual time: what every driver needs to know of one node.

What reaches a node at one instant is handled in a fixed order: messages by sender and order of sending, then questions,
answers, results and timers. No scheduling, and no order in which messages happen to come in, can change that.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, Protocol

from he3.errors import InvalidInput
from services.runtime.actions import Action, PutQuery
from services.runtime.host import Host
from services.runtime.inputs import ComputationEnded, Input, TimerElapsed
from services.runtime.node import Compute, Finish, MissionTime, PublishSnapshot, SetTimer, seconds
from services.runtime.state_codec import SavedState

CHECKPOINT_EVERY: Final = 300
"""Inputs after which a checkpoint is made at the latest: so many are handled again, at most, after a restart."""


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
    ANSWER = 2
    RESULT = 3
    TIMER = 4


Order = tuple[Kind, str, int]
"""Kind, sender (or name), number: the place of an input among those of its instant."""


class Journal(Protocol):
    """Where inputs are kept before they are acted on."""

    def append(self, now: MissionTime, inputs: Sequence[Input]) -> None:
        """Keep what is about to be handled at that time; safe against the end of this process when it returns."""

    def checkpoint(self, state: SavedState) -> None:
        """Keep the state after all that was appended so far, in place of an earlier one; it may be lost."""


@dataclass(frozen=True, slots=True)
class _Computation:
    """One that is under way: when it ends, what it is, and its result."""

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
        self.last: MissionTime = 0
        """When it last handled something [ns]."""

    @property
    def name(self) -> str:
        return self.host.interface.name

    def put(self, order: Order, given: Input) -> None:
        """Keep an input for the next `run`."""
        self._inbox.append((order, given))

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
        times.extend(each.ends for each in self._running if wait or each.future.done())
        return min(times) if times else None

    def computations(self) -> list[str]:
        """Names of the computations under way."""
        return sorted(each.job for each in self._running)

    def due_computations(self, now: MissionTime) -> list[Future[Any]]:
        """The computations whose end is due by `now`, ended or not."""
        return [each.future for each in self._running if each.ends <= now]

    def run(self, now: MissionTime, wait: bool = True) -> list[Action]:
        """Handle everything that is there or due by `now`; returns the actions that concern others, in order.

        wait: whether a computation that is due is waited for (virtual time), or passed over until it has ended.
        """
        self._collect_results(now, wait)
        self._collect_timers(now)
        batch = [given for _, given in sorted(self._inbox, key=lambda entry: entry[0])]
        self._inbox = []
        if self._journal is not None and batch:
            self._journal.append(now, batch)
        self.last = now
        outward: list[Action] = []
        for given in batch:
            outward.extend(action for action in self.host.handle(given, now) if not self._performed(action, now))
        if self._journal is not None and batch:
            self._keep_state(batch)
        return outward

    def _keep_state(self, batch: Sequence[Input]) -> None:
        """A checkpoint now and then, and after each result: what computing led to takes longest to handle again."""
        self._since_checkpoint += len(batch)
        if self._since_checkpoint >= CHECKPOINT_EVERY or any(isinstance(given, ComputationEnded) for given in batch):
            assert self._journal is not None, "only who keeps a journal keeps checkpoints"
            self._journal.checkpoint(self.checkpoint())
            self._since_checkpoint = 0

    def checkpoint(self) -> SavedState:
        """Everything that the inputs so far have led to, for `replay`."""
        return {
            "host": self.host.checkpoint(),
            "last": self.last,
            "timers": dict(self._timers),
            "begun": {each.job: (each.ends, each.what) for each in self._running},
            "lasting": [*self._lasting.values()],
        }

    def _restore(self, state: SavedState) -> dict[str, tuple[MissionTime, Compute]]:
        """Become the scheduler that had this state; returns the computations that were under way.

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
        """Handle again what a journal kept, doing nothing of what followed then; returns what is still to be done.

        That is the latest snapshot, whether the node had finished, and the questions that nobody had answered.
        Timers stand as they did; computations whose result was not in the journal begin again.
        state: what was kept of all that came before, if anything.
        """
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
        queries: list[PutQuery] = self.host.open_questions()
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

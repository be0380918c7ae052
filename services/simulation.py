"""All nodes and the link in one process, in virtual time, as fast as the CPU allows.

Time jumps from event to event. What happens at one instant happens in rounds: in each, every node handles what the
previous round sent it, in a fixed order (messages by sender and order of sending, then answers, results and timers),
and what it sends is there in the next. So the order of the nodes does not matter, and a mission is the same, event
for event, whether its nodes share a process or run lockstep in many.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from he3.errors import He3Error
from schemas.topics import Side, Topic
from schemas.wire import Header, Wire, decode_reply, encode
from services.host import Action, Host, Publish, PutQuestion, Reply, ReplyError, Trace
from services.node import SECOND, Compute, Finish, Level, MissionTime, Node, Note, Show, Silence, WakeAt, seconds

Tap = Callable[[Topic, Side, bytes, MissionTime], None]
"""Called with every message published, on the side where it was, at its time."""

NOBODY = ""
"""The sender of what the outside world injects."""


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


@dataclass(slots=True)
class _Seat:
    """A host and what waits for it."""

    host: Host
    inbox: list[tuple[tuple[int, str, int], Callable[[MissionTime], list[Action]]]] = field(default_factory=list)
    timers: dict[str, MissionTime] = field(default_factory=dict)
    emitted: int = 0


class Simulation:
    """A mission's nodes on their two sides, and virtual time."""

    def __init__(
        self,
        nodes: Iterable[Node],
        mission: str,
        start_ns: MissionTime,
        executor: Executor | None = None,
        trace: Trace | None = None,
    ) -> None:
        self.now: MissionTime = start_ns
        self.snapshots: dict[str, object] = {}
        """The latest snapshot that each node showed."""
        self.notes: list[tuple[MissionTime, str, Note]] = []
        self.finished: dict[str, Finish] = {}
        """Which nodes said that they have nothing left to do."""
        self.messages = 0
        """Messages published so far."""
        self._mission = mission
        self._executor = executor or InlineExecutor()
        self._seats = {host.interface.name: _Seat(host) for host in (Host(node, mission, trace) for node in nodes)}
        self._taps: list[Tap] = []
        self._wake: list[tuple[MissionTime, int, str, str]] = []
        self._running: list[tuple[MissionTime, int, str, str, Future[Any]]] = []
        self._order = 0
        self._questions: dict[int, tuple[str, str]] = {}
        self._outside: dict[int, list[bytes | str]] = {}
        for seat in self._seats.values():
            self._put(seat, (0, NOBODY, 0), partial(seat.host.start, 1))

    # --- driving ------------------------------------------------------------------------------------------------

    def step(self) -> bool:
        """Advance to the next instant at which something happens, and let it all happen; False when nothing is left."""
        instant = self._next_instant()
        if instant is None:
            return False
        self.now = max(self.now, instant)
        while self._collect_due():
            self._round()
        return True

    def run(self, until: MissionTime | None = None, stop: Callable[[], bool] = lambda: False) -> None:
        """Step until `stop()` holds, nothing is left, or the next event lies beyond `until` [ns]."""
        while not stop():
            instant = self._next_instant()
            if instant is None or (until is not None and instant > until):
                break
            self.step()
        if until is not None and not stop():
            self.now = max(self.now, until)

    def run_for(self, duration_s: float) -> None:
        """Step through that many seconds of mission time."""
        self.run(until=self.now + seconds(duration_s))

    def tap(self, tap: Tap) -> None:
        """Call `tap` with every message from now on."""
        self._taps.append(tap)

    # --- the outside world --------------------------------------------------------------------------------------

    def inject(self, topic: Topic, side: Side, payload: bytes) -> None:
        """Publish bytes as any stranger on that side could; they are handled at the next step."""
        self._publish(Publish(topic, side, payload), NOBODY, self._next_order())

    def ask(self, topic: Topic, request: Wire, source: str = "operator") -> Any:
        """The body of the answer to a question that an operator puts; raises He3Error with the refusal."""
        header = Header(mission=self._mission, source=source, incarnation=0, sequence=0, made_at=self.now)
        answer = self.ask_raw(topic, encode(header, request))
        if isinstance(answer, str):
            raise He3Error(answer)
        return decode_reply(topic, answer, self._mission)[1]

    def ask_raw(self, topic: Topic, payload: bytes) -> bytes | str:
        """The answer to a question put in bytes: bytes, or the one line of the refusal."""
        token = self._next_order()
        answers: list[bytes | str] = []
        self._outside[token] = answers
        self._route_question(topic, payload, token, NOBODY)
        while not answers:
            if not self._collect_due():
                raise He3Error(f"{topic.name}: nobody is there to answer")
            self._round()
        return answers[0]

    def seat(self, name: str) -> Host:
        """The host of that node."""
        return self._seats[name].host

    # --- inside -------------------------------------------------------------------------------------------------

    def _next_order(self) -> int:
        self._order += 1
        return self._order

    def _next_instant(self) -> MissionTime | None:
        if any(seat.inbox for seat in self._seats.values()):
            return self.now
        while self._wake and self._seats[self._wake[0][2]].timers.get(self._wake[0][3]) != self._wake[0][0]:
            heapq.heappop(self._wake)
        times = [heap[0][0] for heap in (self._wake, self._running) if heap]
        return min(times) if times else None

    def _collect_due(self) -> bool:
        """Move what is due now into the inboxes; False when nobody has anything to handle."""
        while self._running and self._running[0][0] <= self.now:
            _, order, name, job, future = heapq.heappop(self._running)
            error = future.exception()
            if error is not None and not isinstance(error, Exception):
                raise error
            result = None if error is not None else future.result()
            seat = self._seats[name]
            self._put(seat, (2, job, order), partial(seat.host.computed, job, result, error))
        while self._wake and self._wake[0][0] <= self.now:
            at, order, name, timer = heapq.heappop(self._wake)
            seat = self._seats[name]
            if seat.timers.get(timer) == at:
                del seat.timers[timer]
                self._put(seat, (3, timer, order), partial(seat.host.due, timer))
        return any(seat.inbox for seat in self._seats.values())

    def _round(self) -> None:
        batches = [(seat, sorted(seat.inbox, key=lambda entry: entry[0])) for seat in self._seats.values()]
        for seat in self._seats.values():
            seat.inbox = []
        for seat, batch in batches:
            for _, handle in batch:
                for action in handle(self.now):
                    self._perform(seat, action)

    def _put(self, seat: _Seat, order: tuple[int, str, int], handle: Callable[[MissionTime], list[Action]]) -> None:
        seat.inbox.append((order, handle))

    def _perform(self, seat: _Seat, action: Action) -> None:
        name = seat.host.interface.name
        match action:
            case Publish():
                seat.emitted += 1
                self._publish(action, name, seat.emitted)
            case PutQuestion(topic, _, payload, question, _):
                token = self._next_order()
                self._questions[token] = (name, question)
                self._route_question(topic, payload, token, name)
            case Reply(token, _, payload):
                self._answer(seat, token, payload)
            case ReplyError(token, _, why):
                self._answer(seat, token, why)
            case WakeAt(timer, None):
                seat.timers.pop(timer, None)
            case WakeAt(timer, at) if at is not None:
                seat.timers[timer] = at
                heapq.heappush(self._wake, (at, self._next_order(), name, timer))
            case Compute(job, function, arguments, takes_s):
                future = self._executor.submit(function, *arguments)
                ends = self.now + seconds(takes_s)
                heapq.heappush(self._running, (ends, self._next_order(), name, job, future))
            case Show(snapshot):
                self.snapshots[name] = snapshot
            case Note():
                self.notes.append((self.now, name, action))
            case Finish():
                self.finished[name] = action

    def _publish(self, action: Publish, sender: str, emission: int) -> None:
        self.messages += 1
        for tap in self._taps:
            tap(action.topic, action.side, action.payload, self.now)
        for name, seat in self._seats.items():
            if name != sender and seat.host.hears(action.topic, action.side):
                self._put(seat, (0, sender, emission), partial(seat.host.deliver, action.topic, action.payload))

    def _route_question(self, topic: Topic, payload: bytes, token: int, asker: str) -> None:
        for seat in self._seats.values():
            if topic in seat.host.interface.serves:
                self._put(seat, (1, asker, token), partial(seat.host.ask, topic, payload, token))
                return
        self._answer(None, token, Silence.NO_ROUTE)

    def _answer(self, answerer: _Seat | None, token: int, answer: bytes | str | Silence) -> None:
        if token in self._outside:
            text = answer.value if isinstance(answer, Silence) else answer
            self._outside.pop(token).append(text)
            return
        name, question = self._questions.pop(token)
        seat = self._seats[name]
        order = (1, answerer.host.interface.name if answerer else NOBODY, token)
        match answer:
            case bytes():
                self._put(seat, order, partial(seat.host.answered, question, answer))
            case Silence():
                self._put(seat, order, partial(seat.host.unanswered, question, answer, ""))
            case _:
                self._put(seat, order, partial(seat.host.unanswered, question, Silence.REFUSED, answer))


def warnings_of(simulation: Simulation) -> list[str]:
    """Texts of all warnings and errors so far, with node and seconds of mission time since 1970."""
    return [
        f"{at / SECOND:.3f} {name}: {note.text}"
        for at, name, note in simulation.notes
        if note.level in (Level.WARNING, Level.ERROR)
    ]

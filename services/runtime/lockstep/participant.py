"""One node's part in lockstep, without I/O: its inputs, the inputs that are still missing, and what it did in a step.

An input that reaches a node in one step is handled in the next, in the order of the simulation driver. So a mission in
separate processes is, event for event, the mission in one process. A transport (Zenoh, or a test's) carries out what
the node sends.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from schemas.lockstep import Grant, Join, Joined, StepDone
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError
from services.runtime.inputs import Input, ProcessStarted
from services.runtime.node import Finish
from services.runtime.scheduler import Kind, NodeScheduler
from services.runtime.stamp import Stamp

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime

OUTSIDE = ""
"""The sender of inputs without a stamp, which come from operators and from other programs."""


class Transport(Protocol):
    """Carries out the actions of a participant's node."""

    def publish(self, action: Publish, stamp: Stamp) -> None: ...

    def query(self, action: PutQuery, stamp: Stamp) -> None: ...

    def reply(self, action: Reply | ReplyError, stamp: Stamp) -> None: ...

    def perform(self, action: Action) -> None:
        """Carry out an action that concerns no other process: a snapshot, a log line, the end."""


@dataclass(frozen=True, slots=True)
class _Waiting:
    """An input that waits for its step."""

    step: int
    sender: str
    order: tuple[Kind, str, int]
    given: Input


class Participant:
    """A scheduler whose clock is granted, step by step."""

    def __init__(self, scheduler: NodeScheduler, process: str, resume: Iterable[Action] = ()) -> None:
        """process: identifies this start of the service. resume: actions that the replay of the journal left to do."""
        self.scheduler = scheduler
        self.process = process
        self.now: MissionTime = 0
        self.step = 0
        self.joined_at = -1
        """The step after which it first took part. Queries that were sent to it up to then ended without a reply."""
        self._term = ""
        self._admitted = False
        self._last_granted = 0
        self._uncounted_until = -1
        """Inputs that were sent up to this step are not counted by the time manager."""
        self.granted: Grant | None = None
        """The granted step, in which it acts as soon as it is `ready`."""
        self.finished: Finish | None = None
        self.hold_outside = False
        """Whether inputs from outside the mission wait; no grant counts these."""
        self._resume = tuple(resume)
        self._waiting: list[_Waiting] = []
        self._from_outside = 0
        self._senders: dict[int, Stamp] = {}
        self._published: Counter[tuple[str, str]] = Counter()
        self._queried: list[tuple[str, str]] = []
        self._replied: list[tuple[str, int]] = []

    @property
    def name(self) -> str:
        return self.scheduler.name

    # --- taking part --------------------------------------------------------------------------------------------

    def join(self) -> Join:
        """The request to take part."""
        host = self.scheduler.host
        return Join(
            term=self._term,
            name=self.name,
            process=self.process,
            hears=tuple((topic.name, side.value) for topic, side in host.received_topics()),
            serves=tuple((topic.name, side.value) for topic, side in host.served_topics()),
            next_wake=self._next_wake(),
            now=self.now,
            step=self._last_granted,
        )

    def obey(self, term: str) -> None:
        """Obey the grants of that term from now on; an earlier grant is void."""
        if term != self._term:
            self._term = term
            self._admitted = False
            self.granted = None

    def joined(self, answer: Joined) -> None:
        """Note the admission by the time manager, at its own time or a later one. Earlier inputs are not counted."""
        if answer.term != self._term or self._admitted:
            return
        self._admitted = True
        self.now = max(self.now, answer.now)
        self._uncounted_until = answer.step
        if self.joined_at < 0:
            self.joined_at = answer.step

    def start(self, incarnation: int) -> None:
        """Start the node in the first step that is granted."""
        self.scheduler.put((Kind.MESSAGE, OUTSIDE, 0), ProcessStarted(incarnation))

    # --- inputs -------------------------------------------------------------------------------------------------

    def take_message(self, given: Input, stamp: Stamp | None) -> bool:
        """Keep a message for its step; returns whether to poke the time manager, which does not know of it."""
        if stamp is not None and stamp.process == self.process:
            return False  # its own
        return self._keep(Kind.MESSAGE, given, stamp)

    def take_query(self, given: Input, token: int, stamp: Stamp | None) -> bool:
        """Keep a query for its step; returns whether to poke the time manager."""
        if stamp is not None:
            self._senders[token] = stamp
        return self._keep(Kind.QUERY, given, stamp)

    def take_outcome(self, given: Input, sent: Stamp, replied: Stamp | None) -> bool:
        """Keep the end of its own query for its step; returns whether to poke the time manager.

        sent: the query's stamp. replied: the reply's; None if there is no reply, because no process serves the query or
        its server has died. The time manager does not know then that no reply will come.
        """
        if replied is not None:
            order = (Kind.REPLY, replied.sender, sent.number)
            self._waiting.append(_Waiting(replied.step, replied.sender, order, given))
            return replied.step <= self._uncounted_until
        self._waiting.append(_Waiting(sent.step, self.name, (Kind.REPLY, OUTSIDE, sent.number), given))
        return True

    def _keep(self, kind: Kind, given: Input, stamp: Stamp | None) -> bool:
        if stamp is not None:
            self._waiting.append(_Waiting(stamp.step, stamp.sender, (kind, stamp.sender, stamp.number), given))
            return stamp.step <= self._uncounted_until
        self._from_outside += 1
        order = (kind, OUTSIDE, self._from_outside)
        self._waiting.append(_Waiting(self._last_granted, OUTSIDE, order, given))  # never of a step under way
        return True

    # --- acting -------------------------------------------------------------------------------------------------

    def grant(self, grant: Grant) -> None:
        """Accept a grant; one of another term, of another process or of an earlier step is ignored."""
        if grant.term == self._term and grant.process == self.process and grant.step > self._last_granted:
            self.granted = grant
            self._last_granted = grant.step

    def lacks(self) -> dict[str, int]:
        """How many of the inputs that the grant counts have not arrived, by sender."""
        if self.granted is None or not self.granted.expects:
            return {}
        before = self.granted.step - 1
        here = Counter(each.sender for each in self._waiting if each.step == before)
        return {sender: count - here[sender] for sender, count in self.granted.expects.items() if here[sender] < count}

    def computing(self) -> tuple[str, ...]:
        """Names of the running computations if one of them is due; else empty."""
        if self.granted is None:
            return ()
        due = self.scheduler.due_computations(self.granted.at)
        return () if all(future.done() for future in due) else tuple(self.scheduler.computations())

    @property
    def holds_outside(self) -> bool:
        """Whether an input from outside waits."""
        return any(each.sender == OUTSIDE for each in self._waiting)

    def ready(self) -> bool:
        """Whether it has a grant and every input that the grant counts."""
        return self.granted is not None and not self.lacks() and not self.computing()

    def act(self, transport: Transport) -> StepDone:
        """Handle the inputs of earlier steps and what is due, and carry out the actions; it must be `ready`."""
        grant = self.granted
        assert grant is not None, "a participant acts only when it is granted a step"
        self.granted = None
        self.step, self.now = grant.step, max(self.now, grant.at)
        later = []
        for each in self._waiting:
            if each.step < grant.step and not (self.hold_outside and each.sender == OUTSIDE):
                self.scheduler.put(each.order, each.given)
            else:
                later.append(each)
        self._waiting = later
        resume, self._resume = self._resume, ()
        for action in (*resume, *self.scheduler.run(self.now)):
            self._perform(action, transport)
        return self._report()

    def _next_wake(self) -> MissionTime | None:
        wake = self.scheduler.next_wake()
        return None if wake is None else max(self.now, wake)

    def _report(self) -> StepDone:
        done = StepDone(
            name=self.name,
            process=self.process,
            step=self.step,
            next_wake=self._next_wake(),
            published=tuple((topic, side, count) for (topic, side), count in self._published.items()),
            asked=tuple(self._queried),
            answered=tuple(self._replied),
            finished=None if self.finished is None else self.finished.why,
        )
        self._published.clear()
        self._queried.clear()
        self._replied.clear()
        return done

    def _perform(self, action: Action, transport: Transport) -> None:
        match action:
            case Publish(topic, side):
                self._published[topic.name, side.value] += 1
                transport.publish(action, self._stamped())
            case PutQuery(topic, side):
                self._queried.append((topic.name, side.value))
                transport.query(action, self._stamped())
            case Reply(token) | ReplyError(token):
                sent = self._senders.pop(token, None)
                if sent is not None:
                    self._replied.append((sent.process, sent.step))
                transport.reply(action, self._stamped())
            case Finish():
                self.finished = action
                transport.perform(action)
            case _:
                transport.perform(action)

    def _stamped(self) -> Stamp:
        self.scheduler.emitted += 1
        return Stamp(self.name, self.process, self.scheduler.emitted, self.step, self.now)

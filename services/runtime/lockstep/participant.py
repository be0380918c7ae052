"""One node's part in lockstep, without I/O: what has reached it, what it still has to wait for, what it did.

What reaches a node in one step is handled in the next, in the order that the simulation driver has; so a mission in
separate processes is, event for event, the mission in one. A transport (Zenoh, or a test's) carries what goes out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from schemas.lockstep import Grant, Join, Joined, StepDone
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError
from services.runtime.inputs import Input, ProcessStarted
from services.runtime.lockstep.stamp import Stamp
from services.runtime.node import Finish
from services.runtime.scheduler import Kind, NodeScheduler

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime

OUTSIDE = ""
"""Who sends what carries no stamp: operators and strangers."""


class Transport(Protocol):
    """Carries out what a participant's node wants done."""

    def publish(self, action: Publish, stamp: Stamp) -> None: ...

    def ask(self, action: PutQuery, stamp: Stamp) -> None: ...

    def answer(self, action: Reply | ReplyError, stamp: Stamp) -> None: ...

    def perform(self, action: Action) -> None:
        """Do what concerns nobody else: snapshots, notes, the end."""


@dataclass(frozen=True, slots=True)
class _Taken:
    """An input that waits for its step."""

    step: int
    sender: str
    order: tuple[Kind, str, int]
    given: Input


class Participant:
    """A seat whose clock is granted, step by step."""

    def __init__(self, scheduler: NodeScheduler, process: str, resume: Iterable[Action] = ()) -> None:
        """process: tells this start of the service from every other. resume: what a replayed journal left to do."""
        self.scheduler = scheduler
        self.process = process
        self.now: MissionTime = 0
        self.step = 0
        self.joined_at = -1
        """The step after which it first took part: who asked it something up to then was told that nobody serves."""
        self._term = ""
        self._admitted = False
        self._heard_of = 0
        self._uncounted_until = -1
        """What was sent up to this step, the time keeper has not counted."""
        self.granted: Grant | None = None
        """What it may act upon as soon as `ready`."""
        self.finished: Finish | None = None
        self._resume = tuple(resume)
        self._taken: list[_Taken] = []
        self._from_outside = 0
        self._askers: dict[int, Stamp] = {}
        self._published: Counter[tuple[str, str]] = Counter()
        self._asked: list[tuple[str, str]] = []
        self._answered: list[tuple[str, int]] = []

    @property
    def name(self) -> str:
        return self.scheduler.name

    # --- taking part --------------------------------------------------------------------------------------------

    def join(self) -> Join:
        """What the time keeper has to know of it."""
        host = self.scheduler.host
        return Join(
            term=self._term,
            name=self.name,
            process=self.process,
            hears=tuple((topic.name, side.value) for topic, side in host.received_topics()),
            serves=tuple((topic.name, side.value) for topic, side in host.served_topics()),
            next_wake=self._next_wake(),
            now=self.now,
            step=self._heard_of,
        )

    def obey(self, term: str) -> None:
        """Act upon the grants of that term from now on; what was granted before is void."""
        if term != self._term:
            self._term = term
            self._admitted = False
            self.granted = None

    def joined(self, answer: Joined) -> None:
        """The time keeper has taken it in. Time may be ahead of it, never behind; nothing sent before was counted."""
        if answer.term != self._term or self._admitted:
            return
        self._admitted = True
        self.now = max(self.now, answer.now)
        self._uncounted_until = answer.step
        if self.joined_at < 0:
            self.joined_at = answer.step

    def start(self, incarnation: int) -> None:
        """Let the node begin, in the first step that is granted."""
        self.scheduler.put((Kind.MESSAGE, OUTSIDE, 0), ProcessStarted(incarnation))

    # --- what reaches it ----------------------------------------------------------------------------------------

    def take_message(self, given: Input, stamp: Stamp | None) -> bool:
        """Keep a message for its step. Whether the time keeper has to be poked, as it cannot know of it."""
        if stamp is not None and stamp.process == self.process:
            return False  # nobody hears himself
        return self._take(Kind.MESSAGE, given, stamp)

    def take_question(self, given: Input, token: int, stamp: Stamp | None) -> bool:
        """Keep a question for its step. Whether the time keeper has to be poked."""
        if stamp is not None:
            self._askers[token] = stamp
        return self._take(Kind.QUERY, given, stamp)

    def take_answer(self, given: Input, asked: Stamp, answered: Stamp | None) -> bool:
        """Keep what came of a question that was put with the stamp `asked`. Whether the time keeper has to be poked.

        One without a stamp came from nowhere: nobody serves, or the one who does died before answering, and then the
        time keeper does not know that the answer will never come.
        """
        if answered is not None:
            order = (Kind.REPLY, answered.sender, asked.number)
            self._taken.append(_Taken(answered.step, answered.sender, order, given))
            return answered.step <= self._uncounted_until
        self._taken.append(_Taken(asked.step, self.name, (Kind.REPLY, OUTSIDE, asked.number), given))
        return True

    def _take(self, kind: Kind, given: Input, stamp: Stamp | None) -> bool:
        if stamp is not None:
            self._taken.append(_Taken(stamp.step, stamp.sender, (kind, stamp.sender, stamp.number), given))
            return stamp.step <= self._uncounted_until
        self._from_outside += 1
        self._taken.append(_Taken(0, OUTSIDE, (kind, OUTSIDE, self._from_outside), given))
        return True

    # --- acting -------------------------------------------------------------------------------------------------

    def grant(self, grant: Grant) -> None:
        """It may act, once everything is there."""
        if grant.term == self._term and grant.process == self.process and grant.step > self._heard_of:
            self.granted = grant
            self._heard_of = grant.step

    def lacks(self) -> dict[str, int]:
        """How many of the inputs that are promised for the step have not come, by sender."""
        if self.granted is None or not self.granted.expects:
            return {}
        before = self.granted.step - 1
        here = Counter(taken.sender for taken in self._taken if taken.step == before)
        return {who: count - here[who] for who, count in self.granted.expects.items() if here[who] < count}

    def computing(self) -> tuple[str, ...]:
        """The computations that must end before it can act."""
        if self.granted is None:
            return ()
        due = self.scheduler.due_computations(self.granted.at)
        return () if all(future.done() for future in due) else tuple(self.scheduler.computations())

    def ready(self) -> bool:
        """Whether it has been granted a step and has everything that it needs for it."""
        return self.granted is not None and not self.lacks() and not self.computing()

    def act(self, transport: Transport) -> StepDone:
        """Handle what was sent in earlier steps and what is due, and let all that follows happen; `ready` must hold."""
        grant = self.granted
        assert grant is not None, "a participant acts only when it is granted a step"
        self.granted = None
        self.step, self.now = grant.step, max(self.now, grant.at)
        waiting = []
        for taken in self._taken:
            if taken.step < grant.step:
                self.scheduler.put(taken.order, taken.given)
            else:
                waiting.append(taken)
        self._taken = waiting
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
            asked=tuple(self._asked),
            answered=tuple(self._answered),
            finished=None if self.finished is None else self.finished.why,
        )
        self._published.clear()
        self._asked.clear()
        self._answered.clear()
        return done

    def _perform(self, action: Action, transport: Transport) -> None:
        match action:
            case Publish(topic, side):
                self._published[topic.name, side.value] += 1
                transport.publish(action, self._stamped())
            case PutQuery(topic, side):
                self._asked.append((topic.name, side.value))
                transport.ask(action, self._stamped())
            case Reply(token) | ReplyError(token):
                asked = self._askers.pop(token, None)
                if asked is not None:
                    self._answered.append((asked.process, asked.step))
                transport.answer(action, self._stamped())
            case Finish():
                self.finished = action
                transport.perform(action)
            case _:
                transport.perform(action)

    def _stamped(self) -> Stamp:
        self.scheduler.emitted += 1
        return Stamp(self.name, self.process, self.scheduler.emitted, self.step, self.now)

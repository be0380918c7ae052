"""A node in a process of its own, in virtual time: it acts when the time keeper says so, and only then.

What it receives it keeps until the step after the one in which it was sent; then it handles it in the same order as
the simulation driver would. So a mission in separate processes is, event for event, the mission in one.
"""

from __future__ import annotations

import contextlib
import os
import queue
import time
from collections import Counter
from concurrent.futures import Future, wait
from dataclasses import dataclass
from functools import partial
from typing import Any

from he3.errors import He3Error, PeerUnreachable
from schemas import topics
from schemas.lockstep import Grant, Join, Poke, StepBusy, StepDone
from schemas.topics import Side, Topic
from schemas.wire import Header, Refused, Wire, decode, decode_reply, encode
from services.actions import Action, Publish, PutQuestion, Reply, ReplyError
from services.bus import Question
from services.host import Input
from services.node import Finish, Silence
from services.questions import request_of
from services.run import CLOCKS, IDLE_S, Process
from services.seat import Kind
from services.stamp import Stamp, read_stamp

JOIN = {Side.MOON: topics.MOON_JOIN, Side.EARTH: topics.EARTH_JOIN}
GRANT = {Side.MOON: topics.MOON_GRANT, Side.EARTH: topics.EARTH_GRANT}
DONE = {Side.MOON: topics.MOON_DONE, Side.EARTH: topics.EARTH_DONE}
BUSY = {Side.MOON: topics.MOON_BUSY, Side.EARTH: topics.EARTH_BUSY}
POKE = {Side.MOON: topics.MOON_POKE, Side.EARTH: topics.EARTH_POKE}

TO_KEEPER = (DONE, BUSY, POKE)
"""Topic families by which a process speaks to the time keeper."""

OUTSIDE = ""
"""Who sends what carries no stamp: operators and strangers."""


@dataclass(slots=True)
class _Taken:
    """An input that waits for its step."""

    step: int
    counted: bool
    """Whether the time keeper knows of it; what comes from outside it cannot know."""
    kind: Kind
    sender: str
    number: int
    given: Input


class StoppedWaiting(Exception):
    """Told to stop while a computation or a message was waited for."""


class LockstepProcess(Process):
    """A process whose clock is granted, step by step."""

    _step = 0
    _identity = f"{os.getpid()}.{time.time_ns()}"

    def learn_time(self) -> bool:
        """Join, and learn where virtual time stands; False when told to stop first."""
        self._taken: list[_Taken] = []
        self._tally: Counter[tuple[str, str]] = Counter()
        self._asked_topics: list[str] = []
        self._answered_names: list[str] = []
        self._askers: dict[int, tuple[str, int]] = {}
        self._finished: Finish | None = None
        self._home = next(iter(self.buses))
        self.seat.put((Kind.MESSAGE, OUTSIDE, 0), Input("start", (self._incarnation,)))
        return self.take_part()

    def take_part(self) -> bool:
        """Join over the network; the answer to the join is where time stands."""
        bus = self.buses[self._home]
        bus.subscribe(CLOCKS[self._home], lambda payload, _: self.later(partial(self.set_clock, self._home, payload)))
        bus.subscribe(GRANT[self._home], lambda payload, _: self.later(partial(self._granted, payload)))
        told = False
        while not self.stop.event.is_set() and not self._joined:
            payload = encode(self._header(), self.join_request())
            bus.ask(JOIN[self._home], payload, 2.0, lambda answer, *_: self.later(partial(self._take_joined, answer)))
            until = time.monotonic() + IDLE_S
            while not self._joined and time.monotonic() < until and not self.stop.event.is_set():
                with contextlib.suppress(queue.Empty):
                    self.stop.inbox.get(timeout=IDLE_S)()
            if not self._joined and not told:
                self.log.warning(f"no time keeper answers on {JOIN[self._home].key(self.mission)}; still trying")
                told = True
        return not self.stop.event.is_set()

    _joined = False

    def join_request(self) -> Join:
        """What this process hears and serves."""
        host = self.seat.host
        heard = [(topic.name, side.value) for topic, side in host.heard_topics()]
        return Join(
            name=self.name,
            process=self._identity,
            hears=tuple(heard),
            serves=tuple(topic.name for topic in host.interface.serves),
            next_wake=self.seat.next_wake(),
        )

    def _take_joined(self, answer: bytes | Silence) -> None:
        if self._joined or isinstance(answer, Silence):
            return
        try:
            _, joined = decode_reply(JOIN[self._home], answer, self.mission)
        except Refused as refusal:
            raise PeerUnreachable(f"the time keeper speaks another language: {refusal}") from None
        self._joined = True
        self._last = max(self._last, joined.now)
        self._step = joined.step

    # --- the loop -----------------------------------------------------------------------------------------------

    def _loop(self) -> None:
        while not self.stop.event.is_set():
            with contextlib.suppress(queue.Empty):
                self.stop.inbox.get(timeout=IDLE_S)()
            self.heartbeat.beat(time.monotonic(), self._last)

    def _granted(self, payload: bytes) -> None:
        try:
            _, grant = decode(GRANT[self._home], payload, self.mission)
        except Refused as refusal:
            self.log.warning(f"refused: {refusal}")
            return
        if self.name in grant.expects:
            with contextlib.suppress(StoppedWaiting):
                self.report(self.act(grant))

    def act(self, grant: Grant) -> StepDone:
        """Take in what the grant says is there, given it, and do what follows; raises StoppedWaiting."""
        self._await_inputs(grant)
        self._step = grant.step
        self._last = max(self._last, grant.at)
        self._await_computations(grant)
        ready = [taken for taken in self._taken if taken.step < grant.step]
        self._taken = [taken for taken in self._taken if taken.step >= grant.step]
        for taken in ready:
            self.seat.put((taken.kind, taken.sender, taken.number), taken.given)
        self.perform_all(self._resume)
        self._resume = []
        self.perform_all(self.seat.run(self._last))
        report = StepDone(
            name=self.name,
            step=grant.step,
            next_wake=self.seat.next_wake(),
            published=tuple((topic, side, count) for (topic, side), count in sorted(self._tally.items())),
            asked=tuple(self._asked_topics),
            answered=tuple(self._answered_names),
            finished=None if self._finished is None else self._finished.why,
            ok=self._finished is None or self._finished.ok,
        )
        self._tally.clear()
        self._asked_topics = []
        self._answered_names = []
        return report

    def report(self, done: StepDone) -> None:
        """Tell the time keeper."""
        self._tell(DONE, done)

    def _await_inputs(self, grant: Grant) -> None:
        expected = grant.expects[self.name]
        while sum(1 for taken in self._taken if taken.step < grant.step and taken.counted) < expected:
            if self.stop.event.is_set():
                raise StoppedWaiting
            with contextlib.suppress(queue.Empty):
                self.stop.inbox.get(timeout=IDLE_S)()
            self.heartbeat.beat(time.monotonic(), self._last)

    def _await_computations(self, grant: Grant) -> None:
        due: list[Future[Any]] = self.seat.due_computations(grant.at)
        if not due or all(future.done() for future in due):
            return
        busy = StepBusy(name=self.name, step=grant.step, computing=tuple(self.seat.computations()))
        self._tell(BUSY, busy)
        while not all(future.done() for future in due):
            if self.stop.event.is_set():
                raise StoppedWaiting
            wait(due, timeout=0.1)
            self.heartbeat.beat(time.monotonic(), self._last)

    # --- what goes out ------------------------------------------------------------------------------------------

    def _perform(self, action: Action) -> None:
        match action:
            case Publish(topic, side, payload):
                self.seat.emitted += 1
                self._tally[topic.name, side.value] += 1
                self.buses[side].publish(topic, payload, self._stamp(self.seat.emitted))
            case PutQuestion(topic, side, payload, question, timeout_s):
                self._asked_topics.append(topic.name)
                self.seat.emitted += 1
                number = self.seat.emitted
                on_end = partial(self._answer_came_in, question, self._step, number)
                self.buses[side].ask(topic, payload, timeout_s, on_end, self._stamp(number))
            case Reply(token, _, payload):
                stamp = self._answer_stamp(token)
                self._question_of(token, lambda question: question.reply(payload, stamp))
            case ReplyError(token, _, why):
                stamp = self._answer_stamp(token)
                self._question_of(token, lambda question: question.refuse(why, stamp))
            case Finish():
                self._finished = action
                super()._perform(action)
            case _:
                super()._perform(action)

    def _stamp(self, number: int) -> bytes:
        return Stamp(self.name, number, self._step, self._last).encode()

    def _answer_stamp(self, token: int) -> bytes:
        asker, number = self._askers.pop(token, (OUTSIDE, 0))
        if asker != OUTSIDE:
            self._answered_names.append(asker)
        return self._stamp(number)

    def _tell(self, family: dict[Side, Topic], body: Wire) -> None:
        self.buses[self._home].publish(family[self._home], encode(self._header(), body))

    def _header(self) -> Header:
        return Header(
            mission=self.mission,
            source=self.name,
            incarnation=self.seat.host.incarnation,
            sequence=self._step,
            made_at=max(0, self._last),
        )

    # --- what comes in, in other threads ------------------------------------------------------------------------

    def _came(self, topic: Topic, payload: bytes, attachment: bytes) -> None:
        given = Input("deliver", (topic, payload))
        self.later(partial(self._take, Kind.MESSAGE, read_stamp(attachment), given))

    def _asked(self, topic: Topic, question: Question) -> None:
        self.later(partial(self._take_question, topic, question))

    def _answer_came_in(
        self, name: str, step: int, number: int, answer: bytes | Silence, detail: str, attachment: bytes
    ) -> None:
        if isinstance(answer, bytes):
            given = Input("answered", (name, answer))
        else:
            given = Input("unanswered", (name, answer, detail))
        stamp = read_stamp(attachment)
        if stamp is None:
            # An answer from nowhere (nobody serves, or nobody in time) belongs to the step in which it was asked for.
            self.later(partial(self._take_silence, Stamp(OUTSIDE, number, step, self._last), given))
        else:
            self.later(partial(self._take, Kind.QUESTION, stamp, given))

    # --- taking it in, in the loop ------------------------------------------------------------------------------

    def _take(self, kind: Kind, stamp: Stamp | None, given: Input) -> None:
        if stamp is not None:
            self._taken.append(_Taken(stamp.step, True, kind, stamp.sender, stamp.number, given))
            return
        self._counter += 1
        self._taken.append(_Taken(0, False, kind, OUTSIDE, self._counter, given))
        self.poke()

    def _take_silence(self, stamp: Stamp, given: Input) -> None:
        self._taken.append(_Taken(stamp.step, True, Kind.QUESTION, OUTSIDE, stamp.number, given))
        self.poke()  # the one who was to answer may have died, and then nobody expects this

    def poke(self) -> None:
        """Ask the time keeper to let this process act now."""
        self._tell(POKE, Poke(name=self.name))

    def _take_question(self, topic: Topic, question: Question) -> None:
        self._counter += 1
        token = self._counter
        payload = question.payload
        stamp = read_stamp(question.attachment)
        if payload is not None:
            given = Input("ask", (topic, payload, token))
        else:
            try:
                request: Wire = request_of(topic, question.parameters)
            except He3Error as error:
                question.refuse(str(error))
                return
            given = Input("ask_checked", (topic, request, token))
        self._tokens[token] = question
        if stamp is not None:
            self._askers[token] = (stamp.sender, stamp.number)
        self._take(Kind.QUESTION, stamp, given)

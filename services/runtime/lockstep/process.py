"""A node in a process of its own, in virtual time: it acts when the time keeper says so, and only then."""

from __future__ import annotations

import contextlib
import os
import queue
import secrets
import time
from functools import partial

from he3.errors import He3Error, InvalidInput, PeerUnreachable
from schemas import topics
from schemas.codec import Refused, decode, decode_reply, encode
from schemas.lockstep import Poke, StepBusy, StepDone
from schemas.refusal import Refusal
from schemas.topics import Side, Topic, addressed, counted
from schemas.wire import Header, Wire
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError
from services.runtime.drivers.wall_clock import CLOCKS, IDLE_S, Process, Service, Stop
from services.runtime.inputs import (
    Input,
    MessageArrived,
)
from services.runtime.lockstep.participant import Participant
from services.runtime.lockstep.stamp import Stamp, read_stamp
from services.runtime.node import NoReply
from services.runtime.options import Options
from services.runtime.queries.inputs import outcome_input, query_input
from services.runtime.refusals import refusal_of
from services.runtime.transport.session import IncomingQuery, NotReplied, Outcome

JOIN = {Side.MOON: topics.MOON_JOIN, Side.EARTH: topics.EARTH_JOIN}
GRANT = {Side.MOON: topics.MOON_GRANT, Side.EARTH: topics.EARTH_GRANT}
DONE = {Side.MOON: counted(topics.MOON_DONE), Side.EARTH: counted(topics.EARTH_DONE)}
BUSY = {Side.MOON: counted(topics.MOON_BUSY), Side.EARTH: counted(topics.EARTH_BUSY)}
POKE = {Side.MOON: counted(topics.MOON_POKE), Side.EARTH: counted(topics.EARTH_POKE)}


def grant_to(name: str, side: Side) -> Topic:
    """The topic of the grants to that process."""
    return counted(addressed(GRANT[side], name))


TO_KEEPER = (DONE, BUSY, POKE)
"""Topic families by which a process speaks to the time keeper."""

MEMBERS = "member"
"""Register of those who take part: each start of a process with a liveliness token of its own."""

ASKS_AGAIN_S = 1.0
"""A process that has not been granted anything for so long asks whether it still takes part."""
SILENT_AFTER_S = 5.0
"""A time keeper that neither grants anything nor answers for so long is reported."""
LACKS_LONG_S = 1.0
"""A process tells that inputs are missing when they have been for so long."""
FOREVER_S = 1e6
"""Questions end with their answer or with the process that owes it, never by the wall clock."""


class LockstepProcess(Process):
    """A process whose clock is granted, step by step."""

    def __init__(self, service: Service, options: Options, stop: Stop) -> None:
        super().__init__(service, options, stop)
        self.process_id = f"{service.name}.{os.getpid()}.{secrets.token_hex(4)}"
        self._joined = False
        self._asked_at = 0.0
        self._granted_at = 0.0
        self._clock_at = time.monotonic()
        self._told_silent = False
        self._told_busy: StepBusy | None = None
        self._counted_topics: dict[str, Topic] = {}
        self._early: list[tuple[Topic, IncomingQuery]] = []

    def learn_time(self) -> bool:
        """Join, and learn where virtual time stands; False when told to stop first."""
        self.part = Participant(self.scheduler, self.process_id, self._resume)
        self.part.now = self._last
        self._home = next(iter(self.sessions))
        return self.take_part()

    def take_part(self) -> bool:
        """Join over the network; the answer to the join is where time stands."""
        session, home = self.sessions[self._home], self._home
        session.subscribe(CLOCKS[home], lambda payload, _: self.later(partial(self.set_clock, home, payload)))
        session.subscribe(grant_to(self.name, home), lambda payload, _: self.later(partial(self._granted, payload)))
        session.declare_alive(self.process_id, home, MEMBERS)
        began = time.monotonic()
        told = False
        while not self.stop.event.is_set() and not self._joined:
            self._ask_whether_i_take_part()
            with contextlib.suppress(queue.Empty):
                self.stop.inbox.get(timeout=IDLE_S)()
            if not self._joined and not told and time.monotonic() - began > ASKS_AGAIN_S:
                self.log.warning(f"not taken in on {JOIN[home].key(self.mission)} yet; still trying")
                told = True
        return not self.stop.event.is_set()

    def _ask_whether_i_take_part(self) -> None:
        now = time.monotonic()
        if now - self._asked_at < ASKS_AGAIN_S:
            return
        self._asked_at = now
        self.sessions[self._home].query(
            JOIN[self._home],
            encode(self.header(), self.part.join()),
            ASKS_AGAIN_S,
            lambda outcome: self.later(partial(self._take_joined, outcome)),
        )

    def _take_joined(self, outcome: Outcome) -> None:
        if isinstance(outcome, NotReplied):
            if outcome.why is NoReply.REFUSED:
                raise He3Error(outcome.detail)
            return  # nobody there, or a step is under way; ask again
        try:
            _, joined = decode_reply(JOIN[self._home], outcome.payload, self.mission)
        except Refused as refusal:
            raise PeerUnreachable(f"the time keeper speaks another language: {refusal}") from None
        if not joined.admitted:
            self.part.obey(joined.term)
            self._asked_at = 0.0
            self._ask_whether_i_take_part()
            return
        self.part.joined(joined)
        self._last = self.part.now
        if not self._joined:
            self._joined = True
            self.part.start(max(self._incarnation, joined.starts))
            early, self._early = self._early, []
            for topic, query in early:
                self._take_question(topic, query)

    # --- the loop -----------------------------------------------------------------------------------------------

    def _loop(self) -> None:
        while not self.stop.event.is_set():
            with contextlib.suppress(queue.Empty):
                self.stop.inbox.get(timeout=IDLE_S)()
            self.go_on()
            self._look_after_the_keeper()
            self.heartbeat.beat(time.monotonic(), self._last)

    def _look_after_the_keeper(self) -> None:
        now = time.monotonic()
        if now - self._granted_at > ASKS_AGAIN_S:
            self._ask_whether_i_take_part()
        if now - max(self._granted_at, self._clock_at) > SILENT_AFTER_S and not self._told_silent:
            self._told_silent = True
            self.log.warning(f"nothing heard of the time keeper for {SILENT_AFTER_S:g} s; waiting for it")

    def set_clock(self, side: Side, payload: bytes) -> None:
        super().set_clock(side, payload)
        self._clock_at = time.monotonic()
        if self._told_silent:
            self._told_silent = False
            self.log.info("the time keeper is back")

    def _granted(self, payload: bytes) -> None:
        try:
            _, grant = decode(grant_to(self.name, self._home), payload, self.mission)
        except Refused as refusal:
            self.log.warning(f"refused: {refusal}")
            return
        if grant.process != self.process_id and grant.at >= self.part.now:
            raise He3Error(f"another process has taken part as {self.name} since: {grant.process}")
        self._granted_at = time.monotonic()
        self.part.grant(grant)

    def go_on(self) -> None:
        """Act, if that has been granted and everything for it is there; else say for what it waits."""
        if self.part.granted is None:
            return
        if self.part.ready():
            self._last = max(self._last, self.part.granted.at)
            self.report(self.part.act(self))
            self._told_busy = None
            return
        lacks = self.part.lacks() if time.monotonic() - self._granted_at > LACKS_LONG_S else {}
        busy = StepBusy(
            name=self.name,
            process=self.process_id,
            step=self.part.granted.step,
            computing=self.part.computing(),
            lacks=lacks,
        )
        if (busy.computing or busy.lacks) and busy != self._told_busy:
            self._told_busy = busy
            self.tell(BUSY, busy)

    def report(self, done: StepDone) -> None:
        """Tell the time keeper what was done."""
        self.tell(DONE, done)

    def poke(self) -> None:
        """Ask the time keeper to let this process act now."""
        self.tell(POKE, Poke(name=self.name, process=self.process_id))

    def tell(self, family: dict[Side, Topic], body: Wire) -> None:
        """Say something to the time keeper."""
        self.sessions[self._home].publish(family[self._home], encode(self.header(), body))

    def header(self) -> Header:
        return Header(
            mission=self.mission,
            source=self.name,
            incarnation=self.scheduler.host.incarnation,
            sequence=self.part.step,
            made_at=self._last,
        )

    # --- what goes out ------------------------------------------------------------------------------------------

    def heard_as(self, topic: Topic) -> Topic:
        return counted(topic)

    def publish(self, action: Publish, stamp: Stamp) -> None:
        """Twice: for those who take part, who count and are waited for, and for onlookers, as they come along."""
        session, attachment = self.sessions[action.side], stamp.encode()
        session.publish(self._counted(action.topic), action.payload, attachment)
        session.publish_best_effort(action.topic, action.payload, attachment)

    def _counted(self, topic: Topic) -> Topic:
        if topic.name not in self._counted_topics:
            self._counted_topics[topic.name] = counted(topic)
        return self._counted_topics[topic.name]

    def _publish_quietly(self, topic: Topic, side: Side, payload: bytes) -> None:
        self.sessions[side].publish_best_effort(topic, payload)

    def ask(self, action: PutQuery, stamp: Stamp) -> None:
        on_end = partial(self._answer_came_in, action.query, stamp)
        self.sessions[action.side].query(action.topic, action.payload, FOREVER_S, on_end, stamp.encode())

    def answer(self, action: Reply | ReplyError, stamp: Stamp) -> None:
        match action:
            case Reply(token, _, payload):
                self._question_of(token, lambda query: query.reply(payload, stamp.encode()))
            case ReplyError(token, _, why, code):
                refusal = Refusal(why, code, stamp.encode().decode())
                self._question_of(token, lambda query: query.refuse(refusal))

    def perform(self, action: Action) -> None:
        self._perform(action)

    # --- what comes in, in other threads ------------------------------------------------------------------------

    def _came(self, topic: Topic, payload: bytes, attachment: bytes) -> None:
        self.later(partial(self._take, MessageArrived(topic, payload), attachment))

    def _asked(self, topic: Topic, query: IncomingQuery) -> None:
        self.later(partial(self._take_question, topic, query))

    def _answer_came_in(self, name: str, asked: Stamp, outcome: Outcome) -> None:
        self.later(partial(self._take_answer, outcome_input(name, outcome), asked, outcome.attachment))

    # --- taking it in, in the loop ------------------------------------------------------------------------------

    def _take(self, given: Input, attachment: bytes) -> None:
        self._poke_if(self.part.take_message(given, read_stamp(attachment)))

    def _take_answer(self, given: Input, asked: Stamp, attachment: bytes) -> None:
        self._poke_if(self.part.take_answer(given, asked, read_stamp(attachment)))

    def _take_question(self, topic: Topic, query: IncomingQuery) -> None:
        stamp = read_stamp(query.attachment)
        if not self._joined:
            self._early.append((topic, query))
            return
        if stamp is not None and stamp.step <= self.part.joined_at:
            query.drop()  # its asker counts on nobody's answering: this process did not take part then
            return
        self._counter += 1
        token = self._counter
        try:
            given = query_input(topic, query, token)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            return
        self._tokens[token] = query
        self._poke_if(self.part.take_question(given, token, stamp))

    def _poke_if(self, needed: bool) -> None:
        if needed and self._joined:
            self.poke()

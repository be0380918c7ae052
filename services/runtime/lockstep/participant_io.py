"""The inputs and outputs of one participant's node over Zenoh, with the stamps of lockstep."""

from __future__ import annotations

import os
import secrets
import time
from functools import partial
from typing import TYPE_CHECKING, Protocol

from he3.errors import InvalidInput
from schemas.lockstep import StepBusy, StepDone
from schemas.refusal import Refusal
from schemas.topics import Topic, counted
from schemas.wire import Header
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError
from services.runtime.inputs import Input, MessageArrived
from services.runtime.lockstep.participant import Participant
from services.runtime.refusals import refusal_of
from services.runtime.stamp import Stamp, read_stamp
from services.runtime.transport.inputs import outcome_input, query_input

if TYPE_CHECKING:
    from services.runtime.context import ProcessContext
    from services.runtime.transport.session import IncomingQuery, Outcome

LACKS_LONG_S = 1.0
"""A process reports missing inputs when they have been missing for this long."""
NO_TIMEOUT_S = 1e6
"""Queries between participants end with the reply or with the end of the server, never by a timeout."""


class ToTimeManager(Protocol):
    """The participant's way to the time manager: over Zenoh, or a call in the link's own process."""

    def report(self, done: StepDone) -> None:
        """Report what was done in a step."""

    def report_busy(self, busy: StepBusy) -> None:
        """Report why a step cannot be done yet."""

    def poke(self) -> None:
        """Ask for a step because an input waits that the time manager does not know of."""


class ParticipantIO:
    """One participant with its sessions; all but what Zenoh calls belongs to the main loop."""

    def __init__(self, context: ProcessContext, manager: ToTimeManager) -> None:
        self._context = context
        self._manager = manager
        self.process_id = f"{context.name}.{os.getpid()}.{secrets.token_hex(4)}"
        """Identifies this start of the service."""
        self.participant = Participant(context.scheduler, self.process_id, context.resume)
        self.participant.now = context.clock.latest
        self.joined = False
        self.granted_at_s = 0.0
        """Wall time [s, monotonic] of the last grant."""
        self._reported_busy: StepBusy | None = None
        self._counted_topics: dict[str, Topic] = {}
        self._early: list[tuple[Topic, IncomingQuery]] = []

    def start(self, incarnation: int) -> None:
        """Begin to take part: start the node, and handle the queries that arrived before."""
        self.joined = True
        self.participant.start(incarnation)
        early, self._early = self._early, []
        for topic, query in early:
            self._take_query(topic, query)

    def header(self) -> Header:
        """The header of a message between this process and the time manager."""
        return Header(
            mission=self._context.mission,
            source=self._context.name,
            incarnation=self._context.scheduler.host.incarnation,
            sequence=self.participant.step,
            made_at=self._context.clock.latest,
        )

    def step(self) -> None:
        """Act if a step is granted and all its inputs have arrived; else report what is missing."""
        participant = self.participant
        if participant.granted is None:
            return
        if participant.ready():
            self._context.clock.advance(participant.granted.at)
            self._manager.report(participant.act(self))
            self._reported_busy = None
            return
        lacks = participant.lacks() if time.monotonic() - self.granted_at_s > LACKS_LONG_S else {}
        busy = StepBusy(
            name=self._context.name,
            process=self.process_id,
            step=participant.granted.step,
            computing=participant.computing(),
            lacks=lacks,
        )
        if (busy.computing or busy.lacks) and busy != self._reported_busy:
            self._reported_busy = busy
            self._manager.report_busy(busy)

    # --- what the node sends (participant.Transport) ------------------------------------------------------------

    def publish(self, action: Publish, stamp: Stamp) -> None:
        """Publish twice: to participants, who count messages and wait for them, and to onlookers, best effort."""
        session, attachment = self._context.sessions[action.side], stamp.encode()
        session.publish(self.received_as(action.topic), action.payload, attachment)
        session.publish_best_effort(action.topic, action.payload, attachment)

    def query(self, action: PutQuery, stamp: Stamp) -> None:
        on_end = partial(self._on_outcome, action.query, stamp)
        session = self._context.sessions[action.side]
        counts = self._context.scheduler.host.reply_check(action.topic, stamp.at)
        session.query(action.topic, action.payload, NO_TIMEOUT_S, on_end, stamp.encode(), counts=counts)

    def reply(self, action: Reply | ReplyError, stamp: Stamp) -> None:
        match action:
            case Reply(token, _, payload):
                self._context.open_queries.reply(token, payload, stamp.encode())
            case ReplyError(token, _, why, code):
                self._context.open_queries.refuse(token, Refusal(why, code, stamp.encode().decode()))

    def perform(self, action: Action) -> None:
        self._context.perform(action)

    # --- what arrives, in Zenoh's threads (context.Traffic) -----------------------------------------------------

    def received_as(self, topic: Topic) -> Topic:
        if topic.name not in self._counted_topics:
            self._counted_topics[topic.name] = counted(topic)
        return self._counted_topics[topic.name]

    def on_message(self, topic: Topic, payload: bytes, attachment: bytes) -> None:
        self._context.inbox.put(partial(self._take_message, MessageArrived(topic, payload), attachment))

    def on_query(self, topic: Topic, query: IncomingQuery) -> None:
        self._context.inbox.put(partial(self._take_query, topic, query))

    def _on_outcome(self, query: str, asked: Stamp, outcome: Outcome) -> None:
        self._context.inbox.put(partial(self._take_outcome, outcome_input(query, outcome), asked, outcome.attachment))

    # --- taking it in, in the main loop -------------------------------------------------------------------------

    def _take_message(self, given: Input, attachment: bytes) -> None:
        self._poke_if(self.participant.take_message(given, read_stamp(attachment)))

    def _take_outcome(self, given: Input, asked: Stamp, attachment: bytes) -> None:
        self._poke_if(self.participant.take_outcome(given, asked, read_stamp(attachment)))

    def _take_query(self, topic: Topic, query: IncomingQuery) -> None:
        stamp = read_stamp(query.attachment)
        if not self.joined:
            self._early.append((topic, query))
            return
        if stamp is not None and stamp.step <= self.participant.joined_at:
            query.drop()  # its sender expects no reply: this process did not take part then
            return
        token = self._context.open_queries.next_token()
        try:
            given = query_input(topic, query, token)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            self._context.refused(topic, error)
            return
        self._context.open_queries.add(token, query)
        self._poke_if(self.participant.take_query(given, token, stamp))

    def _poke_if(self, needed: bool) -> None:
        if needed and self.joined:
            self._manager.poke()

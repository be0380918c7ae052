"""The driver of a node in a process of its own in virtual time: it acts when the time manager grants it, only then."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from he3.errors import PeerUnreachable
from schemas.codec import Refused, decode, decode_reply, encode
from schemas.lockstep import Poke, StepBusy, StepDone
from schemas.topics import MEMBERS
from services.runtime.context import IDLE_S, ProcessContext
from services.runtime.lockstep.participant_io import ParticipantIO
from services.runtime.lockstep.topics import BUSY, DONE, JOIN, POKE, grant_to
from services.runtime.node import NoReply
from services.runtime.process_clock import CLOCKS
from services.runtime.role_claim import RoleRefused
from services.runtime.transport.session import NotReplied, Outcome

if TYPE_CHECKING:
    from schemas.topics import Side, Topic
    from schemas.wire import Wire

ASKS_AGAIN_S = 1.0
"""A process that has received no grant for this long asks whether it still takes part."""
SILENT_AFTER_S = 5.0
"""A time manager that sends neither a grant nor its status for this long is reported."""


class LockstepDriver:
    """Takes part in lockstep over the network."""

    def __init__(self, context: ProcessContext) -> None:
        self._context = context
        self._io = ParticipantIO(context, self)
        self._side = context.scheduler.host.interface.sides[0]
        self._asked_at_s = 0.0
        self._clock_at_s = time.monotonic()
        self._reported_silent = False

    @property
    def traffic(self) -> ParticipantIO:
        return self._io

    # --- joining ------------------------------------------------------------------------------------------------

    def begin(self) -> bool:
        """Join; the reply has the present virtual time."""
        context, side, inbox = self._context, self._side, self._context.inbox
        session = context.sessions[side]
        session.subscribe(CLOCKS[side], context.backlog.receiving(inbox, CLOCKS[side], self._take_clock))
        grants = grant_to(context.name, side)
        session.subscribe(grants, lambda payload, _: inbox.put(partial(self._take_grant, payload)))
        session.declare_alive(self._io.process_id, side, MEMBERS)
        began = time.monotonic()
        reported = False
        while not inbox.stopped.is_set() and not self._io.joined:
            self._ask_to_take_part()
            inbox.take(IDLE_S)
            if not self._io.joined and not reported and time.monotonic() - began > ASKS_AGAIN_S:
                context.log.warning(f"waiting for the time manager on {JOIN[side].key(context.mission)}")
                reported = True
        return not inbox.stopped.is_set()

    def _ask_to_take_part(self) -> None:
        now = time.monotonic()
        if now - self._asked_at_s < ASKS_AGAIN_S:
            return
        self._asked_at_s = now
        self._context.sessions[self._side].query(
            JOIN[self._side],
            encode(self._io.header(), self._io.participant.join()),
            ASKS_AGAIN_S,
            lambda outcome: self._context.inbox.put(partial(self._take_joined, outcome)),
        )

    def _take_joined(self, outcome: Outcome) -> None:
        if isinstance(outcome, NotReplied):
            if outcome.why is NoReply.REFUSED:
                raise RoleRefused(outcome.detail)
            return  # no time manager yet, or a step is under way: it asks again
        try:
            _, joined = decode_reply(JOIN[self._side], outcome.payload, self._context.mission)
        except Refused as refusal:
            raise PeerUnreachable(f"expected a reply of the time manager, got another one: {refusal}") from None
        participant = self._io.participant
        if not joined.admitted:
            participant.obey(joined.term)
            self._asked_at_s = 0.0
            self._ask_to_take_part()
            return
        participant.joined(joined)
        self._context.clock.latest = participant.now
        if not self._io.joined:
            self._io.start(max(self._context.incarnation, joined.starts))

    # --- the main loop ------------------------------------------------------------------------------------------

    def run(self) -> None:
        inbox = self._context.inbox
        while not inbox.stopped.is_set():
            inbox.take(IDLE_S)
            self._io.step()
            self._look_after_time_manager()
            self._context.beat(time.monotonic())

    def _look_after_time_manager(self) -> None:
        now = time.monotonic()
        granted_at_s = self._io.granted_at_s
        if now - granted_at_s > ASKS_AGAIN_S:
            self._ask_to_take_part()
        if now - max(granted_at_s, self._clock_at_s) > SILENT_AFTER_S and not self._reported_silent:
            self._reported_silent = True
            self._context.log.warning(f"the time manager has been silent for {SILENT_AFTER_S:g} s; waiting for it")

    def _take_clock(self, payload: bytes) -> None:
        try:
            _, state = decode(CLOCKS[self._side], payload, self._context.mission)
        except Refused as refusal:
            self._context.refused(CLOCKS[self._side], refusal)
            return
        self._context.clock.follow(state)
        self._clock_at_s = time.monotonic()
        if self._reported_silent:
            self._reported_silent = False
            self._context.log.info("the time manager is back")

    def _take_grant(self, payload: bytes) -> None:
        name, participant = self._context.name, self._io.participant
        try:
            _, grant = decode(grant_to(name, self._side), payload, self._context.mission)
        except Refused as refusal:
            self._context.refused(grant_to(name, self._side), refusal)
            return
        if grant.process != self._io.process_id and grant.at >= participant.now:
            raise RoleRefused(f"another process has taken part as {name} since: {grant.process}")
        self._io.granted_at_s = time.monotonic()
        participant.grant(grant)

    # --- to the time manager (participant_io.ToTimeManager) -----------------------------------------------------

    def report(self, done: StepDone) -> None:
        self._publish(DONE, done)

    def report_busy(self, busy: StepBusy) -> None:
        self._publish(BUSY, busy)

    def poke(self) -> None:
        self._publish(POKE, Poke(name=self._context.name, process=self._io.process_id))

    def _publish(self, family: dict[Side, Topic], body: Wire) -> None:
        self._context.sessions[self._side].publish(family[self._side], encode(self._io.header(), body))

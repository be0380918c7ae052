"""The driver of a node in a process of its own on the wall clock: at rate 1 or faster.

The main loop is the only thread that touches the node. It handles what is due at the time at which it was due, and
what arrives at the time at which it is taken in.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Protocol

from he3.errors import InvalidInput
from schemas.codec import Refused, decode
from schemas.refusal import Refusal
from services.runtime.actions import Action, Publish, PutQuery, Reply, ReplyError
from services.runtime.context import IDLE_S, ProcessContext
from services.runtime.inbox import DRAINS_FOR_S
from services.runtime.inputs import Input, MessageArrived, ProcessStarted
from services.runtime.process_clock import CLOCKS
from services.runtime.refusals import refusal_of
from services.runtime.scheduler import Kind
from services.runtime.stamp import read_stamp
from services.runtime.transport.inputs import outcome_input, query_input
from services.runtime.transport.session import IncomingQuery, Outcome, Replied

if TYPE_CHECKING:
    from schemas.topics import Topic
    from services.mission.mission_time import MissionTime

CLOCK_TIMEOUT_S = 2.0
"""A query for the mission's clock ends after this time."""
ASKS_AGAIN_S = 0.1
"""Shortest time between two such queries."""


class TimeSource(Protocol):
    """The source of mission time in a process on the wall clock."""

    def begin(self) -> bool:
        """Learn or set mission time; False if the process was stopped first."""

    def tend(self, monotonic_s: float) -> None:
        """Do periodic work; the driver calls this at least every `IDLE_S`, also while the mission is idle."""


class ClockFollower:
    """Mission time from the mission's clock, which the link publishes and serves."""

    def __init__(self, context: ProcessContext) -> None:
        self._context = context
        self._side = context.scheduler.host.interface.sides[0]
        self._topic = CLOCKS[self._side]

    def begin(self) -> bool:
        """Query the clock until it answers; a subscription brings every later change."""
        context = self._context
        session, inbox = context.sessions[self._side], context.inbox
        session.subscribe(self._topic, context.backlog.receiving(inbox, self._topic, self._update))
        began_s, asked_at_s, reported = time.monotonic(), -inf, False

        def on_end(outcome: Outcome) -> None:
            inbox.put(partial(self._replied, outcome))

        while not context.clock.known and not inbox.stopped.is_set():
            now_s = time.monotonic()
            if now_s - asked_at_s >= ASKS_AGAIN_S:  # a flood wakes this loop far more often
                asked_at_s = now_s
                session.query(self._topic, b"", CLOCK_TIMEOUT_S, on_end)
            if now_s - began_s > IDLE_S and not reported:
                context.log.warning(f"waiting for the mission's clock on {self._topic.key(context.mission)}")
                reported = True
            inbox.take(ASKS_AGAIN_S)
        return not inbox.stopped.is_set()

    def tend(self, monotonic_s: float) -> None:
        """Nothing: the link announces the time by itself."""

    def _replied(self, outcome: Outcome) -> None:
        if isinstance(outcome, Replied):
            self._update(outcome.payload)

    def _update(self, payload: bytes) -> None:
        try:
            _, state = decode(self._topic, payload, self._context.mission)
        except Refused as refusal:
            self._context.refused(self._topic, refusal)
            return
        self._context.clock.follow(state)


class WallClockDriver:
    """Runs one node on the wall clock."""

    def __init__(self, context: ProcessContext, time_source: TimeSource | None = None) -> None:
        """time_source: the mission's clock if None."""
        self._backlog = context.backlog
        self._context = context
        self._clock = context.clock
        self._inbox = context.inbox
        self._scheduler = context.scheduler
        self._time_source = ClockFollower(context) if time_source is None else time_source
        self._inputs = 0

    @property
    def traffic(self) -> WallClockDriver:
        return self

    def begin(self) -> bool:
        return self._time_source.begin()

    # --- what arrives, in Zenoh's threads -----------------------------------------------------------------------

    def received_as(self, topic: Topic) -> Topic:
        return topic

    def on_message(self, topic: Topic, payload: bytes, attachment: bytes) -> None:
        if self._backlog.enter(topic, len(payload)):
            self._inbox.put(partial(self._take_message, MessageArrived(topic, payload), attachment))

    def on_query(self, topic: Topic, query: IncomingQuery) -> None:
        self._backlog.answering(self._inbox, topic, partial(self._take_query, topic))(query)

    def _on_outcome(self, query: str, outcome: Outcome) -> None:
        self._inbox.put(partial(self._put, Kind.QUERY, outcome_input(query, outcome)))

    # --- taking it in, in the main loop -------------------------------------------------------------------------

    def _put(self, kind: Kind, given: Input) -> None:
        self._inputs += 1
        self._scheduler.put((kind, "", self._inputs), given)

    def _take_message(self, given: MessageArrived, attachment: bytes) -> None:
        self._backlog.leave(given.topic, len(given.payload))
        if self._clock.in_lockstep and (stamp := read_stamp(attachment)) is not None:
            self._clock.advance(stamp.at)  # an onlooker's time is that of what it receives
        self._put(Kind.MESSAGE, given)

    def _take_query(self, topic: Topic, query: IncomingQuery) -> None:
        token = self._context.open_queries.next_token()
        try:
            given = query_input(topic, query, token)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            self._context.refused(topic, error)
            return
        self._context.open_queries.add(token, query)
        self._put(Kind.QUERY, given)

    # --- the main loop ------------------------------------------------------------------------------------------

    def run(self) -> None:
        now = self._clock.now()
        self._scheduler.put((Kind.MESSAGE, "", 0), ProcessStarted(self._context.incarnation))
        self._perform(self._context.resume)
        self._act(now)
        while not self._inbox.stopped.is_set():
            self._act_on_due()
            self._inbox.take(self._sleep_s())
            self._drain()
            now_s = time.monotonic()
            self._context.beat(now_s)
            self._time_source.tend(now_s)

    def _drain(self) -> None:
        """Handle what waits, for `DRAINS_FOR_S` at most; timers first, each at the time at which it was due."""
        until_s = time.monotonic() + DRAINS_FOR_S
        while not self._inbox.stopped.is_set() and time.monotonic() < until_s:
            if self._scheduler.waiting:
                self._act(self._clock.now())
            take_in = self._inbox.next()
            if take_in is None:
                return
            self._act_on_due()
            take_in()

    def _act_on_due(self) -> None:
        while not self._inbox.stopped.is_set():
            wake = self._scheduler.next_wake(wait=False)
            if wake is None or wake > self._clock.now():
                return
            self._act(max(wake, self._clock.latest))

    def _act(self, now: MissionTime) -> None:
        self._perform(self._scheduler.run(self._clock.advance(now), wait=False))

    def _sleep_s(self) -> float:
        wake = self._scheduler.next_wake(wait=False)
        wait_s = None if wake is None else self._clock.wait_s(wake)
        return IDLE_S if wait_s is None else min(IDLE_S, wait_s)

    def _perform(self, actions: Iterable[Action]) -> None:
        context = self._context
        for action in actions:
            match action:
                case Publish(topic, side, payload):
                    context.sessions[side].publish(topic, payload)
                case PutQuery(topic, side, payload, query, timeout_s):
                    counts = self._scheduler.host.reply_check(topic, self._clock.latest)
                    on_end = partial(self._on_outcome, query)
                    context.sessions[side].query(topic, payload, timeout_s, on_end, counts=counts)
                case Reply(token, _, payload):
                    context.open_queries.reply(token, payload)
                case ReplyError(token, _, why, code):
                    context.open_queries.refuse(token, Refusal(why, code))
                case _:
                    context.perform(action)

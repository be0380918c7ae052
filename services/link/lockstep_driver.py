"""The link's driver in lockstep: it runs the link's own node and the time manager, which all other processes join.

It publishes where virtual time stands to onlookers (operators, the recorder) ten times a second of wall time; nothing
waits for an onlooker. A participant that dies is reported at once, and time stops until it is back. A slow one is
reported with its last sign of life, and waited for.
"""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from schemas.codec import Refused, decode, encode
from schemas.link import ClockMode, ClockState
from schemas.lockstep import Poke, StepBusy, StepDone, TimeControl, TimeStatus
from schemas.topics import MEMBERS, ONLOOKERS, TIME_CONTROL, TIME_SHOW, Side, Topic
from services.link.changes import read_change
from services.link.late import SignsOfLife
from services.link.role_holders import judge_claims
from services.runtime.heartbeat import TOPICS as HEARTBEATS
from services.runtime.lockstep.pace import Pace
from services.runtime.lockstep.participant_io import ParticipantIO
from services.runtime.lockstep.time_manager import TimeManager
from services.runtime.lockstep.topics import JOIN, TO_TIME_MANAGER, grant_to
from services.runtime.process_clock import CLOCKS
from services.runtime.refusals import refusal_of
from services.runtime.transport.request import encode_reply, read_request
from services.runtime.transport.session import IncomingQuery

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime
    from services.runtime.context import ProcessContext

SHOW_TIME_EVERY_S = 0.1


class TimeManagerDriver:
    """Runs the link's node as a participant, and the time manager."""

    def __init__(self, context: ProcessContext) -> None:
        self._context = context
        self._options = context.options
        self._io = ParticipantIO(context, self)
        self._manager = TimeManager(
            self._options.scenario.start_ns, frozenset(self._options.wait_for) | {context.name}, self._io.process_id
        )
        self._pace = Pace()
        if self._options.pace is not None:
            self._change_pace(TimeControl(rate=self._options.pace))
        self._over = self._options.stop_when is None
        self._sides: dict[str, Side] = {}
        self._announced: set[str] = set()
        self._join_queries: dict[str, tuple[Side, IncomingQuery]] = {}
        self._signs = SignsOfLife()
        self._shown_at_s = 0.0
        self._computing_since_s: float | None = None
        self._computing_s = 0.0
        self._gone = ""
        """One line on the participant that has ended; empty while all run."""
        self._late = False
        """Whether a slow participant has been reported."""

    @property
    def traffic(self) -> ParticipantIO:
        return self._io

    def begin(self) -> bool:
        """Let the link's node take part, and serve the processes that join."""
        context, manager, participant = self._context, self._manager, self._io.participant
        participant.obey(manager.term(self._io.process_id))
        manager.join(participant.join())
        for joining in manager.admit():
            participant.joined(manager.answer(joining, admitted=True))
        self._io.start(context.incarnation)
        self._publish_time()
        judge_claims(context)
        inbox = context.inbox
        for side, session in context.sessions.items():
            session.serve(CLOCKS[side], lambda query: inbox.put(partial(self._tell_time, query)))
            session.serve(JOIN[side], partial(self._on_join, side))
            for family in TO_TIME_MANAGER:
                session.subscribe(family[side], partial(self._on_participant, family[side]))
            session.subscribe(HEARTBEATS[side], partial(self._on_participant, HEARTBEATS[side]))
            session.watch_alive(side, self._on_member, MEMBERS)
            session.watch_alive(side, self._on_onlooker, ONLOOKERS)
        earth = context.sessions[Side.EARTH]
        earth.serve(TIME_CONTROL, context.backlog.answering(inbox, TIME_CONTROL, self._control))
        earth.serve(TIME_SHOW, context.backlog.answering(inbox, TIME_SHOW, self._show))
        missing = manager.missing()
        if missing:
            context.log.info("mission time waits", for_=", ".join(missing))
        return True

    # --- the main loop ------------------------------------------------------------------------------------------

    def run(self) -> None:
        context, manager = self._context, self._manager
        while not context.inbox.stopped.is_set():
            self._io.step()
            if not manager.outstanding:
                self._admit()
            wall_s = time.monotonic()
            context.beat(wall_s)
            if wall_s - self._shown_at_s >= SHOW_TIME_EVERY_S:
                self._publish_time()
            instant = manager.next_instant()
            if instant is None:
                if not manager.outstanding:
                    self._pause_when_over()
                self._report_late()
                self._take_in(SHOW_TIME_EVERY_S)
            elif self._may_go(instant, wall_s):
                self._take_in(0.0)  # steps of the link alone must not keep an operator waiting
                self._begin_step(instant)
            else:
                self._take_in(self._pace.wait_s(instant, wall_s, SHOW_TIME_EVERY_S))

    def _may_go(self, instant: MissionTime, wall_s: float) -> bool:
        """Whether time may advance to that instant now. A pause never stops the present instant: commands need it."""
        now = self._manager.now
        if instant > now:
            self._pause_when_over()
            self._manager.advance(self._pace.latest(instant, now, wall_s))
            if self._manager.now < instant:
                return False
            self._pace.stepped()
        return True

    def _begin_step(self, instant: MissionTime) -> None:
        context, manager = self._context, self._manager
        if manager.next_instant() != instant:
            return  # what was taken in meanwhile changes who acts when
        self._all_is_well()
        self._signs.begin_step()
        if self._computing_since_s is not None:
            self._computing_s += time.monotonic() - self._computing_since_s
            self._computing_since_s = None
        # A query from outside, sent at the news of the mission's end, must not become part of its last instant: the
        # event log would depend on how fast it came.
        self._io.participant.hold_outside = self._finished() is not None
        for name, grant in manager.grant(instant).items():
            if name == context.name:
                self._io.participant.grant(grant)
            else:
                side = self._sides[name]
                context.sessions[side].publish(grant_to(name, side), encode(self._io.header(), grant))
        context.clock.advance(instant)

    def _take_in(self, timeout_s: float) -> None:
        if self._context.inbox.take(timeout_s):
            self._context.inbox.take_all()

    def _finished(self) -> str | None:
        """Why the process that decides the end has finished; None before that, and after time was paused for it."""
        member = None if self._over else self._manager.members.get(self._options.stop_when or "")
        return None if member is None else member.finished

    def _pause_when_over(self) -> None:
        """Pause once when the process that decides the end has finished its last instant; an operator may resume."""
        why = self._finished()
        if why is None:
            return
        self._over = True
        self._pace.pause()
        self._record_events(False)
        self._context.log.info(f"mission time stands: {self._options.stop_when} is finished ({why})")
        if self._io.participant.holds_outside:
            self.poke()

    def _record_events(self, active: bool) -> None:
        if self._context.events is not None:
            self._context.events.active = active

    # --- who is late or gone ------------------------------------------------------------------------------------

    def _report_late(self) -> None:
        if not self._late and not self._gone and self._signs.overdue(self._manager.outstanding):
            self._late = True
            self._context.log.warning(self._detail())

    def _detail(self) -> str:
        """One line on what is wrong; empty if nothing is."""
        if self._gone or not self._late:
            return self._gone
        return self._signs.report(self._manager.step, self._manager.outstanding)

    def _all_is_well(self) -> None:
        if self._detail():
            self._gone, self._late = "", False
            self._context.log.info("mission time continues")

    # --- who takes part -----------------------------------------------------------------------------------------

    def _on_join(self, side: Side, query: IncomingQuery) -> None:
        self._context.inbox.put(partial(self._take_join, side, query))

    def _take_join(self, side: Side, query: IncomingQuery) -> None:
        try:
            joining = read_request(JOIN[side], query, self._context.mission)
            obeys = self._manager.join(joining)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            self._context.refused(JOIN[side], error)
            return
        if obeys:
            self._join_queries[joining.name] = (side, query)
        else:
            query.reply(encode(self._io.header(), self._manager.answer(joining, admitted=False)))

    def _admit(self) -> None:
        """Between two steps, admit the processes that have asked, and send them the present time."""
        manager = self._manager
        for joining in manager.admit():
            side, query = self._join_queries.pop(joining.name, (None, None))
            if side is None or query is None:
                continue
            self._sides[joining.name] = side
            query.reply(encode(self._io.header(), manager.answer(joining, admitted=True)))
            if joining.process not in self._announced:
                self._announced.add(joining.process)
                missing = ", ".join(manager.missing())
                self._context.log.info(
                    f"{joining.name} takes part", process=joining.process, waits_for=missing or "no other"
                )

    def _on_member(self, process: str, alive: bool) -> None:
        if not alive:  # one that appears asks to take part by itself
            self._context.inbox.put(partial(self._member_gone, process))

    def _on_onlooker(self, name: str, alive: bool) -> None:
        if alive:
            self._context.inbox.put(partial(self._manager.excuse, name))

    def _member_gone(self, process: str) -> None:
        manager = self._manager
        outstanding = frozenset(manager.outstanding)
        name = manager.leave(process)
        if name is None:
            return
        self._announced.discard(process)
        where = f" in step {manager.step}" if name in outstanding else ""
        follows = "stands until it is back" if name in manager.required else "continues without it"
        self._gone = f"{name} ({process}) is gone{where}; mission time {follows}"
        self._context.log.warning(self._gone)

    # --- what participants and operators send -------------------------------------------------------------------

    def _on_participant(self, topic: Topic, payload: bytes, _attachment: bytes) -> None:
        self._context.inbox.put(partial(self._take_participant, topic, payload))

    def _take_participant(self, topic: Topic, payload: bytes) -> None:
        try:
            header, body = decode(topic, payload, self._context.mission)
        except Refused as refusal:
            self._context.refused(topic, refusal)
            return
        self._signs.heard(header.source)
        match body:
            case StepDone():
                self._manager.done(body)
            case StepBusy():
                self._take_busy(body)
            case Poke():
                self._manager.poke(body.name, body.process)

    def _take_busy(self, busy: StepBusy) -> None:
        member = self._manager.members.get(busy.name)
        if member is None or member.process != busy.process or busy.step != self._manager.step:
            return
        self._signs.busy(busy)
        if busy.computing and self._computing_since_s is None:
            self._computing_since_s = time.monotonic()

    def _control(self, query: IncomingQuery) -> None:
        try:
            control = read_change(self._context, TIME_CONTROL, query)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            return
        if control != TimeControl():
            try:
                self._change_pace(control)
            except InvalidInput as error:
                self._context.refused(TIME_CONTROL, error)
                query.refuse(refusal_of(error))
                return
            self._record_events(True)
            self._publish_time()
        query.reply(self._context.encode_reply(TIME_CONTROL, query, self._io.header(), self._status()))

    def _show(self, query: IncomingQuery) -> None:
        try:
            read_request(TIME_SHOW, query, self._context.mission)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            self._context.refused(TIME_SHOW, error)
            return
        query.reply(encode_reply(query, self._io.header(), self._status()))

    def _change_pace(self, control: TimeControl) -> None:
        self._pace.control(control, self._manager.now, time.monotonic())

    # --- the link's own participant (participant_io.ToTimeManager) ----------------------------------------------

    def report(self, done: StepDone) -> None:
        self._manager.done(done)

    def report_busy(self, busy: StepBusy) -> None:
        self._take_busy(busy)

    def poke(self) -> None:
        self._manager.poke(self._context.name, self._io.process_id)

    # --- what onlookers see -------------------------------------------------------------------------------------

    def _status(self) -> TimeStatus:
        manager, pace = self._manager, self._pace
        return TimeStatus(
            now=manager.now,
            start_ns=self._options.scenario.start_ns,
            step=manager.step,
            next_at=manager.next_instant(),
            paused=pace.paused,
            rate=pace.rate,
            until=pace.until,
            steps_left=pace.steps_left,
            members=tuple(sorted(manager.members)),
            waits_for=tuple(manager.missing() or sorted(manager.outstanding)),
            finished={name: member.finished for name, member in manager.members.items() if member.finished is not None},
            computing_s=self._computing_s,
            detail=self._detail(),
        )

    def _publish_time(self) -> None:
        self._shown_at_s = time.monotonic()
        message = self._clock_message()
        for side, session in self._context.sessions.items():
            session.publish_best_effort(CLOCKS[side], message)

    def _tell_time(self, query: IncomingQuery) -> None:
        query.reply(self._clock_message())

    def _clock_message(self) -> bytes:
        clock = ClockState(
            mode=ClockMode.LOCKSTEP,
            rate=0.0,
            anchor_wall_ns=time.time_ns(),
            anchor_mission_ns=self._manager.now,
            start_ns=self._options.scenario.start_ns,
        )
        return encode(self._io.header(), clock)

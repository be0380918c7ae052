"""The link's process in lockstep: both routers, the link's own node, and the keeper of virtual time.

It publishes where time stands to onlookers (operators, the recorder) ten times a second of wall time; they hold
nothing up. Who does not finish a step is named after a bound; who dies is named at once, and time stands until it is
back.
"""

from __future__ import annotations

import contextlib
import queue
import time
from functools import partial

from he3.errors import InvalidInput
from schemas.codec import Refused, decode, encode
from schemas.link import ClockMode, ClockState
from schemas.lockstep import Poke, StepBusy, StepDone, TimeControl, TimeStatus
from schemas.topics import TIME_CONTROL, Side, Topic
from services.runtime.drivers.wall_clock import CLOCKS, ONLOOKERS, Service, Stop
from services.runtime.lockstep.pace import Pace
from services.runtime.lockstep.process import JOIN, MEMBERS, TO_KEEPER, LockstepProcess, grant_to
from services.runtime.lockstep.time_manager import TimeManager
from services.runtime.node import MissionTime
from services.runtime.options import Options
from services.runtime.queries.request import encode_reply, read_request
from services.runtime.refusals import refusal_of
from services.runtime.transport.session import IncomingQuery, Session, open_session

SHOW_TIME_EVERY_S = 0.1
HANGS_AFTER_S = 5.0
"""A process that is not computing and has not finished a step for so long is named."""
COMPUTES_LONG_S = 120.0
"""A process that has been computing for so long is named."""


class LockstepLinkProcess(LockstepProcess):
    """The time keeper's process."""

    def __init__(self, service: Service, options: Options, stop: Stop) -> None:
        super().__init__(service, options, stop)
        self.keeper = TimeManager(
            options.scenario.start_ns, frozenset(options.wait_for) | {service.name}, self.process_id
        )
        self.pace = Pace()
        if options.pace is not None:
            self._ask_of_pace(TimeControl(rate=options.pace))
        self._over = options.stop_when is None
        self._homes: dict[str, Side] = {}
        self._known: set[str] = set()
        self._join_questions: dict[str, tuple[Side, IncomingQuery]] = {}
        self._busy: dict[str, StepBusy] = {}
        self._shown = 0.0
        self._began_step = 0.0
        self._computing_since: float | None = None
        self._computing_s = 0.0
        self._detail = ""

    def open(self, side: Side, endpoint: str) -> Session | None:
        """The router of that side."""
        return Session(open_session(side, "router", endpoint), self.mission)

    def take_part(self) -> bool:
        """Be the one whom the others join."""
        self.part.obey(self.keeper.term(self.process_id))
        self.keeper.join(self.part.join())
        for joining in self.keeper.admit():
            self.part.joined(self.keeper.answer(joining, admitted=True))
        self._joined = True
        self.part.start(self._incarnation)
        self._show_time()
        for side, session in self.sessions.items():
            session.serve(CLOCKS[side], lambda query: self.later(partial(self._tell_time, query)))
            session.serve(JOIN[side], partial(self._join_asked, side))
            for family in TO_KEEPER:
                session.subscribe(family[side], partial(self._heard, family[side]))
            session.watch_alive(
                side, lambda process, alive: self.later(partial(self._member_seen, process, alive)), MEMBERS
            )
            session.watch_alive(
                side, lambda name, alive: self.later(partial(self._onlooker_seen, name, alive)), ONLOOKERS
            )
        self.sessions[Side.EARTH].serve(TIME_CONTROL, lambda query: self.later(partial(self._control, query)))
        missing = self.keeper.missing()
        if missing:
            self.log.info("mission time waits", for_=", ".join(missing))
        return True

    # --- the loop -----------------------------------------------------------------------------------------------

    def _loop(self) -> None:
        while not self.stop.event.is_set():
            self.go_on()
            if not self.keeper.outstanding:
                self._admit()
            wall_s = time.monotonic()
            self.heartbeat.beat(wall_s, self._last)
            if wall_s - self._shown >= SHOW_TIME_EVERY_S:
                self._show_time()
            instant = self.keeper.next_instant()
            if instant is None:
                if not self.keeper.outstanding:
                    self._stop_when_over()
                self._name_the_late(wall_s)
                self._take_in(SHOW_TIME_EVERY_S)
            elif self._may_go(instant, wall_s):
                self._take_in(0.0)  # steps of the link alone must not keep an operator waiting
                self._begin_step(instant)
            else:
                self._take_in(self.pace.wait_s(instant, wall_s, SHOW_TIME_EVERY_S))

    def _may_go(self, instant: MissionTime, wall_s: float) -> bool:
        """Whether time may move there now. What happens now happens, paused or not: else no command was answered."""
        now = self.keeper.now
        if instant > now:
            self._stop_when_over()
            self.keeper.advance(self.pace.latest(instant, now, wall_s))
            if self.keeper.now < instant:
                return False
            self.pace.stepped()
        return True

    def _begin_step(self, instant: MissionTime) -> None:
        if self.keeper.next_instant() != instant:
            return  # what was taken in meanwhile changes who acts when
        self._all_is_well()
        self._began_step = time.monotonic()
        self._busy.clear()
        if self._computing_since is not None:
            self._computing_s += self._began_step - self._computing_since
            self._computing_since = None
        for name, grant in self.keeper.grant(instant).items():
            if name == self.name:
                self.part.grant(grant)
            else:
                side = self._homes[name]
                self.sessions[side].publish(grant_to(name, side), encode(self.header(), grant))
        self._last = max(self._last, instant)

    def report(self, done: StepDone) -> None:
        """Its own reports it takes directly."""
        self.keeper.done(done)

    def poke(self) -> None:
        self.keeper.poke(self.name, self.process_id)

    def _take_in(self, patience_s: float) -> None:
        with contextlib.suppress(queue.Empty):
            self.stop.inbox.get(timeout=patience_s)() if patience_s > 0 else self.stop.inbox.get_nowait()()
            while True:
                self.stop.inbox.get_nowait()()

    def _stop_when_over(self) -> None:
        """Pause once, when the service that decides is finished; an operator may go on."""
        if self._over:
            return
        member = self.keeper.members.get(self.options.stop_when or "")
        if member is not None and member.finished is not None:
            self._over = True
            self.pace.pause()
            if self.events is not None:
                self.events.active = False
            self.log.info(f"mission time stands: {member.name} is finished ({member.finished})")

    # --- who is late --------------------------------------------------------------------------------------------

    def _name_the_late(self, wall_s: float) -> None:
        late = self.keeper.outstanding
        waited = wall_s - self._began_step
        computing = {name for name in late if name in self._busy and self._busy[name].computing}
        bound = COMPUTES_LONG_S if late <= computing else HANGS_AFTER_S
        if not late or waited <= bound or self._detail:
            return
        self._detail = (
            f"step {self.keeper.step}: not finished by {', '.join(map(self._in_words, sorted(late)))} "
            f"within {bound:g} s; mission time stands"
        )
        self.log.warning(self._detail)

    def _in_words(self, name: str) -> str:
        busy = self._busy.get(name)
        if busy is None:
            return name
        lacks = [f"{count} from {sender}" for sender, count in sorted(busy.lacks.items())]
        if lacks:
            return f"{name} (has not received {', '.join(lacks)})"
        return f"{name} (computing {', '.join(busy.computing)})"

    def _all_is_well(self) -> None:
        if self._detail:
            self._detail = ""
            self.log.info("mission time goes on")

    # --- who takes part -----------------------------------------------------------------------------------------

    def _join_asked(self, side: Side, query: IncomingQuery) -> None:
        self.later(partial(self._take_join, side, query))

    def _take_join(self, side: Side, query: IncomingQuery) -> None:
        try:
            joining = read_request(JOIN[side], query, self.mission)
            obeys = self.keeper.join(joining)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            return
        if obeys:
            self._join_questions[joining.name] = (side, query)
        else:
            query.reply(encode(self.header(), self.keeper.answer(joining, admitted=False)))

    def _admit(self) -> None:
        """Between two steps: take in who asked for it, and tell them where time stands."""
        for joining in self.keeper.admit():
            side, query = self._join_questions.pop(joining.name, (None, None))
            if side is None or query is None:
                continue
            self._homes[joining.name] = side
            query.reply(encode(self.header(), self.keeper.answer(joining, admitted=True)))
            if joining.process not in self._known:
                self._known.add(joining.process)
                missing = ", ".join(self.keeper.missing())
                self.log.info(f"{joining.name} takes part", process=joining.process, waits_for=missing or "nobody")

    def _member_seen(self, process: str, alive: bool) -> None:
        if alive:
            return  # it asks to take part by itself
        at_work = frozenset(self.keeper.outstanding)
        name = self.keeper.leave(process)
        if name is None:
            return
        self._known.discard(process)
        where = f" in step {self.keeper.step}" if name in at_work else ""
        follows = "stands until it is back" if name in self.keeper.required else "goes on without it"
        self._detail = f"{name} ({process}) is gone{where}; mission time {follows}"
        self.log.warning(self._detail)

    def _onlooker_seen(self, name: str, alive: bool) -> None:
        if alive:
            self.keeper.excuse(name)

    # --- what comes in ------------------------------------------------------------------------------------------

    def _heard(self, topic: Topic, payload: bytes, _attachment: bytes) -> None:
        self.later(partial(self._take_word, topic, payload))

    def _take_word(self, topic: Topic, payload: bytes) -> None:
        try:
            _, word = decode(topic, payload, self.mission)
        except Refused as refusal:
            self.log.warning(f"refused: {refusal}")
            return
        match word:
            case StepDone():
                self.keeper.done(word)
            case StepBusy():
                self._take_busy(word)
            case Poke():
                self.keeper.poke(word.name, word.process)

    def _take_busy(self, busy: StepBusy) -> None:
        member = self.keeper.members.get(busy.name)
        if member is None or member.process != busy.process or busy.step != self.keeper.step:
            return
        self._busy[busy.name] = busy
        if busy.computing and self._computing_since is None:
            self._computing_since = time.monotonic()

    def _control(self, query: IncomingQuery) -> None:
        try:
            control = read_request(TIME_CONTROL, query, self.mission)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            return
        if control != TimeControl():
            self._ask_of_pace(control)
            if self.events is not None:
                self.events.active = True
            self._show_time()
        query.reply(encode_reply(query, self.header(), self._status()))

    def _ask_of_pace(self, control: TimeControl) -> None:
        self.pace.control(control, self.keeper.now, time.monotonic())

    # --- what onlookers see -------------------------------------------------------------------------------------

    def _status(self) -> TimeStatus:
        keeper, pace = self.keeper, self.pace
        return TimeStatus(
            now=keeper.now,
            start_ns=self.options.scenario.start_ns,
            step=keeper.step,
            next_at=keeper.next_instant(),
            paused=pace.paused,
            rate=pace.rate,
            until=pace.until,
            steps_left=pace.steps_left,
            members=tuple(sorted(keeper.members)),
            waits_for=tuple(keeper.missing() or sorted(keeper.outstanding)),
            finished={name: member.finished for name, member in keeper.members.items() if member.finished is not None},
            computing_s=self._computing_s,
            detail=self._detail,
        )

    def _show_time(self) -> None:
        self._shown = time.monotonic()
        message = self._clock_message()
        for side, session in self.sessions.items():
            session.publish_best_effort(CLOCKS[side], message)

    def _tell_time(self, query: IncomingQuery) -> None:
        query.reply(self._clock_message())

    def _clock_message(self) -> bytes:
        clock = ClockState(
            mode=ClockMode.LOCKSTEP,
            rate=0.0,
            anchor_wall_ns=time.time_ns(),
            anchor_mission_ns=self.keeper.now,
            start_ns=self.options.scenario.start_ns,
        )
        return encode(self.header(), clock)

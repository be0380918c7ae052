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

from he3.errors import He3Error
from schemas.link import ClockMode, ClockState
from schemas.lockstep import Joined, Poke, StepBusy, StepDone, TimeStatus
from schemas.topics import TIME_CONTROL, Side, Topic
from schemas.wire import Refused, Wire, decode, encode
from services.bus import Bus, Question, open_session
from services.link.timekeeper import TimeKeeper
from services.lockstep import GRANT, JOIN, TO_KEEPER, LockstepProcess, StoppedWaiting
from services.node import SECOND, MissionTime
from services.options import Options
from services.questions import request_of
from services.run import CLOCKS, Service, Stop

SHOW_TIME_EVERY_S = 0.1
HANGS_AFTER_S = 10.0
"""A process that is not computing and has not finished a step for so long is named."""
COMPUTES_LONG_S = 120.0
"""A process that has been computing for so long is named."""


class LockstepLinkProcess(LockstepProcess):
    """The time keeper's process."""

    def __init__(self, service: Service, options: Options, stop: Stop) -> None:
        super().__init__(service, options, stop)
        start = options.scenario.start_ns
        self.keeper = TimeKeeper(start, frozenset(options.wait_for) | {service.name})
        self._paused = False
        self._steps_left: int | None = None
        self._until: MissionTime | None = None
        self._rate: float | None = None
        self._paced_from: tuple[float, MissionTime] = (time.monotonic(), start)
        self._shown = 0.0
        self._granted_at = 0.0
        self._computing: dict[str, tuple[str, ...]] = {}
        self._named = False
        self._detail = ""

    def open(self, side: Side, endpoint: str) -> Bus | None:
        """The router of that side."""
        return Bus(open_session(side, "router", endpoint), self.mission)

    def take_part(self) -> bool:
        """Be the one whom the others join."""
        self._last = self.keeper.now
        self._show_time()
        for side, bus in self.buses.items():
            bus.serve(CLOCKS[side], lambda question: question.reply(self._clock_message()))
            bus.serve(JOIN[side], partial(self._join_asked, side))
            for family in TO_KEEPER:
                bus.subscribe(family[side], partial(self._heard, family[side]))
            bus.watch_alive(side, lambda name, alive: self.later(partial(self._seen, name, alive)))
        self.buses[Side.EARTH].serve(TIME_CONTROL, lambda question: self.later(partial(self._control, question)))
        self.keeper.join(self.join_request())
        missing = self.keeper.missing()
        if missing:
            self.log.info("mission time waits", for_=", ".join(missing))
        return True

    # --- the loop -----------------------------------------------------------------------------------------------

    def _loop(self) -> None:
        while not self.stop.event.is_set():
            self.heartbeat.beat(time.monotonic(), self._last)
            if self.keeper.outstanding:
                self._wait_for_reports()
                continue
            instant = self.keeper.next_instant()
            hold_s = self._hold_s(instant)
            if instant is None or hold_s > 0:
                self._show_time()
                self._take_one(min(hold_s, SHOW_TIME_EVERY_S) if instant is not None else SHOW_TIME_EVERY_S)
                continue
            self._begin_step(instant)

    def _begin_step(self, instant: MissionTime) -> None:
        if self._steps_left is not None and instant > self.keeper.now:
            self._steps_left -= 1
        grant = self.keeper.grant(instant)
        self._granted_at = time.monotonic()
        self._computing.clear()
        self._named = False
        payload = encode(self._header(), grant)
        if any(name != self.name for name in grant.expects):
            for side, bus in self.buses.items():
                bus.publish(GRANT[side], payload)
        if self.name in grant.expects:
            with contextlib.suppress(StoppedWaiting):
                self.keeper.done(self.act(grant))
        else:
            self._step, self._last = grant.step, max(self._last, grant.at)
        if time.monotonic() - self._shown > SHOW_TIME_EVERY_S:
            self._show_time()

    def report(self, done: StepDone) -> None:
        """Its own reports it takes directly."""
        self.keeper.done(done)

    def poke(self) -> None:
        self.keeper.poke(self.name)

    def _wait_for_reports(self) -> None:
        self._take_one(SHOW_TIME_EVERY_S)
        waited = time.monotonic() - self._granted_at
        bound = COMPUTES_LONG_S if self.keeper.outstanding <= self._computing.keys() else HANGS_AFTER_S
        if waited > bound and not self._named:
            self._named = True
            self._detail = f"step {self.keeper.step}: {self._who_is_late()} not finished for {waited:.0f} s"
            self.log.warning(self._detail)

    def _who_is_late(self) -> str:
        late = sorted(self.keeper.outstanding)
        doing = [f"{name} (computing {', '.join(self._computing[name])})" for name in late if name in self._computing]
        return ", ".join([*(name for name in late if name not in self._computing), *doing])

    def _is_over(self) -> bool:
        member = self.keeper.members.get(self.options.stop_when or "")
        return member is not None and member.finished is not None

    def _take_one(self, patience_s: float) -> None:
        with contextlib.suppress(queue.Empty):
            self.stop.inbox.get(timeout=patience_s)()

    def _hold_s(self, instant: MissionTime | None) -> float:
        """How long [s of wall time] the next instant has to wait because an operator said so."""
        if instant is None:
            return 0.0
        moves = instant > self.keeper.now
        if not moves:
            return 0.0  # what happens now happens, paused or not: otherwise no command would ever be answered
        if self._is_over():
            return SHOW_TIME_EVERY_S
        if self._until is not None and instant > self._until:
            self._paused, self._until = True, None
        if self._steps_left is not None and self._steps_left <= 0:
            self._paused, self._steps_left = True, None
        if self._paused:
            return SHOW_TIME_EVERY_S
        if self._rate is None:
            return 0.0
        wall_s, mission_ns = self._paced_from
        return wall_s + (instant - mission_ns) / SECOND / self._rate - time.monotonic()

    # --- what comes in ------------------------------------------------------------------------------------------

    def _heard(self, topic: Topic, payload: bytes, _attachment: bytes) -> None:
        self.later(partial(self._take_word, topic, payload))

    def _take_word(self, topic: Topic, payload: bytes) -> None:
        try:
            _, word = decode(topic, payload, self.mission)
        except Refused as refusal:
            self.log.warning(f"refused: {refusal}")
            return
        self._take_in(word)

    def _take_in(self, word: Wire) -> None:
        match word:
            case StepDone():
                self._computing.pop(word.name, None)
                self.keeper.done(word)
            case StepBusy():
                self._computing[word.name] = word.computing
            case Poke():
                self.keeper.poke(word.name)

    def _join_asked(self, side: Side, question: Question) -> None:
        self.later(partial(self._take_join, side, question))

    def _take_join(self, side: Side, question: Question) -> None:
        try:
            _, joining = decode(JOIN[side], question.payload or b"", self.mission)
        except Refused as refusal:
            question.refuse(str(refusal))
            return
        self.keeper.join(joining)
        question.reply(encode(self._header(), Joined(now=self.keeper.now, step=self.keeper.step)))
        missing = self.keeper.missing()
        self.log.info(f"{joining.name} takes part", waits_for=", ".join(missing) or "nobody")

    def _seen(self, name: str, alive: bool) -> None:
        if not alive and name in self.keeper.members and name != self.name:
            at_work = f" in step {self.keeper.step}" if name in self.keeper.outstanding else ""
            self.keeper.leave(name)
            self._detail = f"{name} is gone{at_work}; mission time stands until it is back"
            self.log.warning(self._detail)

    def _control(self, question: Question) -> None:
        payload = question.payload
        try:
            if payload is None:
                control = request_of(TIME_CONTROL, question.parameters)
            else:
                _, control = decode(TIME_CONTROL, payload, self.mission)
        except (He3Error, Refused) as error:
            question.refuse(str(error))
            return
        if control.paused is not None:
            self._paused = control.paused
            self._steps_left = self._until = None
        if control.steps is not None:
            self._paused, self._steps_left = False, control.steps
        if control.until is not None:
            self._paused, self._until = False, control.until
        if control.rate is not None or control.unlimited:
            self._rate = None if control.unlimited else control.rate
        self._paced_from = (time.monotonic(), self.keeper.now)
        self._show_time()
        status = self._status()
        question.reply(status.model_dump_json().encode() if payload is None else encode(self._header(), status))

    # --- what onlookers see -------------------------------------------------------------------------------------

    def _status(self) -> TimeStatus:
        keeper = self.keeper
        waits_for = keeper.missing() or sorted(keeper.outstanding)
        return TimeStatus(
            now=keeper.now,
            step=keeper.step,
            paused=self._paused,
            rate=self._rate,
            until=self._until,
            members=tuple(sorted(keeper.members)),
            waits_for=tuple(waits_for),
            finished={name: member.finished for name, member in keeper.members.items() if member.finished is not None},
            detail=self._detail if waits_for else "",
        )

    def _show_time(self) -> None:
        self._shown = time.monotonic()
        self.clock = ClockState(
            mode=ClockMode.LOCKSTEP,
            rate=0.0,
            anchor_wall_ns=time.time_ns(),
            anchor_mission_ns=self.keeper.now,
            start_ns=self.options.scenario.start_ns,
        )
        for side, bus in self.buses.items():
            bus.publish(CLOCKS[side], self._clock_message())

    def _clock_message(self) -> bytes:
        assert self.clock is not None, "the time is shown before anybody can ask"
        return encode(self._header(), self.clock)

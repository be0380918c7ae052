"""The mission's clock on the wall clock. The link keeps it, because only the link is on both networks.

Mission time starts when all processes named by `--wait-for` have joined. It runs at the rate that an operator sets.
After a restart of the link it continues as if it had never stopped: from the saved clock, or, without one, from the
latest mission time at which another process has acted.
"""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from schemas.codec import encode
from schemas.topics import CLOCK_SET, Side
from schemas.wire import Header
from services.link.changes import read_change
from services.link.kept_clock import KeptClock, keep, kept_clock
from services.link.open_files import OpenFiles, allow_connections
from services.link.role_holders import judge_claims
from services.mission.mission_time import SECOND, iso
from services.runtime.clock import anchored, at_rate, started
from services.runtime.files.output import failed
from services.runtime.machine_time import this_machine
from services.runtime.process_clock import CLOCKS
from services.runtime.refusals import refusal_of

if TYPE_CHECKING:
    from schemas.link import ClockState
    from services.mission.mission_time import MissionTime
    from services.runtime.context import ProcessContext
    from services.runtime.transport.session import IncomingQuery

CLOCK_FILE = "clock.json"
_RECOVERY = {
    True: "restore it; without it mission time begins anew, and all processes stand until it has caught up",
    False: "restore it, or remove it: mission time then continues where the other processes are",
}
"""What an operator can do about a saved clock that is none, with keys and without."""
CATCHES_UP_FROM_S = 1.0
"""Wall time by which a process must be ahead of a clock that began anew; clocks of two machines differ by less."""
ANNOUNCE_EVERY_S = 5.0
"""Wall time between two announcements of the time while it is not changed."""


class ClockKeeper:
    """The time source of all processes, in the link's process: it publishes each change and answers queries."""

    def __init__(self, context: ProcessContext) -> None:
        self._context = context
        self._clock = context.clock.followed
        self._missing = set(context.options.wait_for)
        self._sequence = 0
        self._announced_at_s = 0.0
        folder = context.options.journal
        self._file = None if folder is None else folder / CLOCK_FILE
        self._machine = this_machine()
        self._kept = True
        self._anew = False
        """Whether this start of the link has begun mission time, because no earlier one had kept it."""
        self._files = OpenFiles(allow_connections(), context.log.warning)
        self._fastest = 0.0
        """Greatest rate before the present one: processes go on at it until they have heard of a change."""

    def begin(self) -> bool:
        """Start the clock, or continue the one that an earlier start of this process kept."""
        context, scenario = self._context, self._context.options.scenario
        kept = self._remembered()
        if kept is None:
            self._anew = True
            state = started(scenario.start_ns, 0.0 if self._missing else scenario.rate, time.time_ns())
        else:
            state = kept.state
            if not kept.waits:
                self._missing.clear()
                context.log.info("mission time continues")
        self._clock.follow(state)
        judge_claims(context, self._reached)
        inbox = context.inbox
        for side, session in context.sessions.items():
            session.serve(CLOCKS[side], lambda query: query.reply(encode(*self._message())))
            if self._missing:
                session.watch_alive(side, lambda name, alive: inbox.put(partial(self._process_seen, name, alive)))
        context.sessions[Side.EARTH].serve(CLOCK_SET, context.backlog.answering(inbox, CLOCK_SET, self._set_rate))
        self._announce()
        if self._missing:
            context.log.info("mission time waits", for_=", ".join(sorted(self._missing)))
        elif kept is not None and kept.waits:  # the earlier start waited, this one was told to wait for no process
            self._begin_mission_time()
        return True

    def tend(self, monotonic_s: float) -> None:
        """Announce the time periodically, for processes whose machine was suspended, and keep it for a restart."""
        if monotonic_s - self._announced_at_s >= ANNOUNCE_EVERY_S:
            self._announce()
        self._files.look(monotonic_s)

    def _reached(self, name: str, at: MissionTime) -> None:
        """Continue at the latest mission time at which a process has acted, if mission time has begun behind it.

        Mission time does not run backwards in any process: each would stand, until the clock has caught up with it.
        In a mission with keys time is changed by people only, so it stands, and the log says why.
        """
        state = self._clock.anchored_now()
        rate = max(state.rate, self._fastest)
        if not self._anew or at - state.anchor_mission_ns <= (1.0 + rate) * CATCHES_UP_FROM_S * SECOND:
            return
        began = f"mission time began anew with this start of the link, which had no saved clock (--journal); {name} has"
        if self._context.options.identity is not None:
            self._anew = False  # said once
            self._context.log.warning(f"{began} reached {iso(at)}, and all processes stand until then")
            return
        ahead = state.model_copy(update={"revision": state.revision + 1})
        self._clock.follow(anchored(ahead, at, state.anchor_wall_ns, state.boot_id, state.anchor_monotonic_ns))
        self._announce()
        self._context.log.warning(f"{began} reached {iso(at)}, where it continues")

    def _process_seen(self, name: str, alive: bool) -> None:
        if alive and name in self._missing:
            self._missing.discard(name)
            if not self._missing:
                self._begin_mission_time()

    def _begin_mission_time(self) -> None:
        rate = self._context.options.scenario.rate
        self._change_rate(rate)
        self._context.log.info("mission time runs", rate=rate)

    def _set_rate(self, query: IncomingQuery) -> None:
        try:
            change = read_change(self._context, CLOCK_SET, query)
        except InvalidInput as error:
            query.refuse(refusal_of(error))
            return
        self._missing.clear()
        self._change_rate(change.rate)
        query.reply(self._context.encode_reply(CLOCK_SET, query, *self._message()))

    def _change_rate(self, rate: float) -> None:
        now = self._clock.anchored_now()
        self._fastest = max(self._fastest, now.rate)
        self._clock.follow(at_rate(now, rate, now.anchor_wall_ns))
        self._announce()

    def _announce(self) -> None:
        self._announced_at_s = time.monotonic()
        self._remember()
        for side, session in self._context.sessions.items():
            session.publish(CLOCKS[side], encode(*self._message()))

    def _message(self) -> tuple[Header, ClockState]:
        state = self._clock.anchored_now()
        self._sequence += 1
        header = Header(
            mission=self._context.mission,
            source=self._context.name,
            incarnation=0,
            sequence=self._sequence,
            made_at=state.anchor_mission_ns,
        )
        return header, state

    # --- what survives a restart --------------------------------------------------------------------------------

    def _remembered(self) -> KeptClock | None:
        """The saved clock; None if no earlier start has saved one.

        Raises He3Error if it cannot be read. A link that began mission time anew then would open contacts and judge
        expiries by a wrong time, and would write over what is left of the right one.
        """
        if self._file is None:
            return None
        options = self._context.options
        try:
            kept = kept_clock(self._file, self._machine, self._context.mission, options.scenario.start_ns)
        except FileNotFoundError:
            return None
        except InvalidInput as error:
            raise InvalidInput(f"{error}; {_RECOVERY[options.identity is not None]}") from None
        except OSError as error:
            raise failed(f"{self._file}: cannot read the saved clock", error) from None
        at, away_s = iso(kept.state.anchor_mission_ns), kept.away_ns / SECOND
        if kept.away_ns < 0:
            self._context.log.warning(
                f"the wall clock is {-away_s:.0f} s earlier than when mission time was saved: how long the link was "
                f"away is not known, and mission time continues where it was, at {at}"
            )
        elif not kept.same_boot:
            self._context.log.warning(
                f"mission time continues at {at}, {away_s:.0f} s of wall time after it was saved: after a start of the "
                "machine the wall clock alone tells that"
            )
        return kept

    def _remember(self) -> None:
        if self._file is None:
            return
        try:
            mission = self._context.mission
            keep(self._file, self._clock.anchored_now(), self._machine, mission, waits=bool(self._missing))
            self._kept = True
        except OSError as error:
            if self._kept:  # reported once: it is tried again with each announcement
                self._context.log.warning(f"{self._file}: cannot keep the clock for a restart: {error.strerror}")
            self._kept = False

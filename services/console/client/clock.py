"""Mission time in an operator's session: queried, followed and controlled."""

from __future__ import annotations

import math
import time
from collections import deque
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from he3.errors import InvalidInput
from schemas.commands import NoParameters
from schemas.link import ClockChange, ClockMode, ClockState
from schemas.lockstep import TimeControl, TimeStatus
from schemas.topics import CLOCK_SET, EARTH_CLOCK, TIME_CONTROL, TIME_SHOW
from schemas.validation import one_line
from services.mission.mission_time import MAX_AHEAD, SECOND, MissionTime
from services.runtime.clock import FollowedClock, mission_time
from services.runtime.machine_time import this_machine

if TYPE_CHECKING:
    from collections.abc import Callable

    from schemas.wire import Header
    from services.runtime.transport.client import Client

MAX_CLOCK_RATE = 100_000.0
"""Mission seconds per wall second that a mission on the wall clock accepts."""


_LATELY_S = 1.0
"""Wall time over which the pace of a mission in lockstep is measured, at least."""
_NOTED_EVERY_S = 0.1


def time_shown(header: Header, clock: ClockState) -> MissionTime:
    """Mission time [ns] now, according to that clock message; in lockstep the time at which the message was made."""
    if clock.mode is ClockMode.LOCKSTEP:
        return header.made_at
    return mission_time(clock, time.time_ns())


class MissionClock:
    """Mission time from the newest clock state and the messages since; never runs backwards."""

    def __init__(self, start_ns: MissionTime | None = None, monotonic_s: Callable[[], float] | None = None) -> None:
        """start_ns: beginning of the mission, where it is known before a clock state arrives. monotonic_s: wall time;
        the machine's if None.
        """
        self._clock = FollowedClock(this_machine())
        self._start_ns = start_ns
        self._heard: MissionTime = 0
        self._monotonic_s = monotonic_s or (lambda: time.monotonic())
        self._moved_s = -math.inf
        self._noted: deque[tuple[float, MissionTime]] = deque(maxlen=round(10 * _LATELY_S / _NOTED_EVERY_S))

    @property
    def state(self) -> ClockState | None:
        """The newest clock state; None while there is none."""
        return self._clock.state

    def follow(self, state: ClockState) -> None:
        """Follow a clock state, received just now; an older one changes nothing."""
        self._clock.follow(state)

    @property
    def start_ns(self) -> MissionTime | None:
        return self._start_ns if self.state is None else self.state.start_ns

    @property
    def rate(self) -> float:
        """Mission seconds per wall second; 0 in lockstep, 1 while it is not known."""
        if self.state is None:
            return 1.0
        return 0.0 if self.state.mode is ClockMode.LOCKSTEP else self.state.rate

    @property
    def pace(self) -> float:
        """Mission seconds per wall second at which `now` goes on; that of a recording differs from its rate."""
        return 0.0 if self.state is None else self.rate

    @property
    def recent_rate(self) -> float:
        """Mission seconds per wall second of late: the rate; in lockstep, what was seen within about a second.

        What a busy computer delays by a part of a second is so much older in mission time.
        """
        if self.state is None or self.state.mode is not ClockMode.LOCKSTEP:
            return self.rate
        now_s = self._monotonic_s()
        while len(self._noted) > 1 and self._noted[1][0] <= now_s - _LATELY_S:
            self._noted.popleft()
        if now_s - self._moved_s >= _LATELY_S:
            return 0.0
        noted_s, noted = self._noted[0]
        return (self._heard - noted) / SECOND / max(now_s - noted_s, _NOTED_EVERY_S)

    def hear(self, at: MissionTime) -> None:
        """Note a message that was made on Earth at that mission time; one that lies far ahead is not believed."""
        on_wall_clock = self.state is not None and self.state.mode is ClockMode.WALL
        if on_wall_clock and at > self._clock.now() + MAX_AHEAD:
            return
        if at <= self._heard:
            return
        self._heard = at
        now_s = self._moved_s = self._monotonic_s()
        if not self._noted or now_s - self._noted[-1][0] >= _NOTED_EVERY_S:
            self._noted.append((now_s, self._heard))

    def now(self) -> MissionTime:
        """Mission time [ns]; 0 while it is not known."""
        if self.state is None or self.state.mode is ClockMode.LOCKSTEP:
            return self._heard
        return max(self._heard, self._clock.now())

    def since_start_s(self, at: MissionTime) -> float:
        """Mission time of `at` since the mission's beginning [s]; 0 while the beginning is not known."""
        return 0.0 if self.start_ns is None else max(0.0, (at - self.start_ns) / SECOND)

    def elapsed_s(self) -> float | None:
        """Mission time since the mission's beginning [s]; None while the beginning is not known."""
        return None if self.start_ns is None else self.since_start_s(self.now())

    def age_s(self, made_at: MissionTime) -> float:
        """Mission time since `made_at` [s]."""
        return max(0.0, (self.now() - made_at) / SECOND)


class ClockQueries:
    """The part of `MissionClient` that concerns mission time."""

    _session: Client

    def clock(self) -> ClockState:
        """The mission's clock."""
        state: ClockState = self._session.latest(EARTH_CLOCK)[1]
        return state

    def now(self) -> MissionTime:
        """Mission time [ns]; in lockstep that of the last step."""
        return time_shown(*self._session.latest(EARTH_CLOCK))

    def set_clock_rate(self, rate: float) -> ClockState:
        """Let mission time run at `rate` mission seconds per wall second (0: paused); for a mission on the wall clock.

        Raises InvalidInput for a rate that the mission does not accept.
        """
        if not 0 <= rate <= MAX_CLOCK_RATE:
            raise InvalidInput(f"rate: expected 0 to {MAX_CLOCK_RATE:g} on the wall clock, got {rate:g}")
        state: ClockState = self._session.query(CLOCK_SET, ClockChange(rate=rate))
        return state

    def control_time(self, **change: Any) -> TimeStatus:
        """Change how virtual time advances, for a mission in lockstep. The status of virtual time after the change.

        change: fields of `TimeControl`, such as ``paused=True``, ``steps=10`` or ``until=...`` [ns].
        """
        try:
            wanted = TimeControl(**change)
        except ValidationError as error:
            raise InvalidInput(f"time: {one_line(error)}") from None
        status: TimeStatus = (
            self._session.query(TIME_CONTROL, wanted) if change else self._session.query(TIME_SHOW, NoParameters())
        )
        return status

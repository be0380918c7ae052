"""Mission time: a clock state has the mission time at its anchor and the rate. The time manager changes it.

Two clocks of the machine take part. The monotonic clock cannot be set: each process carries mission time forward by
it (`FollowedClock`), and processes of one boot of a machine agree on an anchor by it. Processes of other machines have
only the wall clock in common with the time manager. NTP or a user may set that at any moment, also between the sending
of a state and its arrival. The time manager sets a new anchor in each state that it sends. A state of the same revision
that is off by more than `MAX_CORRECTION_NS` says that a wall clock was set: it corrects only a process that is behind
the anchor itself.

The revision, never the wall clock, tells which of two states is newer. Mission time does not run backwards:
not within a process, and not by a change. While the machine is suspended, mission time stands.
"""

from __future__ import annotations

import secrets
import threading
from collections import OrderedDict
from typing import TYPE_CHECKING, Final

from schemas.link import ClockMode, ClockState
from services.mission.mission_time import SECOND, MissionTime

if TYPE_CHECKING:
    from services.runtime.machine_time import MachineTime

MAX_CORRECTION_NS: Final = SECOND
"""Limit in wall time: the monotonic clocks of two machines drift less between two announcements."""

_EPOCH_BITS: Final = 53  # so that a page's numbers hold it exactly
_MAX_EPOCHS: Final = 100  # whose furthest reading is kept


class _Furthest:
    """The latest mission time that this process has read of each clock."""

    def __init__(self) -> None:
        self._times: OrderedDict[int, MissionTime] = OrderedDict()
        self._lock = threading.Lock()

    def note(self, state: ClockState, at: MissionTime) -> MissionTime:
        """The latest reading of that clock, this one included."""
        if not state.epoch:
            return at
        with self._lock:
            furthest = self._times[state.epoch] = max(at, self._times.pop(state.epoch, at))
            if len(self._times) > _MAX_EPOCHS:
                self._times.popitem(last=False)
        return furthest


_furthest: Final = _Furthest()


def mission_time(state: ClockState, wall_ns: int) -> MissionTime:
    """Mission time [ns] at that wall time [ns]; before the anchor it is the anchor's."""
    now = _at(state, wall_ns)
    _furthest.note(state, now)
    return now


def started(start_ns: MissionTime, rate: float, wall_ns: int) -> ClockState:
    """A new clock that starts now, at the mission's first instant."""
    return ClockState(
        mode=ClockMode.WALL,
        epoch=1 + secrets.randbits(_EPOCH_BITS - 1),
        rate=rate,
        anchor_wall_ns=wall_ns,
        anchor_mission_ns=start_ns,
        start_ns=start_ns,
    )


def at_rate(state: ClockState, rate: float, wall_ns: int) -> ClockState:
    """The same clock with another rate from wall time `wall_ns` on (0 stops it).

    It continues from the latest mission time that this process has read, also if the wall clock was set back since
    then.
    """
    now = _furthest.note(state, mission_time(state, wall_ns))
    monotonic = (state.boot_id, state.anchor_monotonic_ns) if wall_ns == state.anchor_wall_ns else ()
    changed = state.model_copy(update={"revision": state.revision + 1, "rate": rate})
    return anchored(changed, now, wall_ns, *monotonic)


def anchored(state: ClockState, now: MissionTime, wall_ns: int, boot_id: str = "", monotonic_ns: int = 0) -> ClockState:
    """The same clock, which shows that mission time at those times of the wall clock and the monotonic clock."""
    anchor = {"anchor_wall_ns": wall_ns, "anchor_mission_ns": now}
    return state.model_copy(update={**anchor, "boot_id": boot_id, "anchor_monotonic_ns": monotonic_ns})


def newer(one: ClockState | None, other: ClockState) -> ClockState:
    """The newer state: of one clock the higher revision, then the later anchor; a state of another clock is newer."""
    if one is None or other.epoch != one.epoch:
        return other
    return other if _order(other) >= _order(one) else one


class FollowedClock:
    """Mission time in this process. It may be read by several threads."""

    def __init__(self, machine: MachineTime) -> None:
        self._machine = machine
        self._lock = threading.Lock()
        self._state: ClockState | None = None
        self._anchor: tuple[int, MissionTime] = (0, 0)  # monotonic time, and mission time then
        self._read: MissionTime = 0

    @property
    def state(self) -> ClockState | None:
        """The clock state in force; None before the first."""
        return self._state

    def follow(self, state: ClockState) -> None:
        """Follow this state from now on if it is newer than the one in force. It must have been received just now."""
        with self._lock:
            before = self._state
            if newer(before, state) is not state or (before is not None and _order(before) == _order(state)):
                return  # an equal one comes late: by now its anchor may not fit the wall clock any more
            at = self._time_by(state)
            if before is None or before.epoch != state.epoch:
                self._read = 0  # another clock may stand at an earlier time
            self._state = state
            self._anchor = self._machine.monotonic_ns(), at

    def now(self) -> MissionTime:
        """Mission time [ns]; it never runs backwards. A clock state must be in force."""
        with self._lock:
            return self._now()

    def seconds_until(self, mission_ns: MissionTime) -> float | None:
        """Wall time [s] until that mission time; 0 if it is past, None if the clock is stopped."""
        with self._lock:
            ahead = mission_ns - self._now()
            rate = 0.0 if self._state is None else self._state.rate
        if ahead <= 0:
            return 0.0
        return None if rate == 0 else ahead / rate / SECOND

    def anchored_now(self) -> ClockState:
        """The state in force, anchored at this moment, for another process to follow."""
        with self._lock:
            now, machine = self._now(), self._machine
            assert self._state is not None
            return anchored(self._state, now, machine.wall_ns(), machine.boot_id, machine.monotonic_ns())

    def _time_by(self, state: ClockState) -> MissionTime:
        """Mission time now, according to a state that has just arrived."""
        machine = self._machine
        if machine.boot_id and state.boot_id == machine.boot_id:
            elapsed_ns = max(0, machine.monotonic_ns() - state.anchor_monotonic_ns)
            return state.anchor_mission_ns + _scaled(elapsed_ns, state.rate)
        at, before = _at(state, machine.wall_ns()), self._state
        if before is None or (before.epoch, before.revision) != (state.epoch, state.revision):
            return at
        known = self._now()
        if abs(at - known) <= _scaled(MAX_CORRECTION_NS, state.rate):
            return at
        return max(known, state.anchor_mission_ns)  # a machine that was suspended is behind the anchor

    def _now(self) -> MissionTime:
        assert self._state is not None, "a clock is read only after its first state"
        since, at = self._anchor
        self._read = max(self._read, at + _scaled(max(0, self._machine.monotonic_ns() - since), self._state.rate))
        return self._read


def _order(state: ClockState) -> tuple[int, int, MissionTime]:
    return state.epoch, state.revision, state.anchor_mission_ns


def _at(state: ClockState, wall_ns: int) -> MissionTime:
    return state.anchor_mission_ns + _scaled(max(0, wall_ns - state.anchor_wall_ns), state.rate)


def _scaled(elapsed_ns: int, rate: float) -> int:
    # At rate 1 the arithmetic stays in integers: a float would lose nanoseconds after 100 days.
    return elapsed_ns if rate == 1 else round(elapsed_ns * rate)

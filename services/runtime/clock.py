"""Mission time from wall time: an anchor and a rate, changed only by the time keeper.

Mission time never runs backwards: each new clock state is anchored at the moment of its change.
"""

from __future__ import annotations

from schemas.link import ClockMode, ClockState
from services.runtime.node import SECOND, MissionTime


def mission_time(state: ClockState, wall_ns: int) -> MissionTime:
    """Mission time [ns] at that wall time [ns]; before the anchor it is the anchor's."""
    elapsed = max(0, wall_ns - state.anchor_wall_ns)
    return state.anchor_mission_ns + _scaled(elapsed, state.rate)


def wall_time(state: ClockState, mission_ns: MissionTime) -> int | None:
    """Wall time [ns] at which it will be that mission time; None when the clock stands still."""
    ahead = mission_ns - state.anchor_mission_ns
    if ahead <= 0:
        return state.anchor_wall_ns
    if state.rate == 0:
        return None
    return state.anchor_wall_ns + (ahead if state.rate == 1 else round(ahead / state.rate))


def started(start_ns: MissionTime, rate: float, wall_ns: int) -> ClockState:
    """A clock that begins at the mission's start, now."""
    return ClockState(
        mode=ClockMode.WALL, rate=rate, anchor_wall_ns=wall_ns, anchor_mission_ns=start_ns, start_ns=start_ns
    )


def at_rate(state: ClockState, rate: float, wall_ns: int) -> ClockState:
    """The same clock with another rate from that wall time on (0 stops it)."""
    return state.model_copy(
        update={"rate": rate, "anchor_wall_ns": wall_ns, "anchor_mission_ns": mission_time(state, wall_ns)}
    )


def newer(one: ClockState | None, other: ClockState) -> ClockState:
    """The later word of the two on what time it is: each change is anchored at the wall time at which it was made."""
    return other if one is None or other.anchor_wall_ns >= one.anchor_wall_ns else one


def elapsed_s(state: ClockState, mission_ns: MissionTime) -> float:
    """Seconds of mission time since the mission began."""
    return (mission_ns - state.start_ns) / SECOND


def _scaled(elapsed_ns: int, rate: float) -> int:
    # At rate 1 the arithmetic stays in integers: a float would lose nanoseconds after 100 days.
    return elapsed_ns if rate == 1 else round(elapsed_ns * rate)

"""How fast mission time goes on, as an operator's session sees it."""

from __future__ import annotations

import pytest

from schemas.link import ClockMode, ClockState
from services.console.client.clock import MissionClock
from services.console.client.staleness import stale_after_s
from services.mission.mission_time import SECOND

START = 1_893_456_000 * SECOND


class Wall:
    """The time of a machine, which tests set."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def clock_of(mode: ClockMode, rate: float, wall: Wall) -> MissionClock:
    clock = MissionClock(monotonic_s=wall)
    clock.follow(ClockState(mode=mode, rate=rate, anchor_wall_ns=1, anchor_mission_ns=START, start_ns=START))
    return clock


def flown(clock: MissionClock, wall: Wall, pace: float, for_s: float) -> None:
    """Messages every 20 ms of wall time, of a mission at that pace [mission seconds per wall second]."""
    at = max(clock.now(), START)
    for _ in range(round(for_s / 0.02)):
        wall.now_s += 0.02
        at += round(pace * 0.02 * SECOND)
        clock.hear(at)


def test_in_lockstep_the_recent_rate_is_what_was_seen_within_about_a_second() -> None:
    wall = Wall()
    clock = clock_of(ClockMode.LOCKSTEP, 0.0, wall)
    assert clock.recent_rate == 0.0
    flown(clock, wall, 5000.0, 30.0)
    assert clock.recent_rate == pytest.approx(5000.0, rel=0.15)
    flown(clock, wall, 100.0, 3.0)
    assert clock.recent_rate == pytest.approx(100.0, rel=0.15)
    wall.now_s += 5.0  # it is paused
    assert clock.recent_rate == pytest.approx(0.0, abs=2.5)


def test_a_report_that_waits_a_quarter_of_a_second_in_a_fast_mission_is_not_stale_but_one_of_a_paused_mission_is() -> (
    None
):
    wall = Wall()
    clock = clock_of(ClockMode.LOCKSTEP, 0.0, wall)
    flown(clock, wall, 5000.0, 5.0)
    reported_at = clock.now() - 1250 * SECOND
    assert clock.age_s(reported_at) < stale_after_s(60.0, None, clock.recent_rate)
    wall.now_s += 60.0
    assert clock.age_s(reported_at) > stale_after_s(60.0, None, clock.recent_rate)


def test_on_the_wall_clock_the_recent_rate_is_the_rate() -> None:
    assert clock_of(ClockMode.WALL, 20.0, Wall()).recent_rate == 20.0

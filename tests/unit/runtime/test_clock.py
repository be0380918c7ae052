"""Mission time from wall time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.runtime.clock import at_rate, elapsed_s, mission_time, newer, started, wall_time
from services.runtime.node import SECOND

START = 1_893_456_000 * SECOND
WALL = 1_700_000_000 * SECOND

rates = st.floats(0.001, 100_000)
later = st.integers(0, 10**17)


def test_at_rate_one_mission_time_is_exact_to_the_nanosecond_after_three_years():
    clock = started(START, 1.0, WALL)
    assert mission_time(clock, WALL + 10**17 + 1) == START + 10**17 + 1
    assert wall_time(clock, START + 10**17 + 1) == WALL + 10**17 + 1


def test_before_its_anchor_it_stands_at_its_anchor():
    clock = started(START, 10.0, WALL)
    assert mission_time(clock, WALL - SECOND) == START
    assert wall_time(clock, START - SECOND) == WALL


def test_a_clock_that_stands_never_reaches_a_later_time():
    clock = started(START, 0.0, WALL)
    assert mission_time(clock, WALL + 10**15) == START
    assert wall_time(clock, START + 1) is None
    assert wall_time(clock, START) == WALL


def test_of_two_words_on_the_time_the_later_holds_in_whatever_order_they_come():
    waiting = started(START, 0.0, WALL)
    running = at_rate(waiting, 1500.0, WALL + 5)
    assert newer(None, waiting) is waiting
    assert newer(waiting, running) is newer(running, waiting) is running


@given(rate=rates, elapsed=later)
def test_wall_time_and_mission_time_are_each_other_s_inverse_to_a_tick(rate, elapsed):
    clock = started(START, rate, WALL)
    now = mission_time(clock, WALL + elapsed)
    at = wall_time(clock, now)
    # Floats hold 16 figures, and rounding to a whole nanosecond of mission time costs 1 / rate of wall time.
    assert at == pytest.approx(WALL + elapsed, rel=1e-15, abs=2 / rate + 1)


@given(changes=st.lists(st.tuples(later, st.floats(0, 100_000)), max_size=6), more=later)
def test_mission_time_never_runs_backwards_whatever_the_rate_is_changed_to(changes, more):
    clock, wall, last = started(START, 1.0, WALL), WALL, START
    for elapsed, rate in changes:
        wall += elapsed
        now = mission_time(clock, wall)
        assert now >= last
        clock, last = at_rate(clock, rate, wall), now
        assert mission_time(clock, wall) == now, "a change of rate is no jump"
    assert mission_time(clock, wall + more) >= last


def test_a_new_rate_holds_from_its_moment_on_and_the_mission_s_start_stays():
    clock = at_rate(started(START, 1.0, WALL), 60.0, WALL + 10 * SECOND)
    assert mission_time(clock, WALL + 11 * SECOND) == START + 70 * SECOND
    assert elapsed_s(clock, START + 70 * SECOND) == 70.0
    assert clock.start_ns == START

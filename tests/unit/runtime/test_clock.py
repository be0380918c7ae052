"""Mission time: exact, agreed on by all processes, and never backwards, for any change of the machine's clocks."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.link import ClockState
from services.mission.mission_time import SECOND
from services.runtime.clock import FollowedClock, at_rate, mission_time, newer, started
from services.runtime.machine_time import MachineTime

START = 1_893_456_000 * SECOND
WALL = 1_700_000_000 * SECOND
HOUR = 3600 * SECOND

rates = st.floats(0.001, 100_000)
later = st.integers(0, 10**17)
steps = st.integers(-HOUR, HOUR)
"""How far the wall clock is set, forwards or back [ns]."""


def test_at_rate_one_mission_time_is_exact_to_the_nanosecond_after_three_years():
    clock = started(START, 1.0, WALL)
    assert mission_time(clock, WALL + 10**17 + 1) == START + 10**17 + 1


def test_before_its_anchor_a_clock_shows_the_time_of_its_anchor():
    assert mission_time(started(START, 10.0, WALL), WALL - SECOND) == START


def test_a_new_rate_holds_from_its_change_on_and_the_mission_s_start_stays():
    clock = at_rate(started(START, 1.0, WALL), 60.0, WALL + 10 * SECOND)
    assert mission_time(clock, WALL + 11 * SECOND) == START + 70 * SECOND
    assert clock.start_ns == START


@given(changes=st.lists(st.tuples(later, st.floats(0, 100_000)), max_size=6), more=later)
def test_a_change_of_rate_is_no_jump_of_mission_time(changes, more):
    clock, wall, last = started(START, 1.0, WALL), WALL, START
    for elapsed, rate in changes:
        wall += elapsed
        now = mission_time(clock, wall)
        assert now >= last
        clock, last = at_rate(clock, rate, wall), now
        assert mission_time(clock, wall) == now
    assert mission_time(clock, wall + more) >= last


# --- the wall clock is set ----------------------------------------------------------------------------------------


def test_a_clock_goes_on_where_it_was_read_when_the_wall_clock_is_set_back_before_a_change():
    clock = started(0, 20.0, 1000 * SECOND)
    seen = mission_time(clock, 1010 * SECOND)
    paused = at_rate(clock, 0.0, 970 * SECOND)
    assert mission_time(paused, 970 * SECOND) == seen == 200 * SECOND
    assert newer(clock, paused) is paused


@given(changes=st.lists(st.tuples(steps, st.floats(0, 1000), st.integers(0, HOUR)), min_size=1, max_size=8))
def test_each_change_counts_and_starts_no_earlier_than_any_reading_before_it(changes):
    clock, wall, furthest = started(START, 20.0, WALL), WALL, START
    for step, rate, elapsed in changes:
        wall += step
        changed = at_rate(clock, rate, wall)
        assert newer(clock, changed) is newer(changed, clock) is changed
        assert mission_time(changed, wall) >= furthest
        clock, wall = changed, wall + elapsed
        furthest = max(furthest, mission_time(clock, wall))


def test_of_one_revision_the_later_anchor_is_newer_and_another_clock_is_newer_than_any():
    early = started(START, 1.0, WALL)
    late = early.model_copy(update={"anchor_mission_ns": START + 1, "anchor_wall_ns": WALL - HOUR})
    anew = started(START, 1.0, WALL - HOUR)
    assert newer(None, early) is early
    assert newer(early, late) is newer(late, early) is late
    assert newer(at_rate(late, 2.0, WALL), anew) is anew


# --- clocks that are followed -------------------------------------------------------------------------------------


@dataclass
class Machine:
    """A machine whose wall clock can be set, and which can be suspended: then its monotonic clock stands."""

    monotonic: int = 5 * SECOND
    wall: int = WALL
    boot_id: str = "this machine"

    def clock(self) -> FollowedClock:
        return FollowedClock(MachineTime(lambda: self.wall, lambda: self.monotonic, self.boot_id))

    def run(self, elapsed: int) -> None:
        self.monotonic += elapsed
        self.wall += elapsed

    def set_wall(self, step: int) -> None:
        self.wall += step

    def suspend(self, elapsed: int) -> None:
        self.wall += elapsed


def followed(state: ClockState, machine: Machine) -> FollowedClock:
    clock = machine.clock()
    clock.follow(state)
    return clock


@pytest.mark.parametrize("step", [-HOUR, -40 * SECOND, 40 * SECOND, HOUR])
def test_a_followed_clock_does_not_notice_that_the_wall_clock_is_set(step):
    machine = Machine()
    clock = followed(started(START, 20.0, WALL), machine)
    machine.run(10 * SECOND)
    machine.set_wall(step)
    assert clock.now() == START + 200 * SECOND
    machine.run(SECOND)
    assert clock.now() == START + 220 * SECOND
    assert clock.seconds_until(START + 230 * SECOND) == pytest.approx(0.5)


def test_mission_time_stands_while_the_machine_is_suspended():
    machine = Machine()
    clock = followed(started(START, 20.0, WALL), machine)
    machine.suspend(HOUR)
    assert clock.now() == START
    newcomer = followed(clock.anchored_now(), machine)
    assert newcomer.now() == START, "who joins afterwards follows the same time"


@pytest.mark.parametrize("step", [-HOUR, -40 * SECOND, 40 * SECOND, 24 * HOUR])
@pytest.mark.parametrize("boot_id", ["this machine", "another machine", ""])
def test_a_wall_clock_that_is_set_while_an_announcement_is_on_its_way_changes_no_mission_time(step, boot_id):
    there, here = Machine(), Machine(boot_id=boot_id)
    manager = followed(started(START, 1000.0, WALL), there)
    clock = followed(manager.anchored_now(), here)
    there.run(5 * SECOND)
    here.run(5 * SECOND)
    announced = manager.anchored_now()
    here.set_wall(step)
    clock.follow(announced)
    assert clock.now() == manager.now() == START + 5000 * SECOND


def test_an_announcement_brings_a_machine_that_was_suspended_to_the_time_of_the_others():
    there, here = Machine(), Machine(boot_id="another machine")
    manager = followed(started(START, 20.0, WALL), there)
    clock = followed(manager.anchored_now(), here)
    there.run(HOUR)
    here.suspend(HOUR)
    assert clock.now() == START
    clock.follow(manager.anchored_now())
    assert clock.now() == manager.now() == START + 20 * HOUR


def test_an_announcement_corrects_the_drift_between_the_monotonic_clocks_of_two_machines():
    there, here = Machine(), Machine(boot_id="another machine")
    manager = followed(started(START, 20.0, WALL), there)
    clock = followed(manager.anchored_now(), here)
    there.run(HOUR)
    here.run(HOUR - SECOND // 2)
    here.set_wall(SECOND // 2)
    clock.follow(manager.anchored_now())
    assert clock.now() == manager.now()


def test_a_stopped_clock_never_reaches_a_later_time():
    clock = followed(started(START, 0.0, WALL), Machine())
    assert clock.seconds_until(START + 1) is None
    assert clock.seconds_until(START) == 0.0


def test_a_late_answer_from_before_a_change_changes_nothing():
    machine = Machine()
    manager = followed(started(START, 20.0, WALL), machine)
    late = manager.anchored_now()
    machine.run(SECOND)
    machine.set_wall(-HOUR)
    paused = at_rate(manager.anchored_now(), 0.0, machine.wall)
    clock = followed(late, machine)
    clock.follow(paused)
    clock.follow(late)
    assert clock.state is paused
    assert clock.now() == START + 20 * SECOND


def test_the_clock_of_a_mission_started_anew_is_followed_from_its_start():
    machine = Machine()
    clock = followed(started(START, 1000.0, WALL), machine)
    machine.run(SECOND)
    assert clock.now() == START + 1000 * SECOND
    clock.follow(started(START, 1.0, machine.wall))
    assert clock.now() == START


@given(rate=rates, elapsed=st.integers(0, HOUR), ahead=st.integers(1, HOUR))
def test_after_the_wait_that_a_clock_names_it_is_that_time(rate, elapsed, ahead):
    machine = Machine()
    clock = followed(started(START, rate, WALL), machine)
    machine.run(elapsed)
    goal = clock.now() + ahead
    wait_s = clock.seconds_until(goal)
    assert wait_s is not None
    machine.run(round(wait_s * SECOND))
    # Floats hold 16 figures; a wait that ends a little early is followed by another.
    assert clock.now() == pytest.approx(goal, abs=2 + rate + ahead * 1e-9)


@dataclass
class Mission:
    """The time manager and processes that follow it, on one machine; each reading is checked."""

    machine: Machine = field(default_factory=Machine)
    old: list[ClockState] = field(default_factory=list)
    """States on their way, which may arrive late or never."""

    def __post_init__(self) -> None:
        self.manager = followed(started(START, 20.0, self.machine.wall), self.machine)
        self.followers = [followed(self.manager.anchored_now(), self.machine)]
        self.readings: dict[int, int] = {}

    def announce(self) -> None:
        state = self.manager.anchored_now()
        self.old.append(state)
        for follower in self.followers:
            follower.follow(state)

    def arrive(self, which: int) -> None:
        """A state arrives at the last process only now."""
        if self.old:
            self.followers[-1].follow(self.old[which % len(self.old)])

    def send(self) -> None:
        """The manager announces a state that reaches no process yet."""
        self.old.append(self.manager.anchored_now())

    def change(self, rate: float) -> None:
        now = self.manager.anchored_now()
        self.manager.follow(at_rate(now, rate, now.anchor_wall_ns))
        self.announce()

    def join(self) -> None:
        self.followers.append(followed(self.manager.anchored_now(), self.machine))

    def check(self) -> None:
        for clock in (self.manager, *self.followers):
            now = clock.now()
            assert now >= self.readings.get(id(clock), 0), "mission time ran backwards"
            self.readings[id(clock)] = now
            assert clock.state is not None
            assert self.manager.state is not None
            assert clock.state.revision == self.manager.state.revision
            assert clock.state.rate == self.manager.state.rate
            assert abs(now - self.readings[id(self.manager)]) <= 1000, "a process has another time than the manager"


actions = st.one_of(
    st.tuples(st.just("run"), st.integers(0, HOUR)),
    st.tuples(st.just("set_wall"), steps),
    st.tuples(st.just("suspend"), st.integers(0, HOUR)),
    st.tuples(st.just("change"), st.floats(0, 1000)),
    st.tuples(st.just("announce"), st.none()),
    st.tuples(st.just("join"), st.none()),
    st.tuples(st.just("send"), st.none()),
    st.tuples(st.just("arrive"), st.integers(0, 100)),
)


@given(st.lists(actions, max_size=40))
def test_whatever_is_done_to_the_wall_clock_all_processes_agree_and_time_never_runs_backwards(schedule):
    mission = Mission()
    for action, value in schedule:
        if action in ("run", "set_wall", "suspend"):
            getattr(mission.machine, action)(value)
        elif action == "change":
            mission.change(value)
        elif action == "announce":
            mission.announce()
        elif action == "join":
            mission.join()
        elif action == "send":
            mission.send()
        else:
            mission.arrive(value)
        mission.check()

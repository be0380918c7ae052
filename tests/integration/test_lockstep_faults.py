"""Lockstep under faults: processes that die, hang or come back, clients that hang, and an operator's control."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from he3.errors import He3Error
from schemas.link import LinkChange
from schemas.lockstep import TimeControl, TimeStatus
from schemas.measurement import MeasurementRequest
from schemas.topics import EARTH_CLOCK, GROUND_STATUS, LINK_SET, MEASURE, TIME_CONTROL, Side
from services.mission.mission_time import SECOND
from services.mission.processes import VITAL, waited_for
from services.runtime.transport.client import Client
from tests.processes import start
from tests.waiting import PATIENCE_S, expect_within, until

EXHAUSTIVE = pytest.mark.exhaustive
WAIT_FOR = ("--wait-for", ",".join(waited_for(VITAL)), "--stop-when", "ground")
START = 1893456000 * SECOND
SHORTER = ("--set", "rounds=1", "--set", "samples_per_round=2")
"""A mission of three hours."""


class Lockstep:
    """A mission in lockstep, seen by an operator."""

    def __init__(self, mission: object) -> None:
        self.mission = mission
        self._client: Client | None = None

    @property
    def client(self) -> Client:
        if self._client is None:
            self._client = self.mission.client()
        return self._client

    def control(self, **wanted: object) -> TimeStatus:
        return self.client.query(TIME_CONTROL, TimeControl(**wanted))

    def until(self, wanted: Callable[[TimeStatus], bool]) -> TimeStatus:
        """The first status that is wanted."""

        def seen() -> TimeStatus | None:
            status = self.control()
            return status if wanted(status) else None

        return until(seen, lambda: f"another status than {self.control()}\n{self.mission['link'].text}")

    def standing(self, **wanted: object) -> TimeStatus:
        """The status once time has stopped where the operator asked."""
        self.control(**wanted)
        return self.until(  # what happens at one instant takes several rounds
            lambda status: status.paused and not status.waits_for and status.next_at != status.now
        )

    def moves_on(self) -> None:
        """Fails unless time advances."""
        step = self.control().step
        self.until(lambda status: status.step > step + 50)


@pytest.fixture
def lockstep(missions: Callable[..., object], tmp_path: Path, coarse_t1: Path) -> Callable[..., Lockstep]:
    def begin(*settings: str, journal: bool = True) -> Lockstep:
        flags = [word for setting in (*settings, f"region={coarse_t1}") for word in ("--set", setting)]
        flags += ["--journal", str(tmp_path / "journal")] if journal else []
        mission = missions("short", "--lockstep", *SHORTER, *flags)
        mission.start("link", flags=WAIT_FOR)
        mission.start("field", "rover", "ground")
        mission.ready()
        return Lockstep(mission)

    return begin


@pytest.fixture(scope="module")
def shared_lockstep(shared_missions: Callable[..., object], coarse_t1: Path) -> Lockstep:
    """A mission shared by tests that leave it unchanged and do not wait for its end."""
    mission = shared_missions("short", "--lockstep", "--set", "rounds=200", "--set", f"region={coarse_t1}")
    mission.start("link", flags=WAIT_FOR)
    mission.start("field", "rover", "ground")
    mission.ready()
    return Lockstep(mission)


@pytest.fixture
def standing(shared_lockstep: Lockstep) -> Lockstep:
    """The shared mission, paused ten minutes after the test before."""
    stood = shared_lockstep.standing(paused=True)
    shared_lockstep.standing(until=stood.now + 600 * SECOND)
    return shared_lockstep


# --- an operator ------------------------------------------------------------------------------------------------


def test_an_operator_pauses_steps_goes_to_a_time_slows_down_and_releases_time(
    lockstep: Callable[..., Lockstep],
) -> None:
    mission = lockstep()
    first = mission.standing(paused=True)
    assert first.next_at is not None
    assert first.next_at > first.now

    second = mission.standing(steps=1)
    assert second.now == first.next_at

    fifth = mission.standing(steps=3)
    assert fifth.now > second.now

    hour = START + 3600 * SECOND
    there = mission.standing(until=hour)
    assert there.now == hour
    assert there.next_at is not None
    assert there.next_at > hour

    began, wall = there.now, time.monotonic()
    mission.control(paused=False, rate=50.0)
    later = mission.until(lambda status: status.now >= began + 50 * SECOND)
    took = time.monotonic() - wall
    assert (later.now - began) / SECOND <= 50.0 * took + 1.0, "no faster than the operator said"
    assert took >= 0.9

    mission.control(unlimited=True)
    over = mission.until(lambda status: "ground" in status.finished)
    assert over.rate is None
    mission.until(lambda status: status.paused)


def test_a_paused_mission_answers_and_takes_changes_in_at_the_time_at_which_it_stands(standing: Lockstep) -> None:
    mission, stands = standing, standing.control()
    changed = mission.client.query(LINK_SET, LinkChange(one_way_light_time_s=5.0))
    assert changed.conditions.up.one_way_light_time_s == 5.0
    assert mission.control().now == stands.now
    _, clock = mission.client.latest(EARTH_CLOCK)
    assert clock.anchor_mission_ns == stands.now
    assert mission.client.latest(GROUND_STATUS)[0].made_at <= stands.now
    mission.client.query(LINK_SET, LinkChange(one_way_light_time_s=1.282))


def test_a_bad_time_control_is_refused_in_one_line_and_changes_nothing(standing: Lockstep) -> None:
    mission, before = standing, standing.control()
    header = b'{"version":1,"mission":"short","source":"x","incarnation":0,"sequence":0,"made_at":0}'
    control = b'{"header":%b,"body":{"rate":-1.0}}' % header
    with pytest.raises(He3Error, match=r"body.rate: input should be greater than 0, got -1.0"):
        mission.client._reply(TIME_CONTROL, control, PATIENCE_S)
    assert mission.control() == before


# --- processes that die, hang, come back ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", [pytest.param("field", marks=EXHAUSTIVE), pytest.param("rover", marks=EXHAUSTIVE), "ground"]
)
def test_a_killed_process_is_named_at_once_and_time_stands_until_it_is_back(
    name: str, lockstep: Callable[..., Lockstep]
) -> None:
    mission = lockstep()
    mission.standing(until=START + 1800 * SECOND)
    mission.control(paused=False, rate=2000.0)
    mission.until(lambda status: status.now > START + 2000 * SECOND)
    mission.mission[name].kill()
    killed_at = time.monotonic()
    # A step under way may wait for it a moment before its death is known: the name comes with the detail.
    stands = mission.until(lambda status: status.waits_for == (name,) and status.detail != "")
    expect_within(2.0, time.monotonic() - killed_at, f"naming a {name} that was killed")
    assert re.match(rf"{name} \({name}\.\d+\.\w+\) is gone.*; mission time stands until it is back$", stands.detail)
    again = mission.control()
    assert (again.now, again.step) == (stands.now, stands.step), "time stands cleanly"
    mission.mission.start(name)
    mission.mission.ready(name)
    mission.moves_on()
    assert mission.control().detail == ""
    mission.control(unlimited=True)
    mission.until(lambda status: "ground" in status.finished)


def test_a_process_that_hangs_is_named_and_time_stands_until_it_goes_on(standing: Lockstep) -> None:
    mission = standing
    rover = mission.mission["rover"]
    os.kill(rover.pid, signal.SIGSTOP)
    try:
        mission.control(paused=False)
        named = mission.until(lambda status: bool(status.detail))
        assert named.waits_for == ("rover",)
        assert named.detail.startswith(f"step {named.step} waits for rover (last heard from ")
        assert mission.control().step == named.step
    finally:
        os.kill(rover.pid, signal.SIGCONT)
    mission.moves_on()
    assert mission.control().detail == ""


@pytest.mark.exhaustive
def test_a_process_that_hangs_can_be_replaced_and_then_ends_when_it_wakes_up(
    lockstep: Callable[..., Lockstep],
) -> None:
    mission = lockstep(journal=False)
    mission.standing(until=START + 1800 * SECOND)
    hung = mission.mission["field"]
    os.kill(hung.pid, signal.SIGSTOP)
    mission.mission.start("field")
    mission.mission.ready("field")
    os.kill(hung.pid, signal.SIGCONT)
    mission.control(paused=False)
    mission.moves_on()
    assert hung.end() == 2
    assert "he3 field: another process has taken part as field since" in hung.text


@pytest.mark.exhaustive
def test_when_the_link_is_killed_the_others_wait_and_go_on_with_its_successor(
    lockstep: Callable[..., Lockstep],
) -> None:
    mission = lockstep()
    stood = mission.standing(until=START + 1800 * SECOND)
    mission.mission["link"].kill()
    mission.mission.close_clients()
    mission._client = None
    mission.mission.start("link", flags=WAIT_FOR)
    mission.mission.ready("link")
    mission.until(lambda status: not status.waits_for and status.now >= stood.now)
    mission.moves_on()
    assert mission.control().now > stood.now, "time never ran backwards"


@pytest.mark.exhaustive
def test_a_query_to_a_server_that_dies_is_sent_again_when_it_is_back(
    lockstep: Callable[..., Lockstep],
) -> None:
    mission = lockstep()
    mission.standing(until=START + 1800 * SECOND)
    field = mission.mission["field"]
    os.kill(field.pid, signal.SIGSTOP)
    mission.control(paused=False)
    asked = mission.until(lambda status: status.waits_for == ("field",))
    field.kill()
    mission.until(lambda status: "is gone in step" in status.detail)
    assert mission.control().now == asked.now
    mission.mission.start("field")
    mission.moves_on()
    mission.until(lambda status: "ground" in status.finished)


def test_a_time_manager_that_hangs_is_reported_by_all_that_wait_for_it(standing: Lockstep) -> None:
    mission = standing
    link = mission.mission["link"]
    os.kill(link.pid, signal.SIGSTOP)
    try:
        for name in ("field", "rover", "ground"):
            mission.mission[name].line("the time manager has been silent for 5 s")
    finally:
        os.kill(link.pid, signal.SIGCONT)
    mission.control(paused=False)
    mission.moves_on()


# --- clients that are no part of the mission -------------------------------------------------------------------

LOOKS_ON_AND_HANGS = """
import os, signal, sys
from services.runtime.transport.opening import open_client
from schemas.topics import Side
session = open_client(Side.EARTH, sys.argv[1])
heard = session.declare_subscriber("he3/**", lambda sample: None)
queries = [session.get("he3/short/earth/map/layer?layer=mean") for _ in range(20)]
print("hangs", flush=True)
os.kill(os.getpid(), signal.SIGSTOP)
"""


@pytest.mark.exhaustive
def test_clients_that_subscribe_to_everything_and_hang_hold_nothing_up(lockstep: Callable[..., Lockstep]) -> None:
    mission = lockstep(journal=False)
    mission.standing(until=START + 600 * SECOND)
    hung = [
        start([sys.executable, "-c", LOOKS_ON_AND_HANGS, mission.mission.earth], stdout=subprocess.PIPE)
        for _ in range(3)
    ]
    try:
        for process in hung:
            assert process.stdout is not None
            assert process.stdout.readline() == b"hangs\n"
        mission.control(paused=False)
        mission.until(lambda status: "ground" in status.finished)
    finally:
        for process in hung:
            process.kill()
            process.communicate()


def test_a_query_without_a_stamp_is_answered_and_a_message_without_one_is_not_counted(standing: Lockstep) -> None:
    mission = standing
    moon = mission.mission.client(Side.MOON, "rover")
    request = MeasurementRequest(sample_id="mine", x_m=30.0, y_m=30.0, depth_m=0.1)
    assert moon.query(MEASURE, request).sample_id == "mine"
    mission.control(paused=False)
    mission.moves_on()

"""The clock that survives a restart of the link."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from he3.errors import InvalidInput
from services.link.kept_clock import keep, kept_clock
from services.mission.mission_time import SECOND
from services.runtime.clock import FollowedClock, mission_time, newer, started
from services.runtime.machine_time import MachineTime, this_machine

START = 1_893_456_000 * SECOND
WALL = 1_700_000_000 * SECOND
HOUR = 3600 * SECOND


@dataclass
class Machine:
    wall: int = WALL
    monotonic: int = SECOND
    boot: str = "b1"

    def time(self) -> MachineTime:
        return MachineTime(lambda: self.wall, lambda: self.monotonic, self.boot)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(away=st.integers(0, HOUR), step=st.integers(-HOUR, HOUR))
def test_within_one_boot_mission_time_goes_on_whatever_is_done_to_the_wall_clock(
    tmp_path: Path, away: int, step: int
) -> None:
    machine = Machine()
    clock = started(START, 20.0, machine.wall)
    keep(tmp_path / "clock.json", clock, machine.time())
    machine.monotonic += away
    machine.wall += away + step
    back = kept_clock(tmp_path / "clock.json", machine.time(), "m", START).state
    assert mission_time(back, machine.wall) == START + 20 * away
    assert (back.epoch, back.revision, back.rate) == (clock.epoch, clock.revision, 20.0)
    assert newer(clock, back) is back
    followed = FollowedClock(machine.time())
    machine.wall += step
    followed.follow(back)
    assert followed.now() == START + 20 * away, "the wall clock counts no more once the clock has been read"


@pytest.mark.parametrize("boot", ["b2", ""])
def test_after_another_boot_the_wall_clock_says_how_long_the_link_was_away(tmp_path: Path, boot: str) -> None:
    machine = Machine()
    keep(tmp_path / "clock.json", started(START, 20.0, machine.wall), machine.time())
    machine.wall, machine.monotonic, machine.boot = WALL + 100 * SECOND, 7, boot
    back = kept_clock(tmp_path / "clock.json", machine.time(), "m", START).state
    assert mission_time(back, machine.wall) == START + 2000 * SECOND


@pytest.mark.parametrize("waits", [True, False])
def test_a_clock_that_waits_for_processes_is_told_from_one_that_an_operator_stopped(
    tmp_path: Path, waits: bool
) -> None:
    machine = Machine()
    keep(tmp_path / "clock.json", started(START, 0.0, machine.wall), machine.time(), waits=waits)
    assert kept_clock(tmp_path / "clock.json", machine.time(), "m", START).waits is waits


@pytest.mark.parametrize("content", [b"", b"{}", b'{"clock":1}', b"\xff"])
def test_a_file_that_holds_no_clock_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "clock.json").write_bytes(content)
    with pytest.raises(InvalidInput, match=r"clock\.json: expected the clock .*, got other data"):
        kept_clock(tmp_path / "clock.json", this_machine(), "m", START)


@pytest.mark.parametrize(("mission", "start"), [("other", START), ("m", START + HOUR)])
def test_the_clock_of_another_mission_is_refused(tmp_path: Path, mission: str, start: int) -> None:
    keep(tmp_path / "clock.json", started(start, 1.0, WALL), this_machine(), mission)
    with pytest.raises(InvalidInput, match=r"expected the clock of (mission m, got that of mission other|start)"):
        kept_clock(tmp_path / "clock.json", this_machine(), "m", START)


@pytest.mark.parametrize("boot", ["b1", "b2"])
def test_a_wall_clock_that_was_set_back_does_not_move_mission_time_and_is_told(tmp_path: Path, boot: str) -> None:
    machine = Machine()
    keep(tmp_path / "clock.json", started(START, 20.0, machine.wall), machine.time(), "m")
    machine.wall, machine.boot = 1000 * SECOND, boot  # as on a machine without a battery
    kept = kept_clock(tmp_path / "clock.json", machine.time(), "m", START)
    assert kept.state.anchor_mission_ns == START
    assert (kept.same_boot, kept.away_ns) == ((True, 0) if boot == "b1" else (False, 1000 * SECOND - WALL))

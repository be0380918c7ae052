"""Links on which Zenoh's own recovery gives up, with real processes: delay, loss, black-out, low rate.

The missions run so fast that hours take seconds; light time and rates are in mission time, and a second of mission time
is still longer than what the machine's timers are off by.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.journalled_mission import JournalledMission
from schemas.link import ClockChange
from schemas.topics import CLOCK_SET
from services.console.launch.endpoints import free_endpoints
from tests.processes import start
from tests.waiting import PATIENCE_S, until

HERE = Path(__file__).resolve().parent
RATE = 2500.0

CONDITIONS = {
    "a round trip of 12 s": ["link.up.one_way_light_time_s=6", "link.down.one_way_light_time_s=6"],
    "a round trip of 20 s": ["link.up.one_way_light_time_s=10", "link.down.one_way_light_time_s=10"],
    "30 % loss": ["link.up.loss=0.3", "link.down.loss=0.3"],
    "a black-out of two hours": [
        "link.at_edge=drop",
        'link.windows=[{"opens_s": 0, "closes_s": 3600}, {"opens_s": 10800, "closes_s": 1e8}]',
    ],
    "125 bit/s up and 700 bit/s down": ["link.up.rate_bit_s=125", "link.down.rate_bit_s=700"],
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("settings", CONDITIONS.values(), ids=CONDITIONS)
def test_a_mission_in_separate_processes_is_complete_in_spite_of(tmp_path: Path, settings: list[str]) -> None:
    with JournalledMission(
        tmp_path, [f"rate={RATE}", "rounds=2", "samples_per_round=2", "ground.pipeline=1", *settings]
    ) as mission:
        mission.wait_until_over(PATIENCE_S)
        lost, doubled, unequal = mission.judged()

    assert (lost, doubled, unequal) == (0, 0, 0)


@pytest.mark.exhaustive
def test_a_mission_is_complete_whatever_rate_its_clock_is_given_on_the_way(tmp_path: Path) -> None:
    settings = [
        f"rate={RATE}",
        "rounds=2",
        "samples_per_round=2",
        "ground.pipeline=1",
        "link.up.loss=0.2",
        "link.down.loss=0.2",
    ]
    with JournalledMission(tmp_path, settings) as mission:
        for rate in (200.0, 3000.0, 0.0, 800.0, 20_000.0, 50.0, RATE):
            mission.ask(CLOCK_SET, ClockChange(rate=rate))
            time.sleep(0.3)
        mission.wait_until_over(PATIENCE_S)
        lost, doubled, unequal = mission.judged()

    assert (lost, doubled, unequal) == (0, 0, 0)


@pytest.fixture
def processes() -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Processes by name, all gone when the test ends."""
    started: dict[str, subprocess.Popen[bytes]] = {}
    yield started
    for process in started.values():
        process.kill()
        process.wait()


@pytest.mark.exhaustive
def test_thirty_messages_of_100_kb_pass_a_link_of_32_kb_a_second(
    tmp_path: Path, processes: dict[str, subprocess.Popen[bytes]]
) -> None:
    ends = free_endpoints()
    flags = ["short", "--rate", "20", "--moon", ends.moon, "--earth", ends.earth, "--set", "link.up.rate_bit_s=256000"]
    script = str(HERE / "large_plans.py")
    commands = {
        "link": ["-P", "-m", "services.link", *flags, "--wait-for", "rover,ground"],
        "rover": [script, "rover", *flags],
        "ground": [script, "ground", *flags],
    }
    for name, command in commands.items():
        with (tmp_path / name).open("wb") as log:
            processes[name] = start([sys.executable, *command], stdout=log, stderr=log)

    def logs() -> str:
        return "\n".join((tmp_path / name).read_text() for name in commands)

    def finished() -> str | None:
        assert all(process.poll() is None for process in processes.values()), logs()
        said = (tmp_path / "rover").read_text()
        return said if "finished" in said else None

    said = until(finished, logs)
    came = [int(number) for number in re.findall(r"a plan arrived.*?number=(\d+)", said)]
    assert came == list(range(1, 31))
    assert said.count("whole=True") == 30

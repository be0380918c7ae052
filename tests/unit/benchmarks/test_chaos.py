"""The judge of the chaos benchmark notices what it is there to notice; its wall clock is stepped alone."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.chaos import Kind, explained, schedule
from benchmarks.journalled_mission import RECORDER, SERVICES, judged_samples
from benchmarks.wall_clock import WallClock, compiled

FULL = "he3 rover: /j/rover-0001.mcap: cannot write the journal: File too large"
TOLD = {name: {(1, number)} for number, name in enumerate(("a", "b", "c"))}


def test_a_mission_with_every_sample_once_has_lost_and_doubled_none():
    assert judged_samples(3, ["a", "b", "c"], TOLD) == (0, 0)


def test_a_sample_that_is_missing_in_the_map_is_lost_and_counts_twice_if_it_came_down():
    assert judged_samples(3, ["a", "b"], {"a": {(1, 0)}, "b": {(1, 1)}}) == (1, 0)
    assert judged_samples(3, ["a", "b"], TOLD) == (2, 0)


def test_a_sample_that_is_twice_in_the_map_or_told_of_by_two_messages_is_doubled():
    assert judged_samples(3, ["a", "b", "c", "c"], TOLD) == (0, 1)
    assert judged_samples(3, ["a", "b", "c"], {**TOLD, "b": {(1, 1), (2, 0)}}) == (0, 1)


def test_the_end_of_a_process_whose_disk_is_full_is_explained_by_its_own_last_line():
    assert explained("rover", 2, FULL, disk_was_full=True)


@pytest.mark.parametrize(
    ("name", "code", "last", "full"),
    [
        ("rover", 2, FULL, False),
        ("ground", 2, FULL, True),
        ("rover", -9, FULL, True),
        ("rover", 0, FULL, True),
        ("rover", 1, "OSError: [Errno 27] File too large", True),
        ("rover", 2, "12:00:00.000 2030-01-01T00:00:00 rover    info    ready sides=moon pid=7", True),
        ("rover", 2, "", True),
        ("link", 2, FULL.replace("rover", "link"), True),
        (RECORDER, 1, "he3 recorder: /j/mission.mcap: cannot write the recording: File too large", True),
    ],
)
def test_every_other_end_is_unexplained(name: str, code: int, last: str, full: bool):
    assert not explained(name, code, last, full)


def test_the_schedules_of_200_missions_have_every_kind_of_mishap_for_every_process():
    kinds = list(Kind)
    happened = {
        (mishap.kind, mishap.name) for number in range(200) for mishap in schedule(random.Random(f"1:{number}"), kinds)
    }
    names = (*SERVICES, RECORDER)
    assert happened == {
        *((kind, name) for kind in kinds if kind is not Kind.CLOCK for name in names), (Kind.CLOCK, "machine")
    }  # fmt: skip


READ_CLOCKS = """
import sys, time
for line in sys.stdin:
    before = time.monotonic()
    time.sleep(0.001)
    print(time.time() - float(line), time.monotonic() - before, flush=True)
"""


def test_the_wall_clock_of_a_running_process_is_stepped_and_its_monotonic_clock_and_its_sleeps_are_not(tmp_path: Path):
    library = compiled(tmp_path)
    if library is None:
        pytest.skip("there is no C compiler")
    clock = WallClock(library, tmp_path / "step")
    with subprocess.Popen(
        [sys.executable, "-c", READ_CLOCKS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=clock.environment,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        for step in (0.0, 86400.0, -3600.0):
            clock.set(step)
            process.stdin.write("0\n")
            process.stdin.flush()
            wall, slept = map(float, process.stdout.readline().split())
            here = time.time()
            assert wall == pytest.approx(here + step, abs=60.0)
            assert 0.001 <= slept < 60.0
        process.stdin.close()

"""Lockstep over Zenoh, in real processes: the same mission as in one process, to the byte, under any load."""

from __future__ import annotations

import json
import os
import sys
from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.processes import he3, he3_here, run, start

SECOND = 1_000_000_000
LIGHT = 1_282_000_000
"""One-way light time of the short mission [ns]."""
SHORTER = ("rounds=2", "samples_per_round=2")
THIN = ("link.down.rate_bit_s=4000", "link.up.rate_bit_s=2000", "ground.pipeline=1")
"""Messages take seconds to be sent, and the next round is planned while this one is driven."""
RATES = {"tm": 4000, "tc": 2000}
BURN = "while True: sum(range(10_000))"


busy_or_not = pytest.mark.parametrize(
    "busy", [False, pytest.param(True, marks=pytest.mark.exhaustive)], ids=["idle", "all-cores-busy"]
)


@contextmanager
def cores_busy(busy: bool) -> Iterator[None]:
    """Within, as many processes that only compute as there are cores, if `busy`."""
    with ExitStack() as stack:
        for _ in range((os.cpu_count() or 1) if busy else 0):
            burner = stack.enter_context(start([sys.executable, "-c", BURN]))
            stack.callback(burner.kill)
        yield


class Ran(NamedTuple):
    events: bytes
    report: dict[str, Any]


def ran(folder: Path, *words: str, settings: tuple[str, ...] = ()) -> Ran:
    """Merged event log and report of a run of the short mission by the command line."""
    folder.mkdir()
    sets = [word for setting in (*SHORTER, *settings) for word in ("--set", setting)]
    command = [sys.executable, "-m", "services.console", "run", "short", *words, *sets, "--quiet"]
    files = ["--events", str(folder / "events.log"), "--report", str(folder / "report.json")]
    done = run([*command, *files])
    assert done.returncode == 0, done.stderr
    return Ran((folder / "events.log").read_bytes(), json.loads((folder / "report.json").read_text()))


class Delivery(NamedTuple):
    topic: str
    size: int
    offered: int
    """When it was sent: the link hears it in the same instant."""
    arrived: int
    idle: bool
    """Whether every message sent before it in that direction had certainly left."""


def deliveries(events: bytes, rates: dict[str, int]) -> list[Delivery]:
    """Every message that crossed, from the lines of the link and of those on the other side."""
    offered: dict[tuple[str, ...], deque[tuple[int, bool]]] = defaultdict(deque)
    busy_until = {"tm": 0, "tc": 0}
    lines = [line.split("\t") for line in events.decode().splitlines()]
    for at, node, what in lines:
        words = what.split()
        if node == "link" and words[0] == "received":
            way, time = words[1][:2], int(at)
            offered[tuple(words[1:])].append((time, busy_until[way] <= time))
            if way in rates:
                busy_until[way] = max(busy_until[way], time) + transmission(int(words[2]), rates[way])
    crossed = []
    for at, node, what in lines:
        words = what.split()
        if words[0] == "received" and node == {"tm": "ground", "tc": "rover"}.get(words[1][:2]):
            sent, idle = offered[tuple(words[1:])].popleft()
            crossed.append(Delivery(words[1], int(words[2]), sent, int(at), idle))
    return crossed


def transmission(size: int, rate: int) -> int:
    return round(size * 8 / rate * SECOND)


def test_lockstep_and_in_process_runs_have_the_same_events_to_the_byte_with_losses_and_repetitions(
    tmp_path: Path, coarse_t1: Path
) -> None:
    faults = ("link.down.loss=0.05", "link.up.loss=0.05", "link.down.duplicate=0.05", "link.down.reorder=0.1")
    settings = (*THIN, *faults, f"region={coarse_t1}")
    alone = ran(tmp_path / "in-process", "--in-process", settings=settings)
    apart = ran(tmp_path / "lockstep", "--lockstep", settings=settings)
    assert alone.events.count(b"\n") > 500
    assert apart.events == alone.events
    same = ("samples", "rounds", "rmse_ppb", "rmse_history", "coverage_68", "path_length_m", "mission_time_s")
    assert {name: apart.report[name] for name in same} == {name: alone.report[name] for name in same}


@pytest.mark.exhaustive
@busy_or_not
def test_every_delivery_takes_exactly_its_light_time(busy: bool, tmp_path: Path) -> None:
    with cores_busy(busy):
        loaded = ran(tmp_path / "lockstep", "--lockstep", "--out", str(tmp_path / "recorded"), settings=("rounds=1",))
    crossed = deliveries(loaded.events, {})
    assert {each.topic for each in crossed} >= {"tm/sample", "tm/state", "tm/event", "tc/plan"}
    assert len(crossed) > 50
    assert {each.arrived - each.offered for each in crossed} == {LIGHT}
    assert loaded.events == ran(tmp_path / "in-process", "--in-process", settings=("rounds=1",)).events


@pytest.mark.exhaustive
@busy_or_not
def test_every_delivery_takes_its_transmission_time_too_and_never_less(busy: bool, tmp_path: Path) -> None:
    with cores_busy(busy):
        loaded = ran(tmp_path / "lockstep", "--lockstep", settings=THIN)
    crossed = deliveries(loaded.events, RATES)
    at_least = [LIGHT + transmission(each.size, RATES[each.topic[:2]]) for each in crossed]
    took = [each.arrived - each.offered for each in crossed]
    alone = [(took, expected) for took, expected, each in zip(took, at_least, crossed, strict=True) if each.idle]
    assert len(alone) > 100
    assert all(took == expected for took, expected in alone)
    assert all(took >= expected for took, expected in zip(took, at_least, strict=True))
    assert len({took for took, _ in alone}) > 10, "sizes differ, and so do times"


@pytest.mark.parametrize("words", [("--rate", "50"), ()])
def test_an_event_log_is_refused_where_times_are_not_exact(words: tuple[str, ...], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "services.console", "run", "short", *words, "--events", str(tmp_path / "e.log")]
    done = run(command)
    assert done.returncode == 2
    assert done.stderr.startswith("he3: --events: expected it with --in-process or --lockstep")


@pytest.mark.exhaustive
def test_a_mission_that_is_rehearsed_again_and_again_has_the_same_events_to_the_byte(tmp_path: Path) -> None:
    longer = ("rounds=8", "samples_per_round=4", "ground.planner=tour")
    undisturbed = ran(tmp_path / "undisturbed", "--in-process", settings=longer)
    settings = [word for setting in longer for word in ("--set", setting)]
    events, environment = tmp_path / "events.log", {"XDG_RUNTIME_DIR": str(tmp_path)}
    rehearsed_at = set()
    fly = he3("run", "short", "--lockstep", *settings, "--events", str(events), "--quiet")
    with start(fly, env=environment) as mission:
        while mission.poll() is None:
            done = he3_here("rehearse", "--draws", "2", "--against", "abort-round", "--json", env=environment)
            if done.returncode == 0:  # the mission has begun, and is not over
                rehearsed_at.add(json.loads(done.stdout)["at"])
    assert mission.returncode == 0
    assert len(rehearsed_at) >= 2
    assert events.read_bytes() == undisturbed.events

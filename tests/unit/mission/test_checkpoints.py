"""A checkpoint is complete: rover and ground restored from one are equal to the originals, part by part."""

from __future__ import annotations

import sys
import types
from collections import OrderedDict, deque
from collections.abc import Iterator
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from benchmarks.fault_schedules import random_schedule
from benchmarks.faults import CELLS, World
from schemas.codec import Passed
from schemas.topics import Topic
from services.runtime.custody.endpoint import custody_config
from services.runtime.host import Host
from services.runtime.scheduler import InlineExecutor, NodeScheduler

HOURS = 9

MADE_AGAIN = {
    "_posterior",  # of the belief: made again from its samples when one is added
    "_intervals",  # of the belief: made again from its posterior when they are asked for
    "_executor",
    "_heard",  # a question to the driver
    "changes",  # counts since the object was made
    "_paths_at",
    "_journal",
    "_trace",
    "_inbox",  # empty between two instants
    "emitted",  # counts what this process has published
    "_since_checkpoint",
    "_running",  # computations begin again; compared by name below
    "_miss",  # scratch memory of the scorer
    "effects",
    "_effects",  # of the last event; cleared before the next
    "_heap",  # made of the timers
    "_timer_may_move",  # of custody: whether its timer is looked for again; after a restart it is
    "_passed",  # of a round's record: its path at the farthest place reached
    "_wake",  # what the timers and the inbox came to last; None: it is looked for
}


def differences(a: Any, b: Any, path: str = "", seen: set[tuple[int, int]] | None = None) -> Iterator[str]:
    """The paths at which two objects differ, recursively; parts that are rebuilt are left out."""
    seen = set() if seen is None else seen
    if a is b or (id(a), id(b)) in seen:
        return
    seen.add((id(a), id(b)))
    if isinstance(a, Passed):
        a = bytes(a)  # what it was made of stays in its process
    if type(a) is not type(b):
        yield f"{path}: {type(a).__name__} and {type(b).__name__}"
    elif isinstance(a, np.ndarray):
        if (a.dtype, a.shape, a.flags.writeable) != (b.dtype, b.shape, b.flags.writeable) or a.tobytes() != b.tobytes():
            yield f"{path}: arrays"
    elif isinstance(a, dict | OrderedDict):
        if list(a) != list(b):
            yield f"{path}: keys {list(a)} and {list(b)}"
        for key in a:
            if key in b:
                yield from differences(a[key], b[key], f"{path}[{key!r}]", seen)
    elif isinstance(a, list | tuple | deque):
        if len(a) != len(b):
            yield f"{path}: {len(a)} and {len(b)} items"
        for number, (one, other) in enumerate(zip(a, b, strict=False)):
            yield from differences(one, other, f"{path}[{number}]", seen)
    elif isinstance(a, int | float | str | bytes | bool | None | Enum | set | frozenset | Topic | BaseModel | type):
        if a != b and not (a != a and b != b):
            yield f"{path}: {a!r} and {b!r}"
    elif not isinstance(a, types.FunctionType | types.MethodType | partial):
        for name in attributes(a):
            if name not in MADE_AGAIN:
                yield from differences(getattr(a, name), getattr(b, name), f"{path}.{name}", seen)


def attributes(value: object) -> list[str]:
    """Names of everything that the object holds, in slots or not."""
    slots = [name for each in type(value).__mro__ for name in getattr(each, "__slots__", ()) if hasattr(value, name)]
    return [*slots, *getattr(value, "__dict__", {})]


def restored(world: World, name: str, live: NodeScheduler, forget: str = "") -> NodeScheduler:
    """A new scheduler, host and node, from a checkpoint of the live one. forget: a part that stays as it is made."""
    codec = live.host.codec
    state = codec.decode(codec.encode(live.checkpoint()))
    node = world._built(name)
    host = Host(node, live.host.mission, custody=custody_config(world.scenario.link, node.interface))
    again = NodeScheduler(host, InlineExecutor())
    if forget:
        *path, last = forget.split(".")
        part, made = state, again.checkpoint()
        for step in path:
            part, made = part[step], made[step]
        part[last] = made[last]
    again.replay([], state)
    return again


@pytest.mark.parametrize("seed", [1, 21])
def test_a_node_restored_from_its_checkpoint_is_what_it_was_all_through_a_mission_with_faults(seed: int) -> None:
    world = World(seed, InlineExecutor(), planner="tour")
    simulation = world.mission.simulation
    schedule = random_schedule(np.random.default_rng(seed), HOURS * 3600.0, CELLS, most=12)
    compared = 0

    def compare() -> None:
        nonlocal compared
        for name in ("rover", "ground"):
            if simulation.alive(name):
                live = simulation._schedulers[name]
                again = restored(world, name, live)
                assert list(differences(live, again, name)) == []
                assert again.computations() == live.computations()
                compared += 1

    for fault in schedule:
        world.suffer([fault])
        compare()
    for _ in range(HOURS):
        simulation.run_for(1800.0)
        compare()
    world.mission.run()
    compare()
    assert compared > 2 * HOURS


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("rover", "timers"),
        ("rover", "host.sequences"),
        ("rover", "host.custody.sender"),
        ("rover", "host.node.executive.vehicle.driven_m"),
        ("ground", "host.node.director.belief.map"),
        ("ground", "host.node.director.planning.tasks"),
        ("ground", "host.node.publisher.mean_std_ppb"),
    ],
)
def test_a_checkpoint_that_forgets_something_is_found(name: str, part: str) -> None:
    world = World(1, InlineExecutor(), planner="tour")
    world._run_until(3600)
    live = world.mission.simulation._schedulers[name]
    assert list(differences(live, restored(world, name, live), name)) == []
    assert list(differences(live, restored(world, name, live, forget=part), name)) != []


def test_a_checkpoint_holds_a_plug_in_planner_at_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "at_work.py").write_text("def planner(request):\n    raise SystemExit('never asked here')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    world = World(1, InlineExecutor(), planner="at_work:planner")
    world._run_until(1)
    live = world.mission.simulation._schedulers["ground"]
    assert list(live.computations()) == ["plan:1:1"]
    again = restored(world, "ground", live)
    assert again.computations() == live.computations()
    sys.modules.pop("at_work")

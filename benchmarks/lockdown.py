"""The cost of lock-down: times of missions and queries over TLS with access rules, compared with those without keys.

Missions in lockstep run in pairs, one without keys and one with keys, in alternating order; their wall times are
compared pair by pair. Then a mission of each kind runs on the wall clock, and a client of each asks for points of the
map, by turns. Both figures are ratios, so that they hold on a busy machine, too.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from statistics import median, quantiles
from typing import Any

import numpy as np
import zenoh

from benchmarks import kept
from he3.errors import He3Error, InvalidInput
from schemas.topics import MAP_POINT, Side
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.console.launch.keys import temporary_keys
from services.console.launch.scenarios import Chosen, choose
from services.console.launch.separate import run_separate, services_of
from services.console.report.outputs import outputs
from services.console.report.progress import progress_for
from services.runtime.transport.opening import open_client
from services.runtime.trust.identity import load_identity

WARM_UP = 20
"""Warm-up queries of each kind, which are not counted."""


def run(
    scenario: str = "t1",
    runs: int = 3,
    queries: int = 1000,
    json: Path | str | None = None,
    *,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Wall times and query times with and without keys, and their ratios; printed, and written to ``json``.

    runs: missions of each kind. queries: of each kind. Raises InvalidInput for less than one run or query.
    """
    if runs < 1 or queries < 1:
        raise InvalidInput(f"expected at least 1 run and 1 query, got {runs} and {queries}")
    with temporary_keys() as keys:
        plain, locked = choose(scenario), choose(scenario, keys=keys)
        times = _mission_times(plain, locked, runs, say)
        asked = _query_times(scenario, keys, queries)
    ratios = [with_keys / without for without, with_keys in times]
    document = {
        "scenario": plain.scenario.name,
        "mission_s": [each[0] for each in times],
        "mission_with_keys_s": [each[1] for each in times],
        "mission_ratio": median(ratios),
        "query_p50_s": median(asked["plain"]),
        "query_with_keys_p50_s": median(asked["locked"]),
        "query_p99_s": _p99(asked["plain"]),
        "query_with_keys_p99_s": _p99(asked["locked"]),
        "query_ratio": median(asked["locked"]) / median(asked["plain"]),
        "load": os.getloadavg()[0],
    }
    say(f"mission in lockstep: {document['mission_ratio']:.3f} times as long with keys, median of {runs} pairs")
    say(
        f"query of a point: median {1e3 * document['query_p50_s']:.2f} ms, with keys "
        f"{1e3 * document['query_with_keys_p50_s']:.2f} ms, {document['query_ratio']:.2f} times as long"
    )
    kept.write_whole(json, document)
    return document


def _mission_times(plain: Chosen, locked: Chosen, runs: int, say: Callable[[str], None]) -> list[tuple[float, float]]:
    """Wall time [s] of each pair of missions, without and with keys."""
    pairs = []
    for number in range(runs):
        order = (plain, locked) if number % 2 == 0 else (locked, plain)
        took = {each is locked: _mission_time(each) for each in order}
        pairs.append((took[False], took[True]))
        say(f"{plain.scenario.name} in lockstep: {took[False]:.1f} s, with keys {took[True]:.1f} s")
    return pairs


def _mission_time(chosen: Chosen) -> float:
    report = run_separate(chosen, outputs(None, None), progress_for("", "", quiet=True), lockstep=True).report
    if not report.completed:
        raise He3Error(f"the mission {chosen.scenario.name} failed: {report.detail}")
    return report.wall_time_s


def _query_times(scenario: str, keys: Path, queries: int) -> dict[str, list[float]]:
    """Query times [s] of a mission without keys and of one with keys."""
    with ExitStack() as ends:
        sessions: dict[str, tuple[zenoh.Session, str]] = {}
        for name in ("plain", "locked"):
            chosen = choose(scenario, rate=1.0, keys=keys if name == "locked" else None)
            free = free_endpoints("tls" if name == "locked" else "tcp")
            launcher, endpoints = ends.enter_context(services_of(chosen, outputs(None, None), free))
            viewer = None if chosen.keys is None else chosen.keys.viewer
            mission = chosen.scenario.name
            with MissionClient.when_up(endpoints.earth, mission, launcher.check, identity=viewer) as client:
                client.wait_for_ground(launcher.check)
                _until_there_is_a_map(client, launcher.check)
            identity = None if viewer is None else load_identity(viewer)
            session = open_client(Side.EARTH, endpoints.earth, identity=identity)
            ends.callback(session.close)
            sessions[name] = session, MAP_POINT.key(mission)
        places = np.random.default_rng(1)
        times: dict[str, list[float]] = {name: [] for name in sessions}
        for number in range(queries + WARM_UP):
            x, y = places.uniform(0.0, 200.0, 2)
            for name in ("plain", "locked") if number % 2 == 0 else ("locked", "plain"):
                session, key = sessions[name]
                began = time.perf_counter()
                replies = list(session.get(f"{key}?x={x:.3f};y={y:.3f}"))
                took = time.perf_counter() - began
                if len(replies) != 1 or replies[0].ok is None:
                    raise He3Error(f"expected one reply to a query of a point, got {len(replies)} ({name})")
                if number >= WARM_UP:
                    times[name].append(took)
    return times


def _until_there_is_a_map(client: MissionClient, check: Callable[[], None]) -> None:
    while True:
        check()
        try:
            client.point(100.0, 100.0)
            return
        except He3Error:
            time.sleep(0.1)


def _p99(times: list[float]) -> float:
    return quantiles(times, n=100)[-1] if len(times) > 1 else times[0]

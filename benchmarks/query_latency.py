"""How long a map query takes while the ground computes a plan, beside a bare Zenoh queryable in the same run.

A whole mission runs in separate processes, fast, so that plan follows upon plan. An operator asks for the map at a
point, and in turn asks a queryable in a separate process that answers each query with the same number of bytes and
does nothing else. Only pairs of queries count that were asked while a plan was being computed, from beginning to end;
the first plan, for which the planner process only starts, does not count, and at least `plans` others do.

    queries              how many pairs counted
    point_p50_s, point_p99_s       median and 99th percentile of the map query [s]
    bare_p50_s, bare_p99_s         the same of the bare queryable [s]
    ratio                point_p50_s / bare_p50_s
    plans                how many plans were computed meanwhile
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import os
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from benchmarks import kept
from benchmarks.peer import Peer, answer_line
from he3.errors import He3Error, InvalidInput
from schemas.ground import GroundStatus, MissionPhase
from schemas.topics import GROUND_STATUS, MAP_POINT, Side
from schemas.wire import Header
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.mission.deployment import find_scenario
from services.mission.processes import LINK, PROCESSES, VITAL, waited_for
from services.mission.scenario import load_scenario
from services.runtime.transport.opening import open_client

BARE_KEY = "bench/bare"
GIVE_UP_S = 300.0
"""Time limit [s of wall time] to collect the queries."""

Row = dict[str, Any]


def run(
    queries: int = 1000,
    scenario: str = "t1-paper",
    planner: str = "rrtstar",
    rate: float = 3000.0,
    seed: int = 1,
    plans: int = 4,
    json: Path | str | None = None,
    *,
    say: Callable[[str], None] = print,
) -> Row:
    """The figures of `queries` pairs asked while plans were being computed; printed, and written to ``json``.

    rate: mission seconds per wall second. plans: each plan contributes at most `queries / plans` queries.
    Raises InvalidInput for figures that make no sense, He3Error when the mission
    has not planned for long enough to ask that often.
    """
    if queries < 1 or plans < 1 or rate <= 0:
        raise InvalidInput(f"expected at least 1 query, 1 plan and a rate above 0, got {queries}, {plans} and {rate:g}")
    path = find_scenario(scenario)
    mission = load_scenario(path)
    endpoints = free_endpoints()
    # With no time reserved for planning, 'a plan is in work' means that one is being computed.
    flags = ["--set", f'ground.planner="{planner}"', "--set", "ground.planning_s=0", "--rate", str(rate)]
    flags += ["--seed", str(seed), "--log-level", "warning", "--moon", endpoints.moon, "--earth", endpoints.earth]
    with ExitStack() as ends:
        waiting = ["--wait-for", ",".join(waited_for(VITAL))]
        link = Peer(ends, LINK.module, str(path), *flags, *waiting)
        others = [each for each in PROCESSES if each.vital and each is not LINK]
        services = [link, *(Peer(ends, each.module, str(path), *flags) for each in others)]
        watcher = _Planning(ends.enter_context(MissionClient.when_up(endpoints.earth, mission.name, link.check)))
        bare = Peer(ends, "benchmarks.query_latency", endpoints.earth)
        bare.answer()
        session = open_client(Side.EARTH, endpoints.earth)
        ends.callback(session.close)
        row = _measured(session, mission.name, watcher, services, queries, -(-queries // plans))
    row |= {"planner": planner, "scenario": mission.name, "cpus": os.cpu_count(), "load": os.getloadavg()[0]}
    say(
        f"map point query while planning ({planner}, {row['plans']} plans, {row['queries']} queries): median "
        f"{_ms(row['point_p50_s'])}, 99 % {_ms(row['point_p99_s'])}\n"
        f"bare Zenoh queryable in the same run: median {_ms(row['bare_p50_s'])}, 99 % {_ms(row['bare_p99_s'])}\n"
        f"ratio of the medians {row['ratio']:.2f}"
    )
    kept.write_whole(json, row)
    return row


class _Planning:
    """Whether the ground is computing a plan, according to its status."""

    def __init__(self, client: MissionClient) -> None:
        self.status: GroundStatus | None = None
        client.listen(GROUND_STATUS, self._take)

    def _take(self, _header: Header, status: GroundStatus) -> None:
        self.status = status

    @property
    def revision(self) -> int | None:
        """Revision of the plan before the one being computed; None if none is being computed, or the first."""
        status = self.status
        return None if status is None or not status.plans_in_work else status.plan_revision or None


def _measured(
    session: zenoh.Session, mission: str, watcher: _Planning, services: list[Peer], queries: int, most: int
) -> Row:
    random = np.random.default_rng(1)
    key = MAP_POINT.key(mission)
    point: list[float] = []
    bare: list[float] = []
    plans: Counter[int] = Counter()
    give_up = time.monotonic() + GIVE_UP_S
    while len(point) < queries:
        for service in services:
            service.check()
        revision = watcher.revision
        if revision is None or plans[revision] >= most:
            status = watcher.status
            if time.monotonic() > give_up or (status is not None and status.phase is MissionPhase.COMPLETED):
                raise He3Error(f"expected {queries} queries while planning, got {len(point)} before the mission ended")
            time.sleep(0.005)
            continue
        x, y = random.uniform(0.0, 500.0, 2)
        to_map, to_bare = f"{key}?x={x:.3f};y={y:.3f}", f"{BARE_KEY}?x={x:.3f};y={y:.3f}"
        # Taking turns at going first, so that neither always finds the other's traces.
        if len(point) % 2:
            to_map_s, to_bare_s = _asked(session, to_map), _asked(session, to_bare)
        else:
            to_bare_s, to_map_s = _asked(session, to_bare), _asked(session, to_map)
        if watcher.revision == revision:
            point.append(to_map_s)
            bare.append(to_bare_s)
            plans[revision] += 1
    return {
        "queries": len(point),
        "point_p50_s": float(np.quantile(point, 0.5)),
        "point_p99_s": float(np.quantile(point, 0.99)),
        "bare_p50_s": float(np.quantile(bare, 0.5)),
        "bare_p99_s": float(np.quantile(bare, 0.99)),
        "ratio": float(np.quantile(point, 0.5) / np.quantile(bare, 0.5)),
        "plans": len(plans),
    }


def _asked(session: zenoh.Session, selector: str) -> float:
    """Seconds until the answer arrived; raises He3Error if none did."""
    began = time.perf_counter()
    replies = list(session.get(selector))
    took = time.perf_counter() - began
    if len(replies) != 1 or replies[0].ok is None:
        raise He3Error(f"{selector}: expected one answer, got {len(replies)}")
    return took


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.3f} ms"


# --- the bare queryable, in a process of its own ----------------------------------------------------------------

ANSWER = b'{"x_m":120.0,"y_m":340.0,"mean_ppb":7.8812312,"std_ppb":1.4123123,"traversable":true,"revision":123,'
ANSWER += b'"samples":100,"mission_time_ns":1893456000000000000}'


def _answer_barely(endpoint: str) -> None:
    """Answer every query at once until standard input ends."""
    with open_client(Side.EARTH, endpoint) as session:
        session.declare_queryable(BARE_KEY, lambda query: query.reply(BARE_KEY, ANSWER))
        answer_line("ready")
        sys.stdin.read()


if __name__ == "__main__":
    if len(sys.argv) == 2:
        _answer_barely(sys.argv[1])
    else:
        run()

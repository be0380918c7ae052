"""How long a map query takes while the ground computes a plan, beside a bare Zenoh queryable in the same run.

A whole mission runs in separate processes, fast, so that plan follows upon plan. An operator asks for the map at a
point, and in turn asks a queryable in a separate process that answers each query with the same number of bytes and
does nothing else. Only pairs of queries count that were asked while a plan was being computed, from beginning to end;
the first plan, for which the planner process only starts, does not count, and at least `plans` others do. When a
mission ends before enough pairs were asked (a busy machine answers fewer of them in the time of one plan), the next one
starts, with the next seed.

    queries              how many pairs counted
    point_p50_s, point_p99_s       median and 99th percentile of the map query [s]
    bare_p50_s, bare_p99_s         the same of the bare queryable [s]
    ratio                point_p50_s / bare_p50_s
    plans                how many plans were computed meanwhile
    missions             how many missions it took
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
"""Time limit [s of wall time] of one mission."""

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
    Raises InvalidInput for figures that make no sense, He3Error when a mission
    planned for too short a time to ask even once.
    """
    if queries < 1 or plans < 1 or rate <= 0:
        raise InvalidInput(f"expected at least 1 query, 1 plan and a rate above 0, got {queries}, {plans} and {rate:g}")
    path = find_scenario(scenario)
    mission = load_scenario(path)
    asked = _Asked(queries, most_of_a_plan=-(-queries // plans))
    missions = 0
    while not asked.enough:
        before = len(asked.point)
        _fly(path, mission.name, planner, rate, seed + missions, asked)
        missions += 1
        if len(asked.point) == before:
            raise He3Error(
                f"expected {queries} queries while planning, got {before}: "
                f"mission {missions} (seed {seed + missions - 1}) added none"
            )
    row = asked.row() | {"missions": missions}
    row |= {"planner": planner, "scenario": mission.name, "cpus": os.cpu_count(), "load": os.getloadavg()[0]}
    say(
        f"map point query while planning ({planner}, {row['plans']} plans of {_missions(missions)}, "
        f"{row['queries']} queries): median "
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

    @property
    def ended(self) -> bool:
        status = self.status
        return status is not None and status.phase is MissionPhase.COMPLETED


class _Asked:
    """The durations of the pairs of queries that counted, over all missions."""

    def __init__(self, queries: int, most_of_a_plan: int) -> None:
        self.point: list[float] = []
        self.bare: list[float] = []
        self._queries = queries
        self._most_of_a_plan = most_of_a_plan
        self._plans: Counter[tuple[int, int]] = Counter()
        self._random = np.random.default_rng(1)

    @property
    def enough(self) -> bool:
        return len(self.point) >= self._queries

    def wants(self, plan: tuple[int, int]) -> bool:
        """Whether a further pair of this plan counts."""
        return self._plans[plan] < self._most_of_a_plan

    def ask(self, session: zenoh.Session, map_key: str, plan: tuple[int, int], watcher: _Planning) -> None:
        """Ask one pair; it counts if the plan, given by seed and revision, is still in work afterwards."""
        x, y = self._random.uniform(0.0, 500.0, 2)
        to_map, to_bare = f"{map_key}?x={x:.3f};y={y:.3f}", f"{BARE_KEY}?x={x:.3f};y={y:.3f}"
        # Taking turns at going first, so that neither always finds the other's traces.
        if len(self.point) % 2:
            to_map_s, to_bare_s = _seconds_of(session, to_map), _seconds_of(session, to_bare)
        else:
            to_bare_s, to_map_s = _seconds_of(session, to_bare), _seconds_of(session, to_map)
        if watcher.revision == plan[1]:
            self.point.append(to_map_s)
            self.bare.append(to_bare_s)
            self._plans[plan] += 1

    def row(self) -> Row:
        return {
            "queries": len(self.point),
            "point_p50_s": float(np.quantile(self.point, 0.5)),
            "point_p99_s": float(np.quantile(self.point, 0.99)),
            "bare_p50_s": float(np.quantile(self.bare, 0.5)),
            "bare_p99_s": float(np.quantile(self.bare, 0.99)),
            "ratio": float(np.quantile(self.point, 0.5) / np.quantile(self.bare, 0.5)),
            "plans": sum(count > 0 for count in self._plans.values()),
        }


def _fly(path: Path, name: str, planner: str, rate: float, seed: int, asked: _Asked) -> None:
    """Fly one mission and ask during its plans, until `asked` is enough or the mission has ended."""
    endpoints = free_endpoints()
    # With no time reserved for planning, 'a plan is in work' means that one is being computed.
    flags = ["--set", f'ground.planner="{planner}"', "--set", "ground.planning_s=0", "--rate", str(rate)]
    flags += ["--seed", str(seed), "--log-level", "warning", "--moon", endpoints.moon, "--earth", endpoints.earth]
    with ExitStack() as ends:
        waiting = ["--wait-for", ",".join(waited_for(VITAL))]
        link = Peer(ends, LINK.module, str(path), *flags, *waiting)
        others = [each for each in PROCESSES if each.vital and each is not LINK]
        services = [link, *(Peer(ends, each.module, str(path), *flags) for each in others)]
        watcher = _Planning(ends.enter_context(MissionClient.when_up(endpoints.earth, name, link.check)))
        bare = Peer(ends, "benchmarks.query_latency", endpoints.earth)
        bare.answer()
        session = open_client(Side.EARTH, endpoints.earth)
        ends.callback(session.close)
        give_up = time.monotonic() + GIVE_UP_S
        while not asked.enough and not watcher.ended:
            for service in services:
                service.check()
            revision = watcher.revision
            if revision is None or not asked.wants((seed, revision)):
                if time.monotonic() > give_up:
                    raise He3Error(f"the mission with seed {seed} has not ended within {GIVE_UP_S:g} s")
                time.sleep(0.005)
                continue
            asked.ask(session, MAP_POINT.key(name), (seed, revision), watcher)


def _seconds_of(session: zenoh.Session, selector: str) -> float:
    """Seconds until the answer arrived; raises He3Error if none did."""
    began = time.perf_counter()
    replies = list(session.get(selector))
    took = time.perf_counter() - began
    if len(replies) != 1 or replies[0].ok is None:
        raise He3Error(f"{selector}: expected one answer, got {len(replies)}")
    return took


def _missions(count: int) -> str:
    return "one mission" if count == 1 else f"{count} missions"


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

"""The speed of virtual time in lockstep, compared with one process; the event logs of both must be equal.

The same mission runs once in this process and once as four processes over Zenoh, whose time the link keeps.

    events              what the nodes handled: messages, questions, answers, results, timers
    mission_h           mission time from beginning to end [h]
    wall_s              wall time from the first event to the last [s]
    start_s             before that: starting processes, reading the region, finding each other [s]
    planning_s          part of wall_s in which all waited for a plan [s]
    events_per_s        events / (wall_s - planning_s)
    wall_s_per_mission_h
    identical           whether the event log is that of the first row, to the byte
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from benchmarks import kept
from he3.errors import He3Error, PeerUnreachable
from schemas.lockstep import TimeStatus
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.console.launch.launcher import Launcher
from services.console.launch.scenarios import Chosen, choose
from services.ground.planner_process import PlannerProcess
from services.mission.in_process import InProcessMission
from services.mission.mission_time import SECOND
from services.mission.processes import GROUND, LINK, VITAL
from services.runtime.event_log import EventLog, merge_event_logs
from services.runtime.scheduler import Executor

Row = dict[str, Any]

LOOK_EVERY_S = 0.05
HANGS_AFTER_S = 300.0
"""Longest wall time [s] that time may stop for one reason."""


def run(
    scenario: str = "t1-paper",
    seed: int | None = None,
    json: Path | str | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """A row for each driver; printed, and written to ``json``. Raises He3Error if a mission fails."""
    chosen = choose(scenario, seed=seed)
    say(
        f"{'driver':<12} {'events':>8} {'mission':>9} {'start':>8} {'wall':>8} {'planning':>9} "
        f"{'events/s':>9} {'s per h':>8}  same events"
    )
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="he3-lockstep-") as folder:
        logs = Path(folder)
        for measure in (_in_process, _lockstep):
            row = measure(chosen, logs)
            same = (logs / f"{row['driver']}.log").read_bytes() == (logs / "in-process.log").read_bytes()
            rows.append({**row, "identical": same})
            say(
                f"{row['driver']:<12} {row['events']:>8,} {row['mission_h']:>7.2f} h {row['start_s']:>6.2f} s "
                f"{row['wall_s']:>6.2f} s {row['planning_s']:>7.2f} s {row['events_per_s']:>9,.0f} "
                f"{row['wall_s_per_mission_h']:>8.3f}  {'yes' if same else 'NO'}"
            )
    kept.write_whole(json, {"rows": rows})
    return rows


def _in_process(chosen: Chosen, logs: Path) -> Row:
    log = logs / "in-process.log"
    began = time.monotonic()
    with PlannerProcess() as planners:
        waiting = _Waiting(planners)
        events = EventLog(log)
        mission = InProcessMission(chosen.scenario, waiting, event_sink=events)
        started = time.monotonic()
        mission.run()
        ended = time.monotonic()
        events.close()
    count = merge_event_logs([log], log)
    return _row("in-process", count, mission.mission_time_s, started - began, ended - started, waiting.waited_s)


def _lockstep(chosen: Chosen, logs: Path) -> Row:
    parts = {name: logs / f"{name}.part" for name in VITAL}
    flags: dict[str, list[str]] = {name: ["--events", str(parts[name])] for name in VITAL}
    flags[LINK.name] += ["--stop-when", GROUND.name]
    endpoints = free_endpoints()
    began = time.monotonic()
    words = (*chosen.flags, "--lockstep", "--log-level", "warning")
    with (
        Launcher(chosen.path, endpoints, words, service_flags=dict(flags)) as launcher,
        MissionClient.when_up(endpoints.earth, chosen.scenario.name, launcher.check) as client,
    ):
        started = _when(client, launcher, lambda status: status.step > 0)[0]
        ended, status = _when(client, launcher, lambda status: "ground" in status.finished and status.paused)
    log = logs / "lockstep.log"
    count = merge_event_logs(parts.values(), log)
    lasted_s = (status.now - status.start_ns) / SECOND
    return _row("lockstep", count, lasted_s, started - began, ended - started, status.computing_s)


def _when(client: MissionClient, launcher: Launcher, wanted: Callable[[TimeStatus], bool]) -> tuple[float, TimeStatus]:
    """Wall time and status once `wanted` holds for the status; raises He3Error if time stops for too long."""
    reason, since = "", time.monotonic()
    while True:
        launcher.check()
        try:
            status = client.control_time()
        except PeerUnreachable:
            time.sleep(LOOK_EVERY_S)
            continue
        if wanted(status):
            return time.monotonic(), status
        if status.detail != reason:
            reason, since = status.detail, time.monotonic()
        elif reason and time.monotonic() > since + HANGS_AFTER_S:
            raise He3Error(f"lockstep: {reason}")
        time.sleep(LOOK_EVERY_S)


def _row(driver: str, events: int, lasted_s: float, start_s: float, wall_s: float, planning_s: float) -> Row:
    hours = lasted_s / 3600.0
    return {
        "driver": driver,
        "events": events,
        "mission_h": hours,
        "start_s": start_s,
        "wall_s": wall_s,
        "planning_s": planning_s,
        "events_per_s": events / max(wall_s - planning_s, 1e-9),
        "wall_s_per_mission_h": wall_s / hours,
    }


class _Waiting:
    """An executor that measures the time spent waiting for its results."""

    def __init__(self, executor: Executor) -> None:
        self.waited_s = 0.0
        self._executor = executor

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        return _Awaited(self._executor.submit(function, *arguments), self)


class _Awaited(Future[Any]):
    """A future that wraps another one and measures the wait for its result."""

    def __init__(self, future: Future[Any], waiting: _Waiting) -> None:
        super().__init__()
        self._future = future
        self._waiting = waiting
        future.add_done_callback(self._take)

    def _take(self, future: Future[Any]) -> None:
        error = future.exception()
        if error is None:
            self.set_result(future.result())
        else:
            self.set_exception(error)

    def exception(self, timeout: float | None = None) -> BaseException | None:
        began = time.monotonic()
        try:
            return super().exception(timeout)
        finally:
            self._waiting.waited_s += time.monotonic() - began


if __name__ == "__main__":
    run()

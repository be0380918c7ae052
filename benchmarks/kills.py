"""Real processes, real `kill -9`: rover, ground, link and field in turn, at random instants of short missions.

Each killed process is started again at once. A mission must come to its end with all samples in the map exactly once,
none reported under two numbers, and the map unchanged to the byte by one more restart of the ground.

    restart_s   from the start of the new process until it takes part again: read code, region and journal, joined both
                networks, knows the time; the middle and the worst of all kills
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import json as json_format
import random
import signal
import statistics
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from he3.errors import He3Error, InvalidInput
from schemas.codec import decode
from schemas.commands import NoParameters
from schemas.ground import MissionPhase, MissionTrack
from schemas.maps import MapLayer, MapLayerQuery
from schemas.topics import GROUND_STATUS, MAP_LAYER, SAMPLE, TRACK, Topic
from schemas.wire import Wire
from services.console.launch.launcher import free_endpoints
from services.mission.deployment import find_scenario
from services.mission.processes import LINK, VITAL, waited_for
from services.mission.scenario import Scenario, load_scenario
from services.runtime.child import child_environment, python_command
from services.runtime.journal import JournalReader, identity_of
from services.runtime.options import parse_setting, with_settings
from services.runtime.transport.client import Client

VICTIMS = ("rover", "ground", "link", "field")
READY_WITHIN_S = 600.0
"""Only a process that hangs takes as long."""
LATEST_S = 1.5
"""The next kill comes within this time of the last restart [s]."""
POLL_S = 0.005

Row = dict[str, Any]


def run(
    kills: int = 20,
    rounds: int = 8,
    rate: float = 1000.0,
    seed: int = 1,
    within: float = 600.0,
    settings: Sequence[str] = (),
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> Row:
    """Kill each of the four services so many times, over as many missions as that takes; what came of it.

    within: seconds of wall time that one mission may take. settings: other values of the scenario, as for ``--set``.
    Raises He3Error when a sample was lost or doubled, a mission stuck, or a map came back otherwise.
    """
    if kills < 1 or rounds < 1:
        raise InvalidInput(f"expected one kill and one round at least, got {kills} and {rounds}")
    dice = random.Random(seed)
    left = [name for _ in range(kills) for name in VICTIMS]
    restarts: list[tuple[str, float]] = []
    row: Row = {"missions": 0, "kills": 0, "samples": 0, "lost": 0, "doubled": 0, "unequal": 0}
    while left:
        row["missions"] += 1
        changes = [f"rounds={rounds}", f"seed={seed + row['missions']}", f"rate={rate}", *settings]
        with tempfile.TemporaryDirectory(prefix="he3-kills-") as folder, Mission(Path(folder), changes) as mission:
            before = len(restarts)
            while left and not mission.over:
                time.sleep(dice.uniform(0.0, LATEST_S))
                name = left.pop(0)
                restarts.append((name, mission.restart(name)))
            mission.wait_until_over(within)
            lost, doubled, unequal = mission.judged()
        row["kills"] = len(restarts)
        row["samples"] += mission.scenario.samples
        row["lost"] += lost
        row["doubled"] += doubled
        row["unequal"] += unequal
        say(
            f"mission {row['missions']}: {len(restarts) - before} kills, {mission.scenario.samples} samples, "
            f"{lost} lost, {doubled} doubled, map {'differs' if unequal else 'the same'} after a restart"
        )
    row["restart_s"] = statistics.median(seconds for _, seconds in restarts)
    row["worst_restart_s"] = max(seconds for _, seconds in restarts)
    for name in VICTIMS:
        times = [seconds for who, seconds in restarts if who == name]
        row[f"restart_{name}_s"] = statistics.median(times)
        say(
            f"{name:<7} killed {len(times)} times, back after {statistics.median(times):.2f} s, "
            f"worst {max(times):.2f} s"
        )
    if json is not None:
        json.write_text(json_format.dumps(row, indent=2) + "\n", encoding="utf-8")
    if row["lost"] or row["doubled"] or row["unequal"]:
        raise He3Error(f"{row['lost']} lost, {row['doubled']} doubled, {row['unequal']} unequal of {row['missions']}")
    return row


class Mission:
    """Four processes with journals in a folder; gone when the `with` statement ends."""

    def __init__(self, folder: Path, settings: Sequence[str], scenario: str = "short") -> None:
        path = find_scenario(scenario)
        self.scenario: Scenario = with_settings(load_scenario(path), [parse_setting(text) for text in settings])
        self._folder = folder
        self._ends = free_endpoints()
        self._command = [str(path), "--journal", str(folder), "--moon", self._ends.moon, "--earth", self._ends.earth]
        for text in settings:
            self._command += ["--set", text]
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._logs: dict[str, Path] = {}
        self._starts = 0
        self._client: Client | None = None
        self.over = False

    def __enter__(self) -> Self:
        try:
            for name in VICTIMS:
                waits = ["--wait-for", ",".join(waited_for(VITAL))] if name == LINK.name else []
                self._start(name, waits)
            for name in VICTIMS:
                self._wait_until_ready(name)
            self._client = Client(self._ends.earth, self.scenario.name, "judge")
            self._client.subscribe(GROUND_STATUS, self._heard)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End all that runs."""
        if self._client is not None:
            self._client.close()
        for process in self._processes.values():
            process.send_signal(signal.SIGTERM)
        for process in self._processes.values():
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def restart(self, name: str) -> float:
        """Kill that process as a power failure would, and start it again; how long it took to take part [s]."""
        process = self._processes[name]
        if process.poll() is not None:
            raise He3Error(f"{name}: expected it to run, it ended with {process.returncode}:\n{self._said(name)}")
        process.kill()
        process.wait()
        began = time.monotonic()
        self._start(name)
        self._wait_until_ready(name)
        return time.monotonic() - began

    def ask(self, topic: Topic, request: Wire, timeout_s: float = READY_WITHIN_S) -> Any:
        """The answer to an operator's question."""
        assert self._client is not None, "the mission was entered"
        return self._client.query(topic, request, timeout_s)

    def wait_until_over(self, within_s: float) -> None:
        """Return when the ground says that the mission is over; raises He3Error if it does not."""
        end = time.monotonic() + within_s
        while not self.over:
            if time.monotonic() > end:
                said = "\n".join(self._said(name) for name in VICTIMS)
                raise He3Error(f"the mission is not over within {within_s:g} s:\n{said}")
            for name, process in self._processes.items():
                if process.poll() is not None:
                    raise He3Error(f"{name} ended with {process.returncode}:\n{self._said(name)}")
            time.sleep(POLL_S * 10)

    def judged(self) -> tuple[int, int, int]:
        """How many samples were lost, how many doubled, and whether the map is another one after a restart."""
        track: MissionTrack = self.ask(TRACK, NoParameters())
        before = self._layers()
        self.restart("ground")
        after = self._layers()
        taken = Counter(sample.sample_id for sample in track.samples)
        reported = self._reported()
        lost = max(self.scenario.samples - len(taken), 0) + len(reported.keys() - taken.keys())
        doubled = sum(count > 1 for count in taken.values()) + sum(len(told) > 1 for told in reported.values())
        return lost, doubled, int(before != after)

    def _layers(self) -> list[str]:
        end = time.monotonic() + READY_WITHIN_S
        while True:
            try:
                return [
                    self.ask(MAP_LAYER, MapLayerQuery(layer=layer)).data_base64
                    for layer in (MapLayer.MEAN, MapLayer.STD)
                ]
            except He3Error:  # whoever answers has not the map yet
                if time.monotonic() > end:
                    raise
                time.sleep(0.1)

    def _reported(self) -> dict[str, set[tuple[int, int]]]:
        """Samples that came down, each with the numbers of the messages that told of it."""
        identity = {**identity_of(self.scenario), "node": "ground"}
        reported: dict[str, set[tuple[int, int]]] = {}
        for path in sorted(self._folder.glob("ground-*.mcap")):
            with path.open("rb") as stream:
                for record in JournalReader(stream, identity, str(path)):
                    if record.channel == f"message/{SAMPLE.name}":
                        header, body = decode(SAMPLE, record.data, self.scenario.name)
                        told = (header.incarnation, header.sequence)
                        reported.setdefault(body.sample_id, set()).add(told)
        return reported

    def _heard(self, _header: Any, status: Any) -> None:
        self.over = self.over or status.phase in (MissionPhase.COMPLETED, MissionPhase.FAILED)

    def _start(self, name: str, flags: Sequence[str] = ()) -> None:
        self._starts += 1
        log = self._folder / f"{name}-{self._starts}.log"
        with log.open("wb") as stream:
            self._processes[name] = subprocess.Popen(
                python_command(f"services.{name}", *self._command, *flags),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
                env=child_environment(),
            )
        self._logs[name] = log

    def _said(self, name: str) -> str:
        return f"--- {name}\n" + self._logs[name].read_text(errors="replace")[-3000:]

    def _wait_until_ready(self, name: str) -> None:
        end = time.monotonic() + READY_WITHIN_S
        while b" ready" not in self._logs[name].read_bytes():
            if self._processes[name].poll() is not None or time.monotonic() > end:
                raise He3Error(f"{name}: not ready within {READY_WITHIN_S:g} s:\n{self._said(name)}")
            time.sleep(POLL_S)


if __name__ == "__main__":
    run()

"""A mission in real processes with journals, for fault tests; at the end it counts lost and doubled samples.

Used by the benchmarks that kill, stop and starve processes. An optional recorder only subscribes.
"""

from __future__ import annotations

import signal
import subprocess
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from he3.errors import He3Error
from schemas.codec import decode
from schemas.commands import NoParameters
from schemas.ground import MissionPhase, MissionTrack
from schemas.maps import MapLayer, MapLayerQuery
from schemas.topics import GROUND_STATUS, MAP_LAYER, SAMPLE, TRACK, Topic
from schemas.wire import Wire
from services.console.launch.endpoints import free_endpoints
from services.mission.deployment import find_scenario
from services.mission.processes import LINK, VITAL, waited_for
from services.mission.scenario import Scenario, load_scenario
from services.runtime.child import child_environment, python_command
from services.runtime.journal import JournalReader, identity_of
from services.runtime.options import parse_setting, with_settings
from services.runtime.transport.client import Client

SERVICES = ("rover", "ground", "link", "field")
"""The processes that a mission needs."""
RECORDER = "recorder"
READY_WITHIN_S = 600.0
"""Time limit [s] that only a hanging process reaches."""
POLL_S = 0.005


class JournalledMission:
    """Four processes with journals in a folder, and a recorder on request; they end with the `with` statement.

    environment: more environment variables for each process.
    """

    def __init__(
        self,
        folder: Path,
        settings: Sequence[str],
        scenario: str = "short",
        *,
        recorder: bool = False,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        path = find_scenario(scenario)
        self.scenario: Scenario = with_settings(load_scenario(path), [parse_setting(text) for text in settings])
        self._folder = folder
        self._environment = dict(environment or {})
        self.names = (*SERVICES, RECORDER) if recorder else SERVICES
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
            for name in self.names:
                waits = ["--wait-for", ",".join(waited_for(VITAL))] if name == LINK.name else []
                self._start(name, waits)
            for name in self.names:
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
        """End all processes."""
        if self._client is not None:
            self._client.close()
        for process in self._processes.values():
            process.send_signal(signal.SIGCONT)
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

    def process(self, name: str) -> subprocess.Popen[bytes]:
        """The process that runs under that name now."""
        return self._processes[name]

    def start_again(self, name: str) -> None:
        """Start a process that has ended."""
        self._start(name)
        self._wait_until_ready(name)

    def last_words(self, name: str) -> str:
        """The last line that the present start of the process wrote."""
        lines = self._logs[name].read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""

    @property
    def recording(self) -> Path:
        """Where the recorder writes."""
        return self._folder / "mission.mcap"

    def ask(self, topic: Topic, request: Wire, timeout_s: float = READY_WITHIN_S) -> Any:
        """The answer to an operator's question."""
        assert self._client is not None, "the mission was entered"
        return self._client.query(topic, request, timeout_s)

    def wait_until_over(self, within_s: float) -> None:
        """Return when the ground says that the mission is over; raises He3Error if it does not."""
        end = time.monotonic() + within_s
        while not self.over:
            if time.monotonic() > end:
                said = "\n".join(self._said(name) for name in self.names)
                raise He3Error(f"the mission is not over within {within_s:g} s:\n{said}")
            for name, process in self._processes.items():
                if process.poll() is not None:
                    raise He3Error(f"{name} ended with {process.returncode}:\n{self._said(name)}")
            time.sleep(POLL_S * 10)

    def judged(self) -> tuple[int, int, int]:
        """Lost samples, doubled samples, and 1 if a restart of the ground changed the map, else 0."""
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
            except He3Error:  # the query process has no map yet
                if time.monotonic() > end:
                    raise
                time.sleep(0.1)

    def _reported(self) -> dict[str, set[tuple[int, int]]]:
        """The samples that arrived, each with the sequences of the messages that reported it."""
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
        log = self._folder / f"{name}-{self._starts:03d}.log"
        own = ("--out", str(self.recording)) if name == RECORDER else ()
        with log.open("wb") as stream:
            self._processes[name] = subprocess.Popen(
                python_command(f"services.{name}", *self._command, *flags, *own),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
                env={**child_environment(), **self._environment},
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

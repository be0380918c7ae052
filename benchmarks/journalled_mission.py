"""A mission in real processes with journals, for fault tests; at the end it counts lost and doubled samples.

Used by the benchmarks that kill, stop and starve processes. An optional recorder only subscribes.
"""

from __future__ import annotations

import signal
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from io import BufferedReader
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
from services.recorder.reader import Recording
from services.runtime.child import child_environment, python_command
from services.runtime.journal import JournalReader, identity_of
from services.runtime.options import parse_setting, with_settings
from services.runtime.transport.client import Client

SERVICES = ("rover", "ground", "link", "field")
"""The processes that a mission needs."""
RECORDER = "recorder"
STREAMS_END_WITHIN_S = 5.0
READY_WITHIN_S = 600.0
"""Time limit [s] that only a hanging process reaches."""
POLL_S = 0.005


class _Log:
    """What one start of a process writes on its standard streams."""

    def __init__(self, name: str, process: subprocess.Popen[bytes]) -> None:
        self.name = name
        self._said = bytearray()
        self._reader = threading.Thread(target=self._read, args=(process.stdout,), name=f"log of {name}", daemon=True)
        self._reader.start()

    def text(self) -> str:
        """Everything so far."""
        return bytes(self._said).decode(errors="replace")

    def complete(self) -> None:
        """Wait for the end of the streams, after the end of the process; a child that holds them open is left."""
        self._reader.join(STREAMS_END_WITHIN_S)

    def _read(self, stream: BufferedReader) -> None:
        with stream:
            while part := stream.read1():
                self._said += part


def judged_samples(planned: int, taken: Sequence[str], reported: Mapping[str, Set[tuple[int, int]]]) -> tuple[int, int]:
    """How many samples were lost, and how many doubled.

    planned: how many there should be. taken: ids of those in the map. reported: ids of those that came down, each with
    the numbers of the messages that told of it.
    """
    counts = Counter(taken)
    lost = max(planned - len(counts), 0) + len(reported.keys() - counts.keys())
    doubled = sum(count > 1 for count in counts.values()) + sum(len(told) > 1 for told in reported.values())
    return lost, doubled


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
        self._logs: list[_Log] = []
        # As a supervisor would, every start of a process has the same flags.
        self._flags = {LINK.name: ("--wait-for", ",".join(waited_for(VITAL)))}
        self._client: Client | None = None
        self.over = False

    def __enter__(self) -> Self:
        try:
            for name in self.names:
                self._start(name)
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
            raise He3Error(f"{name}: expected it to run, it ended with {process.returncode}:\n{self.said(name)}")
        process.kill()
        process.wait()
        began = time.monotonic()
        self._start(name)
        self._wait_until_ready(name)
        return time.monotonic() - began

    def end(self, name: str) -> tuple[int, str]:
        """Tell that process to end; its exit code and the last line that it wrote."""
        process = self._processes[name]
        process.terminate()
        try:
            code = process.wait(READY_WITHIN_S)
        except subprocess.TimeoutExpired:
            raise He3Error(f"{name}: has not ended within {READY_WITHIN_S:g} s:\n{self.said(name)}") from None
        return code, self.last_words(name)

    def process(self, name: str) -> subprocess.Popen[bytes]:
        """The process that runs under that name now."""
        return self._processes[name]

    def start_again(self, name: str) -> None:
        """Start a process that has ended."""
        self._start(name)
        self._wait_until_ready(name)

    def last_words(self, name: str) -> str:
        """The last line that the present start of the process wrote."""
        log = self._log(name)
        log.complete()
        lines = log.text().strip().splitlines()
        return lines[-1] if lines else ""

    def said(self, name: str) -> str:
        """The end of what this start of the process wrote."""
        return f"--- {name}\n" + self._log(name).text()[-3000:]

    @property
    def logs(self) -> list[tuple[str, str]]:
        """What each start of each process wrote, with the name of the process."""
        return [(log.name, log.text()) for log in self._logs]

    @property
    def earth(self) -> str:
        """Endpoint of the Earth router."""
        return self._ends.earth

    @property
    def recording(self) -> Path:
        """Where the recorder writes."""
        return self._folder / "mission.mcap"

    def written_bytes(self, name: str) -> int | None:
        """Length of the file that this start of the process appends to; None if it appends to none."""
        if name == RECORDER:
            return self.recording.stat().st_size
        files = sorted(self._folder.glob(f"{name}-[0-9]*.mcap"))
        return files[-1].stat().st_size if files else None

    def ask(self, topic: Topic, request: Wire, timeout_s: float = READY_WITHIN_S) -> Any:
        """The answer to an operator's question."""
        assert self._client is not None, "the mission was entered"
        return self._client.query(topic, request, timeout_s)

    def wait_until_over(self, within_s: float) -> None:
        """Return when the ground says that the mission is over; raises He3Error if it does not."""
        end = time.monotonic() + within_s
        while not self.over:
            if time.monotonic() > end:
                said = "\n".join(self.said(name) for name in self.names)
                raise He3Error(f"the mission is not over within {within_s:g} s:\n{said}")
            for name, process in self._processes.items():
                if process.poll() is not None:
                    raise He3Error(f"{name} ended with {process.returncode}:\n{self.said(name)}")
            time.sleep(POLL_S * 10)

    def judged(self) -> tuple[int, int, int]:
        """Lost samples, doubled samples, and 1 if a restart of the ground changed the map, else 0."""
        lost, doubled = judged_samples(self.scenario.samples, self.samples_in_the_map(), self.samples_reported())
        return lost, doubled, int(not self.map_survives_a_restart())

    def samples_in_the_map(self) -> list[str]:
        """Ids of the samples that the ground has taken in, each as often as it has."""
        track: MissionTrack = self.ask(TRACK, NoParameters())
        return [sample.sample_id for sample in track.samples]

    def map_survives_a_restart(self) -> bool:
        """Whether the map is the same to the byte after the ground was killed and started again."""
        before = self._layers()
        self.restart("ground")
        return before == self._layers()

    def samples_recorded(self) -> tuple[set[str], list[str]]:
        """Ids of the samples in all recordings, and one line on each part of the last recording that is not whole."""
        recorded: set[str] = set()
        problems: list[str] = []
        for path in sorted(self._folder.glob("mission*.mcap")):
            recording = Recording(path)
            recorded.update(each.body.sample_id for each in recording.messages() if each.topic is SAMPLE)
            if path == self.recording:
                problems = recording.problems()
        return recorded, problems

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

    def samples_reported(self) -> dict[str, set[tuple[int, int]]]:
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

    def _start(self, name: str) -> None:
        own = ("--out", str(self.recording)) if name == RECORDER else ()
        # A pipe takes what the process says also when its files can take no more.
        process = subprocess.Popen(
            python_command(f"services.{name}", *self._command, *self._flags.get(name, ()), *own),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**child_environment(), **self._environment},
        )
        self._processes[name] = process
        self._logs.append(_Log(name, process))

    def _log(self, name: str) -> _Log:
        return next(log for log in reversed(self._logs) if log.name == name)

    def _wait_until_ready(self, name: str) -> None:
        end = time.monotonic() + READY_WITHIN_S
        while " ready" not in self._log(name).text():
            if self._processes[name].poll() is not None or time.monotonic() > end:
                raise He3Error(f"{name}: not ready within {READY_WITHIN_S:g} s:\n{self.said(name)}")
            time.sleep(POLL_S)

"""The launcher: starts a mission's services as processes, watches them, and ends them all in every case."""

from __future__ import annotations

import os
import re
import subprocess
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from he3.errors import He3Error, InvalidInput
from schemas.wire import printable
from services.console.interruption import end_if_told, uninterrupted
from services.console.launch.endpoints import Endpoints
from services.mission.processes import LINK, PROCESSES, RECORDER, VITAL, ProcessSpec, waited_for
from services.runtime.child import BAD_INPUT, child_environment, exit_in_words, python_command
from services.runtime.files.output import open_output

STOP_WITHIN_S = 1.5
"""Time [s] that a service has to end before it is killed."""
COMPLETE_WITHIN_S = 20.0
"""Time [s] that a service has to end if it completes a file."""


class Launcher:
    """The processes of one mission. Use it in a `with` statement: they are all gone when it ends."""

    def __init__(
        self,
        scenario: Path,
        endpoints: Endpoints,
        flags: Sequence[str] = (),
        *,
        recording: Path | None = None,
        logs: Path | None = None,
        service_flags: dict[str, Sequence[str]] | None = None,
    ) -> None:
        """logs: folder for one log file per service; None: log lines go to standard error."""
        self._scenario = scenario
        self._endpoints = endpoints
        self._flags = tuple(flags)
        self._recording = recording
        self._logs = logs
        self._service_flags = service_flags or {}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._left_behind: set[str] = set()

    @property
    def own_pid(self) -> int:
        """Id of the process that started the services."""
        return os.getpid()

    @property
    def pids(self) -> dict[str, int]:
        """Process id of each service that was started."""
        return {name: process.pid for name, process in self._processes.items()}

    def __enter__(self) -> Self:
        started = [each for each in PROCESSES if each.vital or self._recording is not None]
        names = [each.name for each in started]
        try:
            for each in started:
                self.start(each, waited_for(names) if each is LINK else ())
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def start(self, process: ProcessSpec, wait_for: Iterable[str] = ()) -> None:
        """Start one service. wait_for: for the link, which holds mission time until these processes take part."""
        name = process.name
        command = python_command(process.module, str(self._scenario), *self._flags)
        command += ["--moon", self._endpoints.moon, "--earth", self._endpoints.earth]
        if wait_for:
            command += ["--wait-for", ",".join(wait_for)]
        if process is RECORDER and self._recording is not None:
            command += ["--out", str(self._recording)]
        command += self._service_flags.get(name, ())
        log = None if self._logs is None else open_output(self._logs / f"{name}.log", append=True)
        try:
            # A group of its own: Ctrl-C is for this process to judge, and to pass on in order.
            self._processes[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stderr=log,
                stdout=log,
                process_group=0,
                env=child_environment(),
            )
        except OSError as error:
            raise He3Error(f"cannot start the {name} service: {error.strerror}") from None
        finally:
            if log is not None:
                log.close()

    def check(self) -> None:
        """Raise He3Error, in one line, when a service has ended by itself; InvalidInput if its input was bad."""
        end_if_told()
        for name in self._processes:
            if (how := self._ended(name)) is not None:
                raise self._error(name, how)

    def check_vital(self) -> list[str]:
        """Raise He3Error, in one line, when a service has ended without which the mission fails; InvalidInput if its
        input was bad.

        Returns a line for each other service that has ended since the last call: the mission continues without it.
        """
        end_if_told()
        lines = []
        for name in self._processes.keys() - self._left_behind:
            if (how := self._ended(name)) is None:
                continue
            if name in VITAL:
                raise self._error(name, how)
            self._left_behind.add(name)
            lines.append(f"{how}; the mission continues without it")
        return lines

    def _ended(self, name: str) -> str | None:
        """How that service ended by itself, in one line; None while it runs."""
        code = self._processes[name].poll()
        if code is None:
            return None
        return f"the {name} service ended by itself, {exit_in_words(code)}{self._last_words(name)}"

    def _error(self, name: str, how: str) -> He3Error:
        """What to raise for a service that has ended: its exit code tells bad input from a failure."""
        return (InvalidInput if self._processes[name].returncode == BAD_INPUT else He3Error)(how)

    def failure(self, name: str) -> str | None:
        """One line on why that ended service failed; None if its exit code is 0."""
        process = self._processes.get(name)
        if process is None or not process.returncode:
            return None
        said = self._last_words(name).removeprefix(f": he3 {name}: ")
        return said or f"the {name} service ended by itself, {exit_in_words(process.returncode)}"

    def tell_to_end(self) -> None:
        """Ask every service to end; does not wait."""
        for process in self._processes.values():
            if process.poll() is None:
                process.terminate()

    def stop(self) -> None:
        """End all services: by SIGTERM, and by SIGKILL those that do not end in time."""
        with uninterrupted():
            self._stop()

    def _stop(self) -> None:
        self.tell_to_end()
        began = time.monotonic()
        for name, process in sorted(self._processes.items(), key=lambda item: _stops_within_s(item[0])):
            try:
                process.wait(max(0.0, began + _stops_within_s(name) - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
        for process in self._processes.values():
            process.wait()

    def _last_words(self, name: str) -> str:
        if self._logs is None or self._processes[name].returncode < 0:
            return ""
        try:
            lines = (self._logs / f"{name}.log").read_text(errors="replace").strip().splitlines()
        except OSError:
            return ""
        telling = [line for line in lines if _TELLING.match(line)] or lines
        return f": {printable(telling[-1])}" if telling else ""


def _stops_within_s(name: str) -> float:
    completes_file = any(each.completes_file for each in PROCESSES if each.name == name)
    return COMPLETE_WITHIN_S if completes_file else STOP_WITHIN_S


_TELLING = re.compile(r"he3 \w+: |[\w.]+(Error|Exception)\b")
"""A log line with the reason why a service ended: its own last line, or the last line of a traceback."""

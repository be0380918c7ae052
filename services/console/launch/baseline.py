"""Runs the published protocol on the same seed while another mission runs, so that the two can be compared.

The baseline is a whole mission in one process (``he3 run t1-paper --in-process``), in a child at the lowest priority:
it takes the processor time that the other mission leaves. Ctrl-C reaches both at the same time, because the child stays
in this process's group. The child ends with this process, also when that is killed.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import IO, Self

from he3.errors import He3Error
from schemas.report import MissionReport
from services.console.interruption import uninterrupted
from services.runtime.child import child_environment, python_command

LOWEST_PRIORITY = 19
LOOK_EVERY_S = 0.2
END_WITHIN_S = 1.0
"""Time [s] that the child has to end before it is killed."""


class Baseline:
    """A mission in a child process. Use it in a `with` statement: the child is gone when it ends."""

    def __init__(self, scenario: str, seed: int, settings: Sequence[str] = ()) -> None:
        """settings: ``key=value`` of the scenario, as `--set` takes them."""
        self.scenario = scenario
        changes = [word for text in settings for word in ("--set", text)]
        options = ("--in-process", "--json", "--seed", str(seed), *changes)
        self._command = python_command("services.console", "run", scenario, *options)

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            self._said = opened.enter_context(tempfile.TemporaryFile())
            self._progress = opened.enter_context(tempfile.TemporaryFile())
            try:
                self._process = subprocess.Popen(
                    self._command,
                    stdin=subprocess.DEVNULL,
                    stdout=self._said,
                    stderr=self._progress,
                    env=child_environment(),
                )
                os.setpriority(os.PRIO_PROCESS, self._process.pid, LOWEST_PRIORITY)
            except OSError as error:
                raise He3Error(f"cannot start the mission {self.scenario}: {error.strerror}") from None
            self._files = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with uninterrupted():
            self._process.terminate()
            try:
                self._process.wait(END_WITHIN_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._files.close()

    def report(self, show: Callable[[str], None]) -> MissionReport:
        """The report of the mission, once it has ended; `show` is called with each line of progress.

        Raises He3Error, with the child's own last line, when the mission fails.
        """
        shown = ""
        while self._process.poll() is None:
            if (line := self._last_line(self._progress)) != shown:
                show(line)
                shown = line
            try:
                self._process.wait(LOOK_EVERY_S)
            except subprocess.TimeoutExpired:
                continue
        if self._process.returncode != 0:
            raise He3Error(f"the mission {self.scenario} failed: {self._last_line(self._progress)}")
        self._said.seek(0)
        return MissionReport.model_validate_json(self._said.read())

    @staticmethod
    def _last_line(file: IO[bytes]) -> str:
        # Read by position: the child writes at the position that both share.
        size = os.fstat(file.fileno()).st_size
        tail = os.pread(file.fileno(), 4096, max(0, size - 4096)).decode("utf-8", "replace")
        return tail.rstrip().rpartition("\n")[2]

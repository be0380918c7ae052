"""The owner's end of a query process: a service's process gives each snapshot to a process that answers queries.

Only the newest snapshot waits. A query process that dies is started again and given the newest.
`services.runtime.queries.pipe` has the protocol, `services.runtime.queries.pipe_server` the query process.
"""

from __future__ import annotations

import contextlib
import subprocess
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, BinaryIO, cast

from he3.errors import He3Error
from services.runtime.child import child_environment, exit_in_words, python_command
from services.runtime.queries.pipe import ALIVE_EVERY_S, READY, write_snapshot

if TYPE_CHECKING:
    from pathlib import Path

    from schemas.topics import Side

SILENT_AFTER_S = 30 * ALIVE_EVERY_S
"""A query process that has sent no sign of life for this long hangs: it is not waited for until it sends one."""
REPORT_AFTER_S = 5.0
"""Waiting for a query process is reported after this time."""
START_AGAIN_S = 1.0
CLOSE_WITHIN_S = 0.3
"""Time [s] that a query process has to end by itself; then it is killed, which loses no data."""
KILLED_WITHIN_S = 5.0
"""Time [s] that the system may take to end a killed process; then its end is no longer waited for."""


class QueryProcess:
    """A query process and its owner's end. `show` may be called from any thread and returns at once."""

    def __init__(
        self,
        module: str,
        side: Side,
        endpoint: str,
        mission: str,
        warn: Callable[[str], None],
        identity: Path | None = None,
    ) -> None:
        """warn: called with a line for the log. identity: folder of the owner's identity, which it shares."""
        self._module = module
        self._command = python_command(module, side.value, endpoint, mission)
        if identity is not None:
            self._command.append(str(identity))
        self._warn = warn
        self._changed = threading.Condition()
        self._newest: tuple[int, Any] = (0, None)
        self._answered_from = 0
        self._begun = False
        self._ready = False
        self._died_early: str | None = None
        self._heard_at_s = time.monotonic()
        self._hangs = False
        self._closed = False
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._work, name="query-process", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int | None:
        """Process id of the query process; None before the first was started."""
        return None if self._process is None else self._process.pid

    def begin(self) -> None:
        """Let it connect and answer queries; before, its owner may not be the one that is to answer them."""
        with self._changed:
            self._begun = True
            self._changed.notify_all()

    def show(self, snapshot: object) -> None:
        """Have queries answered from that snapshot from now on."""
        with self._changed:
            self._newest = (self._newest[0] + 1, snapshot)
            self._changed.notify_all()

    def settle(self) -> bool:
        """Wait until queries are answered from the last snapshot shown; False if the query process hangs or was closed.

        A query process that dies meanwhile is replaced, and waited for.
        """
        return self._wait(lambda: self._answered_from >= self._newest[0], "to take a snapshot in")

    def wait_until_ready(self, stop: threading.Event) -> None:
        """Return when queries are answered, or when `stop` is set.

        Waits as long as the query process lives; raises He3Error if it ends before it was ever ready.
        """
        self._wait(lambda: self._ready or stop.is_set() or self._died_early is not None, "to be ready", hanging=True)
        if not self._ready and not stop.is_set() and self._died_early is not None:
            raise He3Error(f"the query process {self._module} {self._died_early} before it was ready")

    def _wait(self, over: Callable[[], bool], what: str, hanging: bool = False) -> bool:
        """Wait until it is over or this end is closed; unless `hanging`, until the query process is silent as well."""
        began = time.monotonic()
        reported = False
        with self._changed:
            while not over() and not self._closed:
                now = time.monotonic()
                silent_s = now - self._heard_at_s
                if not reported and now - began > REPORT_AFTER_S:
                    reported = True
                    self._warn(f"waiting for the query process (pid {self.pid}) {what}")
                if not hanging and silent_s > SILENT_AFTER_S:
                    if not self._hangs:
                        self._hangs = True
                        self._warn(
                            f"the query process (pid {self.pid}) has been silent for {silent_s:.0f} s; not waiting"
                        )
                    return False
                self._changed.wait(0.05)
            return over()

    def close(self) -> None:
        """End the query process."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(CLOSE_WITHIN_S)
        process = self._process
        if self._thread.is_alive() and process is not None:
            process.kill()  # it is still starting, and does not read its pipe
            self._thread.join(KILLED_WITHIN_S)

    # --- in a thread of its own ---------------------------------------------------------------------------------

    def _work(self) -> None:
        while not self._closed:
            process = self._start()
            try:
                self._write_snapshots(process)
            except OSError:
                self._end(process)
                self._note_death(process.returncode)
            finally:
                self._end(process)

    def _note_death(self, code: int) -> None:
        how = f"ended by itself, {exit_in_words(code)},"
        with self._changed:
            if self._closed:
                return
            if not self._ready:
                self._died_early = how
            self._changed.notify_all()
        self._warn(f"the query process {how} and is started again")
        time.sleep(START_AGAIN_S)

    def _start(self) -> subprocess.Popen[bytes]:
        # Not of the owner's group: Ctrl-C is for the owner to judge.
        process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            process_group=0,
            env=child_environment(),
        )
        self._process = process
        self._heard_at_s = time.monotonic()
        lines = cast(BinaryIO, process.stdout)
        threading.Thread(target=self._read_lines, args=(lines,), name="query-process-lines", daemon=True).start()
        return process

    def _read_lines(self, lines: BinaryIO) -> None:
        with lines:
            while line := lines.readline():
                with self._changed:
                    self._heard_at_s = time.monotonic()
                    self._hangs = False
                    if line == READY:
                        self._ready = True
                    elif line.strip().isdigit():
                        self._answered_from = int(line)
                    self._changed.notify_all()

    def _write_snapshots(self, process: subprocess.Popen[bytes]) -> None:
        """Write each new snapshot, until this end is closed; raises OSError when the query process is gone."""
        written = -1
        while True:
            with self._changed:
                while not (self._newest[0] > max(0, written) or (self._begun and written < 0) or self._closed):
                    # A query process that is gone is noticed even when there is nothing to write.
                    self._changed.wait(START_AGAIN_S)
                    if process.poll() is not None:
                        raise BrokenPipeError
                if self._closed:
                    return
                written, snapshot = self._newest
            write_snapshot(cast(BinaryIO, process.stdin), written, snapshot)

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        with contextlib.suppress(OSError):
            if process.stdin is not None:
                process.stdin.close()
        try:
            process.wait(CLOSE_WITHIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

"""Processes that a benchmark starts, and that end with it."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from contextlib import ExitStack, suppress
from typing import Any

from he3.errors import He3Error
from services.runtime.child import ROOT, child_environment, python_command

SETTLING_S = 300.0
"""Time limit [s] for a process to start, and to answer after its task; only a hanging process reaches it."""


class Peer:
    """A module run as a process. It reads lines and answers each with a line of JSON. The stack `ends` ends it."""

    def __init__(self, ends: ExitStack, module: str, *arguments: str) -> None:
        self._module = module
        self._process = subprocess.Popen(
            python_command(module, *arguments),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            process_group=0,
            env={**child_environment(), "PYTHONPATH": ROOT},
        )
        ends.callback(self._end)

    def check(self) -> None:
        """Raise He3Error when it has ended by itself."""
        code = self._process.poll()
        if code is not None:
            raise He3Error(f"{self._module}: ended by itself with exit code {code}")

    def tell(self, line: str) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise He3Error(f"{self._module}: ended before it received its task") from None

    def answer(self, within_s: float = 0.0) -> Any:
        """The process's answer; raises He3Error if none arrives within `within_s` plus `SETTLING_S`."""
        assert self._process.stdout is not None
        longest_s = within_s + SETTLING_S
        giving_up = threading.Timer(longest_s, self._process.kill)
        giving_up.start()
        try:
            line = self._process.stdout.readline()
        finally:
            giving_up.cancel()
        if not line:
            raise He3Error(f"{self._module}: no answer within {longest_s:g} s")
        return json.loads(line)

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):  # what it was told last, if it ended before it could be
                    stream.close()


def answer_line(answer: object) -> None:
    """Write the answer of this process, which is a peer."""
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()

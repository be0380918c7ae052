"""Processes that tests start: each computes with one BLAS thread and ends with the test run, however that ends."""

from __future__ import annotations

import io
import os
import subprocess
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from unittest.mock import patch

from services.console.__main__ import main
from services.runtime.child import ROOT, child_environment, python_command


def start(command: Sequence[str | Path], *, env: dict[str, str] | None = None, **options: Any) -> subprocess.Popen[Any]:
    """The process of that command; options as for `subprocess.Popen`, `env` added to what every child has.

    It leads a process group of its own. So the kernel ends it even while it is stopped by SIGSTOP.
    """
    return subprocess.Popen(command, process_group=0, **_with_defaults(env, options))


def run(
    command: Sequence[str | Path], *, env: dict[str, str] | None = None, **options: Any
) -> subprocess.CompletedProcess[str]:
    """The output and exit code of that command, once it has ended; options as for `subprocess.run`."""
    captured = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.run(command, check=False, **_with_defaults(env, captured | options))


def he3(*words: str) -> list[str]:
    """The command ``he3`` with those arguments."""
    return python_command("services.console", *words)


def he3_here(*words: str, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Output and exit code of ``he3`` with those arguments, run in this process to save time."""
    out, err = io.StringIO(), io.StringIO()
    with patch.dict(os.environ, env or {}), redirect_stdout(out), redirect_stderr(err):
        code = main(words)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())


def _with_defaults(env: dict[str, str] | None, options: dict[str, Any]) -> dict[str, Any]:
    return {"stdin": subprocess.DEVNULL, "cwd": ROOT, "env": {**child_environment(), **(env or {})}, **options}

"""Starts one of our processes from another: this is the parent's end, `services.runtime.entry` the child's.

A child never imports from the working directory, computes with one BLAS thread unless the user asked for more, and
ends with its parent.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

from services.runtime.entry import PARENT

ROOT = str(Path(__file__).resolve().parents[2])
"""The folder that our packages lie in: a checkout, or site-packages."""


def python_command(module: str, *arguments: str) -> list[str]:
    """The command that runs that module as a program, in this interpreter."""
    return [sys.executable, "-P", "-m", module, *arguments]


def child_environment() -> dict[str, str]:
    """The environment of a child of this process."""
    environment = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **os.environ, PARENT: str(os.getpid())}
    # An empty entry of the path would be the working directory, which any user may have written.
    given = [entry for entry in environment.pop("PYTHONPATH", "").split(os.pathsep) if Path(entry).is_absolute()]
    if ROOT not in sys.path[1:]:
        # Our code was found in the working directory, in a checkout that is not installed: a child does not look there.
        given.insert(0, ROOT)
    if given:
        environment["PYTHONPATH"] = os.pathsep.join(given)
    return environment


BAD_INPUT = 2
"""Exit code of a process whose input was bad: the same command meets it again."""


def exit_in_words(code: int) -> str:
    """How a child ended, from its return code: 'exit code 2', 'killed by SIGKILL'."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"killed by signal {-code}"

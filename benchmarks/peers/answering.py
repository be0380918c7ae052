"""One JSON document in, one out: how every script of this folder is asked and answers."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
from collections.abc import Callable
from typing import Any


def answer(function: Callable[[dict], Any]) -> None:
    """Write what the function makes of the request on standard input to standard output."""
    _end_with_parent()
    request = json.load(sys.stdin)
    # What the libraries print must not get into the answer.
    answer_to = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    json.dump(function(request), answer_to)
    answer_to.close()


def _end_with_parent() -> None:
    """Let the kernel end this process when the benchmark that asks is killed; its answer may take minutes."""
    if sys.platform == "linux":
        set_parent_death_signal = 1  # prctl(2)
        ctypes.CDLL(None).prctl(set_parent_death_signal, int(signal.SIGKILL))

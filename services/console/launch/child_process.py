"""What every child of the console's process needs: an end with its parent, and one thread of linear algebra."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable
from functools import partial

_PR_SET_PDEATHSIG = 1  # Linux, prctl(2)


def _ending_with_parent() -> Callable[[], object] | None:
    if sys.platform != "linux":
        return None
    prctl = ctypes.CDLL(None, use_errno=True).prctl
    return partial(prctl, _PR_SET_PDEATHSIG, int(signal.SIGTERM))


END_WITH_PARENT = _ending_with_parent()
"""Called in a child, makes the kernel end it when its parent is killed; None elsewhere than on Linux."""


def environment() -> dict[str, str]:
    """The environment of a child. Several processes share the machine: more threads in each would cost time."""
    return {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **os.environ}

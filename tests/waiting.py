"""Waiting in tests: for an event, for a long time; for a promised duration, with a margin for a shared machine."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import TypeVar

import pytest

T = TypeVar("T")

PATIENCE_S = 600.0
"""How long an event is waited for [s]. A machine of any speed is faster, so only a test that fails takes so long."""
POLL_S = 0.02

SHARED = 4.0
"""How many times longer than promised anything may take on a machine that seems quiet: its load changes within seconds,
and is measured only after the event. Promises themselves are measured in `benchmarks/`, on a quiet machine."""

_COUNT, _QUIET_S = 5_000_000, 0.25
"""So many squares take so long [s] on a core of its own of the machine on which the promises were made."""
_COMPUTES = "print(flush=True)\nwhile True: pass"


def until(seen: Callable[[], T], what: str | Callable[[], str], patience_s: float = PATIENCE_S) -> T:
    """What `seen` returns, once it is true; fails the test, naming `what` was waited for, if it does not get true."""
    give_up = time.monotonic() + patience_s
    while not (found := seen()):
        if time.monotonic() > give_up:
            pytest.fail(f"waited {patience_s:g} s for {what if isinstance(what, str) else what()}")
        time.sleep(POLL_S)
    return found


def slowness(clock: Callable[[], float] = time.perf_counter, processes: int = 1) -> float:
    """How many times slower than a quiet machine this one is now, by that clock [s]; 1 at least.

    processes: that compute at the same time, each on a core of its own on the quiet machine, which has two. By wall
    time, what the machine does beside this test counts, too. By `time.process_time` only its speed does.
    """
    with ExitStack() as others:
        for _ in range(processes - 1):
            other = subprocess.Popen([sys.executable, "-c", _COMPUTES], stdout=subprocess.PIPE)
            others.enter_context(other)
            others.callback(other.kill)
            assert other.stdout is not None
            other.stdout.readline()
        began = clock()
        sum(number * number for number in range(_COUNT))
        return max(1.0, (clock() - began) / _QUIET_S)


def expect_within(
    promised_s: float,
    took_s: float,
    what: str,
    clock: Callable[[], float] = time.perf_counter,
    processes: int = 1,
) -> None:
    """Fail the test unless `what` took at most `SHARED` times as long as promised, or times the slowness if it is more.

    processes: at work in it at the same time, up to the two cores for which the promise is made.
    """
    if took_s > SHARED * promised_s:
        factor = max(SHARED, slowness(clock, processes))
        assert took_s <= promised_s * factor, (
            f"{what}: took {took_s:.2f} s, promised are {promised_s:g} s, and on this machine, as it is now, at most "
            f"{factor:.1f} times as much is accepted"
        )

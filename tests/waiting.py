"""Waiting in tests: for an event, for a long time; for a promised duration, with a margin for a shared machine."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")

PATIENCE_S = 600.0
"""How long an event is waited for [s]. A machine of any speed is faster, so only a test that fails takes so long."""
POLL_S = 0.02

SHARED = 4.0
"""How many times longer than promised anything may take while the machine kept processes waiting. Its load changes
within seconds; its speed is measured only after the event."""

_COUNT, _QUIET_S = 5_000_000, 0.25
"""So many squares take so long [s] on a core of its own of the machine on which the promises were made."""
_READ_EVERY_S = 0.1
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


class Stalls:
    """For how long processes of this machine had to wait for a processor or a disk, over the last ten minutes."""

    def __init__(self, stalled_s: Callable[[], float], clock: Callable[[], float] = time.monotonic) -> None:
        """stalled_s: seconds of waiting so far; infinite where the machine does not tell."""
        self._stalled_s, self._clock = stalled_s, clock
        self._readings: deque[tuple[float, float]] = deque(maxlen=round(PATIENCE_S / _READ_EVERY_S))
        self.read()

    def read(self) -> None:
        self._readings.append((self._clock(), self._stalled_s()))

    def follow(self) -> None:
        """Read from now on, on a thread that ends with the process."""

        def reading() -> None:
            while True:
                time.sleep(_READ_EVERY_S)
                self.read()

        threading.Thread(target=reading, name="stalls", daemon=True).start()

    def within(self, last_s: float) -> float:
        """Seconds of waiting during the last so many seconds, or since the first reading; infinite if not known."""
        began, so_far = self._clock() - last_s, self._stalled_s()
        before = [stalled for at, stalled in list(self._readings) if at <= began] or [self._readings[0][1]]
        return math.inf if math.isinf(so_far) else so_far - before[-1]


def stalled_s() -> float:
    """Seconds during which a process waited for a processor or a disk, or a hypervisor took a processor (Linux: PSI).

    Infinite on systems that do not tell.
    """
    try:
        pressure = "".join(Path("/proc/pressure", name).read_text() for name in ("cpu", "io"))
        stolen = int(Path("/proc/stat").read_text().split(None, 9)[8]) / os.sysconf("SC_CLK_TCK")
    except OSError:
        return math.inf
    return sum(map(int, re.findall(r"^some .*total=(\d+)", pressure, re.MULTILINE))) / 1e6 + stolen


STALLS = Stalls(stalled_s)
STALLS.follow()


def expect_within(
    promised_s: float,
    took_s: float,
    what: str,
    clock: Callable[[], float] = time.perf_counter,
    processes: int = 1,
    stalls: Stalls = STALLS,
) -> None:
    """Fail the test unless `what`, which ended just now, took no longer than promised times the machine's slowness.

    It may take `SHARED` times as long by wall time if what is too much is no more than processes had to wait meanwhile.
    processes: at work in it at the same time, up to the two cores for which the promise is made.
    """
    if took_s > promised_s:
        factor = slowness(clock, processes)
        stalled = stalls.within(took_s) if clock is time.perf_counter else 0.0
        most_s = promised_s * factor
        assert took_s <= most_s or (took_s - stalled <= promised_s and took_s <= SHARED * most_s), (
            f"{what}: took {took_s:.2f} s, expected at most {promised_s:g} s, on a machine that is now {factor:.1f} "
            f"times slower than a quiet one, and on which processes waited for {stalled:.2f} s meanwhile"
        )

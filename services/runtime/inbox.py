"""The inbox of a process's main loop: calls from other threads, and whether the process was told to stop."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Final

DRAINS_FOR_S: Final = 0.2
"""Longest time [s of wall time] that a main loop takes in what waits, before it does its other work."""

TakeIn = Callable[[], None]
"""Called in the main loop, which alone touches the node."""


class Inbox:
    """A queue of calls for the main loop. `put` and `stop` may be called from any thread and from signal handlers."""

    def __init__(self) -> None:
        self.stopped = threading.Event()
        self._waiting: queue.SimpleQueue[TakeIn] = queue.SimpleQueue()

    def put(self, take_in: TakeIn) -> None:
        """Queue a function for the main loop to call."""
        self._waiting.put(take_in)

    def wake(self, *_: Any) -> None:
        """Wake the main loop so that it checks for work."""
        self._waiting.put(_nothing)

    def stop(self, *_: Any) -> None:
        """Tell the process to stop; may be used as a signal handler."""
        self.stopped.set()
        self.wake()

    def next(self, timeout_s: float = 0.0) -> TakeIn | None:
        """The next call that waits or arrives within the timeout; None if there is none."""
        try:
            return self._waiting.get(timeout=timeout_s) if timeout_s > 0 else self._waiting.get_nowait()
        except queue.Empty:
            return None

    def take(self, timeout_s: float = 0.0) -> bool:
        """Run the next call that waits or arrives within the timeout; returns whether there was one."""
        take_in = self.next(timeout_s)
        if take_in is None:
            return False
        take_in()
        return True

    def take_all(self) -> None:
        """Run the calls that wait, for `DRAINS_FOR_S` at most: a flood must not keep the loop from its heartbeat."""
        until_s = time.monotonic() + DRAINS_FOR_S
        while time.monotonic() < until_s and self.take():
            pass


def _nothing() -> None:
    """Do nothing; the call only wakes the loop."""

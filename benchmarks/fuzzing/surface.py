"""The interface of a surface, the check of one example, and the detection of a hang."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from random import Random
from typing import Protocol

HANG_S = 120.0
"""An example that takes longer hangs: the slowest ones take a second on a quiet machine."""


class Hang(BaseException):
    """Raised inside an example that takes too long. Not an Exception, so that no handler takes it for bad input."""


class Surface(Protocol):
    """One entry for input from outside."""

    name: str

    def example(self, rng: Random) -> tuple[str, str | None]:
        """Feed one random input to the real code: its description, and a line on its fault, None if there was none."""

    def close(self) -> None:
        """End the processes that the surface has started."""


@contextmanager
def noticing_a_hang(seconds: float = HANG_S) -> Iterator[None]:
    """Raise `Hang` inside the block after that time; works in the main thread only, elsewhere it does nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def give_up(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def one_line(message: str) -> str | None:
    """The fault of an error message, which must be one non-empty line of bounded length; None if it has none."""
    if not message.strip():
        return "the error has no message"
    if "\n" in message.strip("\n"):
        return f"the error has more than one line: {message!r:.300}"
    if len(message) > 1_500:
        return f"the error has {len(message)} characters: {message[:200]!r}"
    if not message.isprintable():
        return f"the error holds control characters: {message!r:.300}"
    return None

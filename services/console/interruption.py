"""Ctrl-C and SIGTERM: an orderly end from anywhere, and a cleaning up that a second Ctrl-C cannot break."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Terminated(BaseException):
    """SIGTERM came: like KeyboardInterrupt, not to be caught on the way to the process's edge."""


_came: list[int] = []
"""The signals that came within the present `ending_on_signals`, in order."""


@contextmanager
def ending_on_signals() -> Iterator[None]:
    """Within, SIGTERM unwinds the main thread as Ctrl-C does, and Ctrl-C itself even where a shell had it ignored."""
    _came.clear()
    with _handlers({signal.SIGINT: _interrupt, signal.SIGTERM: _terminate}):
        yield


def told_to_end() -> int | None:
    """The signal that this process was told to end with, SIGINT or SIGTERM; None while there was none.

    It is remembered because the exception may not arrive: foreign code that a signal finds in one of its callbacks
    makes an exception of its own out of it.
    """
    return _came[0] if _came else None


@contextmanager
def uninterrupted() -> Iterator[None]:
    """No Ctrl-C and no SIGTERM within: for ending what was begun."""
    with _handlers({signal.SIGINT: signal.SIG_IGN, signal.SIGTERM: signal.SIG_IGN}):
        yield


@contextmanager
def _handlers(wanted: dict[signal.Signals, Any]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # which alone may say what signals do
        yield
        return
    before = {number: signal.signal(number, handler) for number, handler in wanted.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _came.append(number)
    signal.default_int_handler(number, frame)


def _terminate(number: int, _: FrameType | None) -> None:
    _came.append(number)
    raise Terminated

"""Ctrl-C and SIGTERM: an orderly end from anywhere, and a cleaning up that a second Ctrl-C cannot break."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Terminated(BaseException):
    """SIGTERM came: like KeyboardInterrupt, not to be caught on the way to the process's edge."""


@contextmanager
def ending_on_signals() -> Iterator[None]:
    """Within, SIGTERM unwinds the main thread as Ctrl-C does, and Ctrl-C itself even where a shell had it ignored."""
    with _handlers({signal.SIGINT: signal.default_int_handler, signal.SIGTERM: _raise_terminated}):
        yield


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


def _raise_terminated(*_: Any) -> None:
    raise Terminated

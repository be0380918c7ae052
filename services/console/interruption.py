"""Ctrl-C and SIGTERM: an orderly end from anywhere, and a cleaning up that a second Ctrl-C cannot break."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Terminated(BaseException):
    """SIGTERM came: like KeyboardInterrupt, not to be caught on the way to the process's edge."""


def end_on_signals() -> None:
    """Make SIGTERM unwind the main thread as Ctrl-C does, and Ctrl-C itself even where a shell had it ignored."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, _raise_terminated)


def _raise_terminated(*_: Any) -> None:
    raise Terminated


@contextmanager
def uninterrupted() -> Iterator[None]:
    """No Ctrl-C and no SIGTERM within: for ending what was begun."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

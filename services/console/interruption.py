"""Ctrl-C and SIGTERM: an orderly end from anywhere, clean-up that a second Ctrl-C cannot break, an end in time."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

ENDS_WITHIN_S = 1.6
"""From the signal on; 2 s are promised."""
EXIT_CODES = {signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "terminated")}
"""Exit code and last line of a process that a signal ends."""


class Terminated(BaseException):
    """SIGTERM came; like KeyboardInterrupt, to be caught at the process's edge only."""


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
    """Within, Ctrl-C and SIGTERM are ignored: for clean-up."""
    with _handlers({signal.SIGINT: signal.SIG_IGN, signal.SIGTERM: signal.SIG_IGN}):
        yield


_said = threading.Event()
"""Set once the last line of a process that ends is written."""


def end_is_said() -> None:
    """The last line is written: `ending_in_time` ends the process without another."""
    _said.set()


@contextmanager
def ending_in_time() -> Iterator[None]:
    """Within, and after a signal came within, this process ends at most `ENDS_WITHIN_S` after a signal.

    For a process that computes: Python's own handling waits for the end of a call into foreign code, and for threads.
    The signal's number reaches another thread at once, through the file descriptor of `signal.set_wakeup_fd`.
    """
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set the descriptor
        yield
        return
    told, tell = socket.socketpair()
    tell.setblocking(False)
    before = signal.set_wakeup_fd(tell.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_end_after, args=(told,), name="ending", daemon=True).start()
    try:
        yield
    finally:
        if told_to_end() is None:  # else the thread ends the process
            signal.set_wakeup_fd(before)
            tell.close()


def _end_after(told: socket.socket) -> None:
    """End the process some time after a signal's number arrives; return when the other end is closed."""
    with told:
        while number := told.recv(1):
            if number[0] in EXIT_CODES:
                time.sleep(ENDS_WITHIN_S)
                code, line = EXIT_CODES[signal.Signals(number[0])]
                if not _said.is_set():
                    sys.stderr.write(f"he3: {line}\n")
                    sys.stderr.flush()
                os._exit(code)


@contextmanager
def _handlers(wanted: dict[signal.Signals, Any]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set handlers
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

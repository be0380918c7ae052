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
"""Time from a signal to the forced end of the process; the documentation promises 2 s."""
EXIT_CODES = {
    signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "terminated"), signal.SIGHUP: (143, "terminated"),
}  # fmt: skip
"""Exit code and last line of a process that a signal ends."""


class Terminated(BaseException):
    """Raised on SIGTERM, and on SIGHUP; like KeyboardInterrupt, it is caught only in the process's entry point."""


_came: list[int] = []
"""The signals that came within the present `ending_on_signals`, in order."""


@contextmanager
def ending_on_signals() -> Iterator[None]:
    """Within this context SIGTERM unwinds the main thread as Ctrl-C does; Ctrl-C works even if the shell ignores it.

    So does SIGHUP, the end of the terminal, unless it is ignored, as under `nohup`.
    """
    _came.clear()
    wanted: dict[signal.Signals, Any] = {signal.SIGINT: _interrupt, signal.SIGTERM: _terminate}
    if signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:
        wanted[signal.SIGHUP] = _terminate
    try:
        with _handlers(wanted):
            yield
    finally:
        _came.clear()


def told_to_end() -> int | None:
    """The signal, SIGINT, SIGTERM or SIGHUP, that told this process to end; None if none has arrived.

    It is stored because KeyboardInterrupt or Terminated may not reach the caller: a C library may replace an exception
    that is raised inside one of its callbacks.
    """
    return _came[0] if _came else None


def end_if_told() -> None:
    """Raise KeyboardInterrupt or Terminated if a signal has told this process to end; for each pass of a long loop.

    The exception of the handler may not have come through: Python drops one that is raised in the callback of a weak
    reference, which the collection of garbage calls anywhere.
    """
    told = told_to_end()
    if told is not None:
        raise KeyboardInterrupt if told == signal.SIGINT else Terminated


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Within this context Ctrl-C, SIGTERM and SIGHUP are ignored, for clean-up."""
    with _handlers(dict.fromkeys((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), signal.SIG_IGN)):
        yield


_said = threading.Event()
"""Set once the process has written its last line."""


def note_last_line() -> None:
    """Note that the last line is written, so that `ending_in_time` writes none."""
    _said.set()


@contextmanager
def ending_in_time() -> Iterator[None]:
    """Within this context, and after it if a signal came, the process ends at most `ENDS_WITHIN_S` after the signal.

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

"""The first steps of each of our processes, before it imports numpy or any other slow module.

Importing a module of this project changes nothing. So the modules that are run as programs call `prepare_process`
and import the rest inside a function. This module itself imports only what the interpreter has imported already: a
`random.py` or `socket.py` in the user's working directory must not take the place of a module.
"""

from __future__ import annotations

import io
import os
import sys
from typing import Any, NoReturn

from services.runtime.instructions import common_instructions

PARENT = "HE3_PARENT_PID"
"""Environment variable: process id of the parent. This process ends when the parent ends."""
WATCH_EVERY_S = 0.5
"""How late the parent's end is noticed on systems whose kernel does not report it."""
ENDS_WITHIN_S = 3.0
"""Longest time from the parent's end to the end of this process."""

_PR_SET_PDEATHSIG = 1  # Linux, prctl(2)


def prepare_process() -> None:
    """Set the environment that numpy reads at import, and let this process end with its parent."""
    open_standard_streams()
    # One BLAS thread, unless the user asked for more. It counts only before numpy is first imported. The matrices of
    # the belief are small: on cores that other processes use too, OpenBLAS's own threads wait for one another and take
    # 50 times as long as one thread. Where a second thread pays, on the map, he3.posterior.grid shares out the cells
    # itself. Results also stay the same bytes on machines with other numbers of cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for name, value in common_instructions().items():
        os.environ.setdefault(name, value)
    # What a mission writes (journals, recordings, reports, logs) is for its owner alone.
    os.umask(0o077)
    end_with_parent()


def prepare_service() -> None:
    """Prepare a process that was started as ``python -m services.NAME``, and end it at once on signals until it serves.

    The working directory, which Python puts first on the import path, is removed.
    """
    forget_working_directory()
    end_on_signals()
    prepare_process()


def open_standard_streams() -> None:
    """Open /dev/null in place of each standard stream that this process was started without.

    A service manager may close them, and a shell does with `>&-`. The next file that is opened would get the number of
    the missing stream: what is printed would go into the recording.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: that one
            os.set_inheritable(number, True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    if sys.stderr is sys.__stderr__ and isinstance(sys.stderr, io.TextIOWrapper):
        messages = io.BufferedWriter(_Messages(2, "w", closefd=False))
        sys.stderr = io.TextIOWrapper(messages, sys.stderr.encoding, sys.stderr.errors, line_buffering=True)


class _Messages(io.FileIO):
    """Standard error, on which a message is lost where a full disk does not take it: that ends no mission.

    The end of a reader is another matter, and still an error.
    """

    def write(self, message: Any, /) -> int:
        try:
            return super().write(message)
        except BrokenPipeError:
            raise
        except OSError:
            return len(message)


def forget_working_directory() -> None:
    """Take the working directory off the path, unless our code lies there.

    `python -m` puts it first, and an empty entry of PYTHONPATH (a colon too many) anywhere.
    """
    try:
        here = os.getcwd()  # noqa: PTH109 - pathlib is not imported yet
    except FileNotFoundError:
        here = ""
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))  # noqa: PTH100, PTH120
    if not sys.flags.safe_path and sys.path and sys.path[0] in ("", here):
        if here != root or root in sys.path[1:]:
            del sys.path[0]
        else:
            sys.path[0] = root
    sys.path[:] = [entry for entry in sys.path if entry == root or entry not in ("", ".", here)]


def end_on_signals() -> None:
    """End at once, without a message, on SIGINT and SIGTERM: for a process that has nothing to clean up yet."""
    import signal

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)


def _end(*_: object) -> None:
    os._exit(0)


def end_with_parent() -> None:
    """End this process when its parent, whose id is in `PARENT`, ends for any reason.

    It gets SIGTERM then. The kernel sends it when the thread ends that started this process: start processes from a
    thread that lives as long as its own process.
    """
    named = os.environ.pop(PARENT, "")
    if not named.isdigit():
        return
    import signal

    parent = int(named)
    if sys.platform == "linux" and os.getppid() == parent:
        import ctypes

        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM))
        if os.getppid() != parent:  # it died before the kernel knew
            os._exit(1)
        return
    import threading

    # Another system, or a process in between (a wrapper) that may outlive the parent.
    threading.Thread(target=_watch, args=(parent,), name="parent", daemon=True).start()


def _watch(parent: int) -> None:
    import signal
    import time

    child_of_it = os.getppid() == parent
    while os.getppid() == parent if child_of_it else _exists(parent):
        time.sleep(WATCH_EVERY_S)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(ENDS_WITHIN_S)
    os._exit(1)


def _exists(pid: int) -> bool:
    """Whether that process runs; a zombie counts as ended."""
    try:
        os.kill(pid, 0)
        with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as stat:  # noqa: PTH123
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except ProcessLookupError:
        return False
    except OSError:  # another user's, or no /proc
        return True


def leave(code: int) -> NoReturn:
    """End this process now, with that exit code, once everything is closed.

    The orderly shutdown of the interpreter and of Zenoh's threads would take a second or more, without any use.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # no process reads it, or the disk with its file is full
            continue
    os._exit(code)

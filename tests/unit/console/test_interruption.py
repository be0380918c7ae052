"""A command that is told to end: one line and its exit code, also if a library replaces the exception."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Self

import pytest

from he3.errors import He3Error
from services.console import __main__ as entry
from services.console.cli import app
from services.console.interruption import (
    ENDS_WITHIN_S,
    Terminated,
    end_if_told,
    ending_in_time,
    ending_on_signals,
    told_to_end,
)
from services.console.launch.in_process import run_in_process
from services.console.launch.scenarios import choose
from services.console.report.outputs import outputs
from tests.waiting import PATIENCE_S, expect_within

ENDS = [
    (signal.SIGINT, 130, "he3: interrupted\n"),
    (signal.SIGTERM, 143, "he3: terminated\n"),
    (signal.SIGHUP, 143, "he3: terminated\n"),
]


def command_is(monkeypatch: pytest.MonkeyPatch, body: Callable[[], None]) -> None:
    monkeypatch.setattr(app, "build", lambda: lambda *_, **__: body())


@pytest.mark.parametrize(("number", "code", "line"), ENDS)
def test_a_signal_ends_a_command(
    number: signal.Signals,
    code: int,
    line: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    command_is(monkeypatch, lambda: signal.raise_signal(number))
    assert entry.main([]) == code
    assert capsys.readouterr().err == line


@pytest.mark.parametrize("echo", [ValueError("Error calling function: Terminated"), He3Error("it was disturbed")])
@pytest.mark.parametrize(("number", "code", "line"), ENDS)
def test_a_signal_that_arrives_as_some_other_error_still_ends_the_command_as_told(
    number: signal.Signals,
    code: int,
    line: str,
    echo: Exception,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def body() -> None:
        try:
            signal.raise_signal(number)
        except (KeyboardInterrupt, Terminated):
            raise echo from None

    command_is(monkeypatch, body)
    assert entry.main([]) == code
    assert capsys.readouterr().err == line


def test_the_end_of_the_terminal_does_not_end_a_command_under_nohup(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        command_is(monkeypatch, lambda: signal.raise_signal(signal.SIGHUP))
        assert entry.main([]) == 0
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


IN_FOREIGN_CODE = """
import ctypes, sys
from services.console.interruption import Terminated, ending_in_time, ending_on_signals
c, lock = ctypes.CDLL(None), ctypes.create_string_buffer(128)
c.pthread_mutex_lock(lock)
with ending_on_signals(), ending_in_time():
    try:
        print("ready", flush=True)
        c.pthread_mutex_lock(lock)
    except (KeyboardInterrupt, Terminated):
        pass  # the signal came first
    c.pthread_mutex_lock(lock)  # never returns, so no handler of Python runs
"""

A_THREAD_THAT_WORKS_ON = """
import sys, threading, time
from services.console.interruption import Terminated, ending_in_time, ending_on_signals
with ending_on_signals(), ending_in_time():
    threading.Thread(target=time.sleep, args=(60,)).start()
    try:
        print("ready", flush=True)
        time.sleep(60)
    except (KeyboardInterrupt, Terminated):
        print("kept", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("code", "kept"), [(IN_FOREIGN_CODE, ""), (A_THREAD_THAT_WORKS_ON, "kept\n")])
def test_a_process_that_computes_ends_in_time_and_has_time_to_keep_its_results(
    code: str, kept: str, number: signal.Signals
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        began = time.monotonic()
        process.send_signal(number)
        said, error = process.communicate()
        expect_within(ENDS_WITHIN_S + 0.5, time.monotonic() - began, "the end of a process that computes")
        exit_code, line = next((code, line) for each, code, line in ENDS if each is number)
        assert (process.returncode, said, error) == (exit_code, kept, line)


def test_a_command_that_is_over_leaves_signals_as_they_were() -> None:
    before = signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(before)
    with ending_on_signals(), ending_in_time():
        pass
    assert signal.set_wakeup_fd(before) == before
    assert [thread.name for thread in threading.enumerate() if thread.name == "ending" and not gone(thread)] == []


def gone(thread: threading.Thread) -> bool:
    thread.join(10.0)
    return not thread.is_alive()


@pytest.mark.parametrize(("number", "kind"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)])
def test_a_signal_whose_exception_was_dropped_ends_the_next_pass_of_a_loop(
    number: signal.Signals, kind: type[BaseException]
) -> None:
    def loop() -> None:
        with ending_on_signals():
            end_if_told()
            with suppress(kind):  # as in the callback of a weak reference
                signal.raise_signal(number)
            end_if_told()

    with pytest.raises(kind):
        loop()
    end_if_told()


class Dropping:
    """A progress display in which Ctrl-C arrives once, at a place where its exception is dropped."""

    def show(self, now: object) -> None:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_a_mission_in_one_process_ends_upon_a_ctrl_c_whose_exception_was_dropped() -> None:
    with pytest.raises(KeyboardInterrupt), ending_on_signals():
        run_in_process(choose("short").scenario, outputs(None, None), Dropping(), scores_rounds=False)


def test_an_error_without_a_signal_is_a_defect_and_a_signal_of_an_earlier_command_is_forgotten(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command_is(monkeypatch, lambda: signal.raise_signal(signal.SIGTERM))
    assert entry.main([]) == 143
    capsys.readouterr()

    def body() -> None:
        assert told_to_end() is None
        raise ValueError("seven")

    command_is(monkeypatch, body)
    monkeypatch.delenv(entry.TRACEBACK, raising=False)
    assert entry.main([]) == 1
    assert capsys.readouterr().err == "he3: defect: ValueError: seven (HE3_TRACEBACK=1 shows where)\n"
    monkeypatch.setenv(entry.TRACEBACK, "1")
    with pytest.raises(ValueError, match="seven"):
        entry.main([])


def test_a_disk_that_is_full_costs_one_line_that_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def body() -> None:
        with open("/dev/full", "w", encoding="ascii") as full:  # noqa: PTH123 - the device, not a file of ours
            full.write("x" * 100_000)

    command_is(monkeypatch, body)
    monkeypatch.delenv(entry.TRACEBACK, raising=False)
    assert entry.main([]) == 1
    assert capsys.readouterr().err == "he3: the system refused: No space left on device\n"

    command_is(monkeypatch, lambda: open("/dev/null/x", "w"))  # noqa: PTH123, SIM115 - it is never opened
    assert entry.main([]) == 1
    assert capsys.readouterr().err == "he3: /dev/null/x: Not a directory\n"


def test_a_command_of_its_own_process_ends_though_a_thread_never_does() -> None:
    # A session that a bad link keeps from closing leaves threads behind, for which Python's own end waits for ever.
    stuck = (
        "import sys, threading; threading.Thread(target=threading.Event().wait).start();"
        "sys.argv = ['he3', '--version'];"
        "from services.console.__main__ import main; sys.exit(main())"
    )
    done = subprocess.run([sys.executable, "-c", stuck], capture_output=True, text=True, timeout=PATIENCE_S)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("he3-seeker ")

"""A command that is told to end: one line and its exit code, whatever becomes of the exception on its way."""

from __future__ import annotations

import signal
from collections.abc import Callable

import pytest

from he3.errors import He3Error
from services.console import __main__ as entry
from services.console.cli import app
from services.console.interruption import Terminated, told_to_end

ENDS = [(signal.SIGINT, 130, "he3: interrupted\n"), (signal.SIGTERM, 143, "he3: terminated\n")]


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

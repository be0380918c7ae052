"""Waiting for a telecommand: until the given stage, or until the command has ended."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from he3.errors import He3Error, PeerUnreachable
from schemas import commands
from schemas.commands import CommandKind, CommandReport, CommandStage, CommandStatus, Telecommand
from services.console.cli.command import Sending, _issue, asks, fail_if_it_failed, sends

Stage = CommandStage
ENDS = tuple(stage for stage in Stage if stage in commands.ENDS)


def status(*stages: CommandStage) -> CommandStatus:
    return CommandStatus(
        command=Telecommand(command_id="r1", kind=CommandKind.RESUME),
        stages=tuple(
            CommandReport(command_id="r1", stage=stage, at=number, why="it is not paused" if stage in ENDS else "")
            for number, stage in enumerate(stages)
        ),
    )


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("wanted", list(Stage))
def test_an_end_of_whatever_kind_ends_the_waiting_for_any_stage(end: CommandStage, wanted: CommandStage) -> None:
    assert status(Stage.QUEUED, end).has_reached(wanted)


def test_a_command_under_way_has_come_to_its_stages_and_to_those_that_it_went_past() -> None:
    under_way = status(Stage.QUEUED, Stage.RELEASED, Stage.RECEIVED)
    assert under_way.has_reached(Stage.RELEASED)
    assert under_way.has_reached(Stage.RADIATED)
    assert not under_way.has_reached(Stage.ACCEPTED)
    assert not any(under_way.has_reached(end) for end in ENDS)
    assert not status().has_reached(Stage.QUEUED)


@pytest.mark.parametrize("end", [end for end in ENDS if end is not Stage.COMPLETED])
def test_a_command_that_did_not_complete_is_a_failure_with_its_stage_and_reason(end: CommandStage) -> None:
    for wanted in (None, Stage.RECEIVED, Stage.COMPLETED):
        with pytest.raises(He3Error, match=f"^command r1: {end.value}: it is not paused$"):
            fail_if_it_failed(status(Stage.QUEUED, end), wanted)


def test_a_command_that_ended_as_it_was_waited_for_or_is_under_way_is_no_failure() -> None:
    for end in ENDS:
        fail_if_it_failed(status(Stage.QUEUED, end), end)
    fail_if_it_failed(status(Stage.QUEUED, Stage.COMPLETED), None)
    fail_if_it_failed(status(Stage.QUEUED), Stage.COMPLETED)


def test_a_command_that_completed_while_a_failure_was_waited_for_is_not_what_was_wanted() -> None:
    with pytest.raises(He3Error, match="completed"):
        fail_if_it_failed(status(Stage.QUEUED, Stage.COMPLETED), Stage.FAILED)


def test_a_reported_end_counts_before_the_assumption_that_the_command_is_lost() -> None:
    late = status(Stage.QUEUED, Stage.COMPLETED, Stage.LOST)
    assert late.end is not None
    assert late.end.stage is Stage.COMPLETED
    fail_if_it_failed(late, Stage.COMPLETED)


def test_enter_sends_a_command_and_any_other_answer_does_not() -> None:
    assert all(sends(answer) for answer in ("\n", "y\n", " yes \n"))
    assert not any(sends(answer) for answer in ("", "\x1b\n", "n\n", "\x1b", "y"))


@pytest.mark.parametrize("kind", [kind.value for kind in CommandKind])
@pytest.mark.parametrize(("keyboard", "screen"), [(True, True), (True, False), (False, True), (False, False)])
def test_only_who_sees_the_question_and_can_answer_it_is_asked_and_never_before_safe(
    kind: str, keyboard: bool, screen: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: keyboard))
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: screen))
    assert asks(kind, yes=False) is (keyboard and screen and kind != "safe")
    assert not asks(kind, yes=True)


@pytest.mark.parametrize("closed", ["stdin", "stderr"])
def test_nothing_is_asked_where_a_stream_is_closed(closed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("stdin", "stderr"):
        monkeypatch.setattr(sys, name, None if name == closed else SimpleNamespace(isatty=lambda: True))
    assert not asks("pause", yes=False)


class Waiting:
    """A command that was sent; what ends the waiting for its stages."""

    def __init__(self, end: BaseException) -> None:
        self.status, self._end = status(Stage.QUEUED, Stage.RELEASED), end

    def wait(self, stage: CommandStage, timeout_s: float) -> CommandStatus:
        raise self._end


@pytest.mark.parametrize("end", [PeerUnreachable("expected completed within 1 s"), KeyboardInterrupt()])
def test_a_command_that_was_sent_is_printed_whatever_ends_the_waiting_for_its_stage(
    end: BaseException, capsys: pytest.CaptureFixture[str]
) -> None:
    mission = SimpleNamespace(mission="m", command=lambda *_, **__: Waiting(end))
    session: Any = SimpleNamespace(join=lambda: nullcontext(mission))
    with pytest.raises(type(end)):
        _issue(session, "resume", {}, Sending(wait="completed", yes=True, json=True))
    document = json.loads(capsys.readouterr().out)
    assert document["command"]["command_id"] == "r1"
    assert [each["stage"] for each in document["stages"]] == ["queued", "released"]


def test_a_command_whose_sending_was_interrupted_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    session: Any = SimpleNamespace(join=lambda: nullcontext(SimpleNamespace(mission="m", command=interrupted)))
    with pytest.raises(KeyboardInterrupt):
        _issue(session, "resume", {}, Sending(command_id="mine", yes=True))
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", "he3: command mine may have been sent (he3 commands)\n")

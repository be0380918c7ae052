"""Command stacks: read, checked against the rover's rules, sent under conditions, stopped at the first failure."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from he3.errors import He3Error, InvalidInput, OutcomeUnknown, PeerUnreachable
from schemas.commands import CommandPreview, CommandReport, CommandStage, CommandStatus
from schemas.telemetry import RoverMode
from services.console.client.previews import CommandOutlook, Passage
from services.console.client.stacks import StackLine, StackRun, parse_stack, rule_broken
from services.mission.mission_time import SECOND, MissionTime

START = 1_893_456_000 * SECOND
Stage = CommandStage
ALL = """
# The area is closed before the rover drives on.
pause
after accepted: keep-out crater 100,100 150,100 125,150
at 2h: go-to 120 340 --expires-in 3600
after completed, at next contact: safe
resume
at 2030-01-01T03:00:00Z: keep-out crater
"""


class Desk:
    """A mission whose time passes by one minute a look; `ends` has the end of each kind of command."""

    def __init__(self, ends: dict[str, tuple[CommandStage, str]] | None = None) -> None:
        self.sent: list[tuple[str, float]] = []
        self.objections: dict[str, str] = {}
        self.warnings: dict[str, str] = {}
        self.contact: Callable[[float], bool] = lambda _: True
        self._ends = ends or {}
        self._since: dict[str, tuple[StackLine, MissionTime]] = {}
        self._now = START

    @property
    def minutes(self) -> float:
        return (self._now - START) / SECOND / 60

    def now(self) -> MissionTime:
        return self._now

    def in_contact(self) -> bool:
        return self.contact(self.minutes)

    def rover_mode(self) -> RoverMode | None:
        return RoverMode.DRIVING

    def outlook(self, line: StackLine) -> CommandOutlook:
        kind = line.command.kind.value
        objection, warning = self.objections.get(kind, ""), self.warnings.get(kind, "")
        preview = CommandPreview(
            command=line.command, at=self._now, objection=objection, warning=warning, effect="it does", charge_wh=1.0
        )
        return CommandOutlook(preview, Passage(None, None))

    def send(self, line: StackLine) -> str:
        self.sent.append((line.command.kind.value, self.minutes))
        self._since[line.command.command_id] = line, self._now
        return line.command.command_id

    def stages(self) -> dict[str, CommandStatus]:
        """A command is accepted one minute after it was sent, and ends after three."""
        found = {}
        for name, (line, since) in self._since.items():
            end, why = self._ends.get(line.command.kind.value, (Stage.COMPLETED, ""))
            passed = [(Stage.QUEUED, ""), (Stage.ACCEPTED, ""), (end, why)]
            count = 1 + (self._now - since >= 60 * SECOND) + (self._now - since >= 180 * SECOND)
            reports = tuple(
                CommandReport(command_id=name, stage=stage, at=since, why=text) for stage, text in passed[:count]
            )
            found[name] = CommandStatus(command=line.command, stages=reports)
        return found

    def pause(self) -> None:
        self._now += 60 * SECOND


def flown(text: str, desk: Desk) -> StackRun:
    stack = StackRun(parse_stack(text, START), desk)
    list(stack.check())
    list(stack.run(lambda line, outlook: True))
    return stack


def test_a_stack_is_read_with_its_conditions() -> None:
    lines = parse_stack(ALL, START)
    assert [line.number for line in lines] == [3, 4, 5, 6, 7, 8]
    assert [line.after for line in lines] == [None, Stage.ACCEPTED, None, Stage.COMPLETED, Stage.COMPLETED, None]
    assert [line.at_contact for line in lines] == [False, False, False, True, False, False]
    assert [line.at for line in lines] == [None, None, START + 7200 * SECOND, None, None, START + 3 * 3600 * SECOND]
    assert lines[1].command.polygon_m == ((100.0, 100.0), (150.0, 100.0), (125.0, 150.0))
    assert (lines[2].command.target_m, lines[2].expires_in_s) == ((120.0, 340.0), 3600.0)
    assert lines[5].command.polygon_m is None
    assert lines[3].waits_for == "after completed, at next contact"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "expected 1 to 200 commands, got 0"),
        ("pause\nfly 1 2", "line 2: expected a command out of pause, resume, abort-round, go-to, keep-out, "),
        ("go-to 1", "line 1: go-to: expected X Y in metres, got 1 values"),
        ("go-to 1 north", "line 1: Y: expected a number, got 'north'"),
        ("pause now", "line 1: pause: expected nothing after it, got 'now'"),
        ("keep-out", "line 1: keep-out: expected the name of an area, got none"),
        ("keep-out a 1,2 3,4", "line 1: command: expected a polygon of at least 3 corners, got 2"),
        ("pause\nafter lunch: resume", "line 2: expected a stage out of"),
        ("after completed: pause", "line 1: expected no 'after' in the first command"),
        ("at noon: pause", "line 1: expected 90, 15min, 2h or 3d"),
        ("pause\nafter completed, before 2h: resume", "line 2: expected conditions"),
        ("pause --expires-in 0", "line 1: --expires-in: expected above 0"),
        ("pause 'x", "line 1: expected words as of 'he3 command'"),
    ],
)
def test_text_that_is_no_stack_is_refused_with_the_line_and_the_reason(text: str, why: str) -> None:
    with pytest.raises(InvalidInput) as refusal:
        parse_stack(text, START)
    assert str(refusal.value).startswith("stack: ")
    assert why in str(refusal.value)


def broken(text: str, mode: RoverMode | None = RoverMode.DRIVING) -> str:
    return rule_broken(parse_stack(text, START), mode) or ""


def test_the_rovers_rules_are_applied_to_what_the_commands_before_have_made_of_it() -> None:
    assert broken("pause\nresume\nsafe\nresume") == ""
    assert broken("resume").startswith("line 1 (resume): expected a rover that is paused or in safe mode by then")
    assert broken("pause\ngo-to 1 2\nresume").startswith("line 3 (resume)")
    assert broken("safe\npause") == "line 2 (pause): the rover is in safe mode by then"
    assert broken("resume", RoverMode.SAFE) == broken("resume", None) == ""


SHOWN_IN = ("docs/delay.md", "services/console/cli/stack.py", "services/console/client/stacks.py")


@pytest.mark.parametrize("page", SHOWN_IN)
def test_the_stack_that_documentation_and_help_show_passes_the_rovers_rules(page: str) -> None:
    text = (Path(__file__).parents[4] / page).read_text("utf-8")
    shown = re.search(r"^ *pause\b.*\n(?: *(?:after|at) .*\n)+", text, re.MULTILINE)
    assert shown is not None
    assert len(parse_stack(shown[0], START)) == 4
    assert broken(shown[0]) == ""


def test_each_command_waits_for_its_conditions() -> None:
    desk = Desk()
    desk.contact = lambda minutes: not 100 < minutes < 200
    flown(ALL, desk)
    assert desk.sent == [
        ("pause", 0.0),
        ("set_keep_out", 1.0),
        ("go_to", 120.0),
        ("safe", 200.0),
        ("resume", 203.0),
        ("set_keep_out", 203.0),
    ]


def test_a_stack_of_which_one_command_would_be_refused_is_not_begun() -> None:
    desk = Desk()
    desk.objections["go_to"] = "(120, 340) is closed"
    with pytest.raises(InvalidInput, match=r"^stack: line 5 \(go-to 120 340 .*is closed; nothing was sent$"):
        flown(ALL, desk)
    desk = Desk()
    desk.warnings["abort_round"] = "no round is under way"
    with pytest.raises(InvalidInput, match="no round is under way; nothing was sent"):
        flown("abort-round\npause", desk)
    desk.warnings["set_keep_out"] = "there is no keep-out a to remove"
    with pytest.raises(InvalidInput, match=r"line 2 \(keep-out a\): there is no keep-out a"):
        flown("pause\nkeep-out a", desk)
    assert desk.sent == []
    flown("keep-out a 0,0 1,0 0,1\nkeep-out a", Desk())
    flown("pause\nabort-round", desk)  # the pause may change what is warned of


def test_a_stack_stops_at_the_first_command_that_fails() -> None:
    desk = Desk({"set_keep_out": (Stage.REJECTED, "it has 101 of them")})
    with pytest.raises(He3Error) as failure:
        flown(ALL, desk)
    assert str(failure.value) == (
        "stack: line 4 (keep-out crater 100,100 150,100 125,150): rejected: it has 101 of them; "
        "2 of 6 commands sent, nothing is sent after it"
    )
    assert [kind for kind, _ in desk.sent] == ["pause", "set_keep_out"]


def test_a_command_that_would_be_refused_when_its_turn_comes_is_not_sent() -> None:
    desk = Desk()
    stack = StackRun(parse_stack("pause\ngo-to 1 2", START), desk)
    list(stack.check())
    desk.objections["go_to"] = "the way is closed by now"
    with pytest.raises(He3Error, match="the way is closed by now; 1 of 2 commands sent"):
        list(stack.run(lambda line, outlook: True))


def test_a_command_that_is_refused_as_it_is_sent_stops_the_stack_too() -> None:
    desk = Desk()

    def refuse(line: StackLine) -> str:
        raise InvalidInput("expected the holder of command authority")

    desk.send = refuse  # type: ignore[method-assign]
    with pytest.raises(He3Error, match=r"line 1 \(pause\): expected the holder of command authority; 0 of 1 commands"):
        flown("pause", desk)


def test_an_operator_who_steps_through_a_stack_stops_it_where_they_say_no() -> None:
    desk = Desk()
    stack = StackRun(parse_stack("pause\nresume", START), desk)
    with pytest.raises(He3Error, match=r"line 2 \(resume\): not sent, as the operator decided"):
        list(stack.run(lambda line, outlook: line.number == 1))
    assert [kind for kind, _ in desk.sent] == ["pause"]


def test_a_stack_whose_mission_falls_silent_says_what_was_sent_and_what_is_not_known() -> None:
    def silent(*_: object) -> Any:
        raise PeerUnreachable("mission 'm': the ground does not answer")

    desk = Desk()
    stack = StackRun(parse_stack("pause\nresume", START), desk)
    desk.stages = silent  # type: ignore[method-assign]
    with pytest.raises(
        PeerUnreachable, match=r"^stack: mission 'm': the ground does not answer; 1 of 2 commands sent, nothing"
    ):
        list(stack.run(lambda line, outlook: True))
    desk.send = silent  # type: ignore[method-assign]
    stack = StackRun(parse_stack("pause", START), desk)
    with pytest.raises(
        PeerUnreachable,
        match=r"^stack: line 1 \(pause\): mission 'm': the ground does not answer; 0 of 1 commands sent, nothing",
    ):
        list(stack.run(lambda line, outlook: True))

    def reached(*_: object) -> Any:
        raise OutcomeUnknown("command op-1: mission 'm': the ground has not answered, and may have done what was asked")

    desk.send = reached  # type: ignore[method-assign]
    with pytest.raises(
        OutcomeUnknown,
        match=r"line 1 \(pause\): command op-1: .* may have done what was asked; beside it 0 of 1 commands",
    ):
        list(StackRun(parse_stack("pause", START), desk).run(lambda line, outlook: True))

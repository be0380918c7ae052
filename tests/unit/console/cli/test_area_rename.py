"""A renamed area: two commands, one decision."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import typer

from he3.errors import He3Error, InvalidInput
from services.console.cli.area import _rename
from services.console.client.areas import Area, AreaKind

CORNERS = ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0))
CRATER = Area(AreaKind.KEEP_OUT, "crater", CORNERS)
RENAMED = replace(CRATER, name="rim")


class Mission:
    """A mission that notes what it is sent; `refused`: the name of the area that it refuses."""

    mission, earth = "m", "tcp/127.0.0.1:1"

    def __init__(self, objection: str = "", refused: str | None = None) -> None:
        self.sent: list[tuple[str, bool]] = []
        self._outlook = SimpleNamespace(
            sound=not objection, preview=SimpleNamespace(objection=objection), rows=lambda: [("does", "closes ground")]
        )
        self._refused = refused

    def preview(self, *_: Any, **__: Any) -> Any:
        return self._outlook

    def command(self, _: str, *, area_id: str, polygon_m: Any = None) -> str:
        if area_id == self._refused:
            raise He3Error("the ground is silent")
        self.sent.append((area_id, polygon_m is not None))
        return area_id


def answer(monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    """An operator at a terminal, who answers once and is not asked again."""
    terminal = io.StringIO(line)
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stdin", terminal)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)


def test_one_answer_sends_both_commands_and_says_what_both_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    mission: Any = Mission()
    answer(monkeypatch, "\n")
    assert _rename(mission, CRATER, RENAMED, yes=False) == ["rim", "crater"]
    assert mission.sent == [("rim", True), ("crater", False)]
    said = capsys.readouterr().err
    assert "then       removes keep-out crater; its ground stays closed under the new name" in said
    assert said.count("Enter sends it") == 1


@pytest.mark.parametrize("line", ["no\n", ""])
def test_without_that_answer_nothing_is_sent(monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    mission: Any = Mission()
    answer(monkeypatch, line)
    with pytest.raises(typer.Exit):
        _rename(mission, CRATER, RENAMED, yes=False)
    assert mission.sent == []


def test_what_the_ground_would_refuse_is_not_asked_and_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    mission: Any = Mission(objection="it would enclose the rover")
    answer(monkeypatch, "\n")
    with pytest.raises(InvalidInput, match="it would enclose the rover"):
        _rename(mission, CRATER, RENAMED, yes=False)
    assert mission.sent == []


def test_a_name_that_could_not_be_removed_is_told() -> None:
    mission: Any = Mission(refused="crater")
    with pytest.raises(He3Error, match="keep-out rim is set, and crater not removed: the ground is silent"):
        _rename(mission, CRATER, RENAMED, yes=True)

"""The screen of he3 watch shows every word, also on a narrow terminal; its lines end with the mission's last status."""

from __future__ import annotations

import json
from typing import Any

import pytest
from rich.console import Console

from he3.errors import PeerUnreachable
from schemas.ground import MissionPhase
from schemas.topics import GROUND_STATUS
from services.console.cli.watch import as_json, lines_of, table_of
from services.console.client.mission_client import MissionClient
from tests.unit.console.client.conftest import FakeSession
from tests.unit.console.client.test_mission_state import START, ground, header

ROWS = [
    ("phase", "executing: round 7 ended early: closed terrain ahead of the rover, the way is planned anew"),
    ("rover", "safe mode at (1234.5, 987.6) m"),
    ("link", "NO CONTACT, one-way light time 1.282 s"),
]


@pytest.mark.parametrize("width", [30, 50, 120])
def test_no_word_is_lost_on_a_terminal_of_any_width(width: int) -> None:
    console = Console(width=width, color_system=None)
    with console.capture() as shown:
        console.print(table_of(ROWS))
    lines = shown.get().splitlines()

    assert all(len(line) <= width for line in lines)
    assert lines_of(table_of(ROWS), width) == len(lines)
    words = " ".join(lines).split()
    assert [word for word in words if word not in dict(ROWS)] == [word for _, text in ROWS for word in text.split()]


class Mission(MissionClient):
    def __init__(self, session: FakeSession) -> None:
        self._session = session.client
        self.earth, self.mission = "tcp/127.0.0.1:7448", "m"


OVER = ground(9).model_copy(update={"phase": MissionPhase.COMPLETED})


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_json_lines_end_with_the_status_that_says_that_the_mission_is_over(
    capsys: pytest.CaptureFixture[str],
) -> None:
    session = FakeSession()
    session.kept = {GROUND_STATUS: (header(START), OVER)}
    as_json(Mission(session))
    (last,) = lines(capsys)
    assert (last["topic"], last["body"]["samples"], last["body"]["phase"]) == ("earth/ground/status", 9, "completed")


def test_json_lines_of_a_mission_that_has_fallen_silent_end_with_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.console.client.mission_state.SILENT_S", 0.2)
    with pytest.raises(PeerUnreachable, match="nothing heard"):
        as_json(Mission(FakeSession()))

"""``he3`` alone, and tab completion."""

from __future__ import annotations

import pytest

from services.console.__main__ import main
from services.console.cli.next_steps import next_steps
from services.console.client.run_file import RunningMission
from tests.processes import he3, run


def running(name: str) -> RunningMission:
    return RunningMission(name, "t1", "tcp/127.0.0.1:7447", "tcp/127.0.0.1:7448", 1, {})


def test_without_a_mission_the_command_alone_says_how_to_start_one() -> None:
    said = next_steps([])
    assert said.startswith("No mission runs on this machine.")
    assert all(f"\n  {words} " in said for words in ("he3 demo", "he3 up t1 --rate 100", "he3 web --authority"))
    assert "he3 --install-completion" in said


def test_with_several_missions_the_command_alone_names_them_and_the_flag_that_chooses() -> None:
    assert "--mission" not in next_steps([running("t1")])
    said = next_steps([running("t1"), running("t2")])
    assert "Mission 't2' runs at tcp/127.0.0.1:7448.\n" in said
    assert "\n  he3 status --mission t1 " in said


def test_the_command_alone_succeeds(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert "he3 --help" in capsys.readouterr().out


def test_the_shell_completes_commands_scenarios_and_stages() -> None:
    for line, expected in (
        ("he3 aud", ["audit"]),
        ("he3 up t1-agency", ["t1-agency-6s", "t1-agency-8s"]),
        ("he3 command pause --wait re", ["released", "received"]),
    ):
        asked = {"_HE3_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
        assert run(he3(), env=asked).stdout.split() == expected

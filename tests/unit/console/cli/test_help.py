"""The command line's help: complete, with examples, and fast."""

from __future__ import annotations

import subprocess
import sys

import pytest

from services.console.__main__ import main
from services.console.cli.app import build

HEAVY = ("numpy", "scipy", "matplotlib", "ompl", "zenoh", "rich", "pydantic", "mcap")

COMMANDS = (
    ["demo"], ["run"], ["up"], ["status"], ["watch"], ["map", "at"], ["map", "show"], ["map", "export"],
    ["map", "score"], ["link", "show"], ["link", "set"], ["command", "pause"], ["command", "go-to"],
    ["command", "keep-out"], ["commands"], ["region", "show"], ["region", "build"], ["replay"], ["schemas"],
)  # fmt: skip


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_explains_itself_with_examples(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words, "--help"]) == 0
    said = capsys.readouterr()
    assert "Examples:" in said.out
    assert f"he3 {words[0]}" in said.out
    assert said.err == ""


def test_every_command_is_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"\n  {words[0]} " in out for words in COMMANDS)


def test_the_command_line_is_made_without_anything_heavy() -> None:
    # A process of its own: this one has imported everything long ago.
    code = (
        "import sys; from services.console.__main__ import main; main(['--help']); "
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stderr.strip() == "[]"


def test_a_group_without_a_command_shows_its_help_and_fails(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["link"]) == 2
    assert "show" in capsys.readouterr().out


def test_the_application_can_be_built_twice() -> None:
    assert build() is not build()


def test_the_version_is_printed_without_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("he3-seeker ")

"""The command line's help: complete, with examples, and fast."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from typer.core import TyperGroup

from services.console.__main__ import main
from services.console.cli.app import build

HEAVY = ("numpy", "scipy", "matplotlib", "ompl", "zenoh", "rich", "pydantic", "mcap")


def commands(group: Any, words: tuple[str, ...] = ()) -> Iterator[list[str]]:
    """The words of every command of the application that its help shows; `bench` takes the words of a program."""
    if not isinstance(group, TyperGroup):
        yield [*words]
        return
    for name, command in group.commands.items():
        if not command.hidden and name != "bench":
            yield from commands(command, (*words, name))


COMMANDS = [*commands(typer.main.get_command(build()))]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_explains_itself_with_examples(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words, "--help"]) == 0
    said = capsys.readouterr()
    assert re.search(r"^ *Examples(, .*)?:$", said.out, re.MULTILINE)
    assert f"he3 {words[0]}" in said.out
    assert said.err == ""


WITHOUT_JSON = {
    "up", "web", "foxglove",  # they serve until they are stopped
    "schemas", "region template",  # what they print is a document already
}  # fmt: skip


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_prints_a_json_document_but_those_that_serve_or_print_another_one(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    main([*words, "--help"])
    assert ("--json" in capsys.readouterr().out) == (" ".join(words) not in WITHOUT_JSON)


def test_every_command_is_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"\n  {words[0]} " in out for words in COMMANDS)
    assert [line for line in out.splitlines() if line.startswith("  ") and line.endswith("...")] == []


@pytest.mark.parametrize("group", sorted({words[0] for words in COMMANDS if len(words) > 1}))
def test_the_help_of_a_group_says_of_each_command_in_a_whole_line_what_it_does(
    group: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([group, "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("  ") and line.endswith("...")] == []


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

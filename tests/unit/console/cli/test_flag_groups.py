"""Groups of flags: a command takes a group as one parameter, the command line has its flags."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer
from typer.testing import CliRunner

from services.console.cli.flag_groups import FlagGroup, with_flags

Speed = Annotated[float, typer.Option("--speed", metavar="V", help="Metres a second.")]
Name = Annotated[str | None, typer.Option("--as", metavar="NAME", help="Who asks.")]


@dataclass(frozen=True, slots=True)
class Drive(FlagGroup):
    speed: Speed = 0.5


@dataclass(frozen=True, slots=True)
class NamedDrive(Drive):
    by: Name = None


def _app() -> typer.Typer:
    app = typer.Typer(rich_markup_mode=None)

    @app.command()
    @with_flags
    def go(drive: NamedDrive, place: Annotated[str, typer.Argument()], far: bool = False) -> None:
        """Go there."""
        typer.echo(f"{place} {far} {drive.speed} {drive.by}")

    @app.command()
    @with_flags
    def turn(drive: Drive) -> None:
        """Turn around."""
        typer.echo(f"{drive.speed}")

    return app


def _said(*words: str) -> str:
    result = CliRunner().invoke(_app(), words)
    assert result.exit_code == 0, result.output
    return result.output.strip()


def test_the_flags_of_a_group_and_of_the_group_it_extends_reach_the_command_as_one_value() -> None:
    assert _said("go", "rim", "--speed", "2", "--as", "anna", "--far") == "rim True 2.0 anna"
    assert _said("turn", "--speed", "0.25") == "0.25"


def test_without_flags_a_group_has_its_defaults() -> None:
    assert _said("go", "rim") == "rim False 0.5 None"


def test_the_help_shows_the_flags_of_the_group_after_those_of_the_command() -> None:
    text = _said("go", "--help")
    assert text.index("--far") < text.index("--speed V") < text.index("--as NAME")
    assert "drive" not in text.lower()


def test_a_command_without_the_group_s_flag_refuses_it() -> None:
    result = CliRunner().invoke(_app(), ["turn", "--as", "anna"])
    assert result.exit_code == 2

"""Flags and arguments that several commands share, described and checked once.

A value out of its range is refused by its flag's callback: exit code 2 and one line that names the flag and the range.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

MAX_SEED = 2**63 - 1
MAX_RATE = 100_000.0
"""Mission seconds per wall second that a scenario accepts."""
MAX_PPB = 1e6
MAX_POSITION_M = 1e5
MAX_WAIT_S = 86_400.0


def within(low: float, high: float, *, above: bool = False) -> Callable[[Any], Any]:
    """A callback that refuses numbers outside `low` to `high`, and NaN; `above`: `low` itself is refused too."""

    def check(value: Any) -> Any:
        if value is None:
            return None
        for number in value if isinstance(value, list | tuple) else (value,):
            if not low <= number <= high or (above and number == low):
                raise typer.BadParameter(f"expected {span(low, high, above=above)}, got {number:g}")
        return value

    return check


def span(low: float, high: float, *, above: bool = False) -> str:
    """The range in words: 0 to 1, above 0 up to 100000, 0 or more."""
    if high in (math.inf, MAX_SEED):
        return f"a number above {low:g}" if above else f"{low:g} or more"
    return f"above {low:g} up to {high:.15g}" if above else f"{low:g} to {high:.15g}"


def checked(check: Callable[[str], Any]) -> Callable[[Any], Any]:
    """A callback that refuses text for which `check` raises InvalidInput, with the error's message."""

    def callback(value: Any) -> Any:
        from he3.errors import InvalidInput

        try:
            return None if value is None else check(value)
        except InvalidInput as error:
            raise typer.BadParameter(str(error)) from None

    return callback


def check_one_format(csv: bool, json: bool) -> None:
    """Raise InvalidInput if both formats are asked for: one would be printed where the other is read."""
    from he3.errors import InvalidInput

    if csv and json:
        raise InvalidInput("expected one of --csv and --json, got both")


def _scenarios(incomplete: str) -> list[str]:
    """Names of shipped scenarios that begin so, for tab completion; the shell completes files by itself."""
    from services.mission.deployment import shipped_scenarios

    return [name for name in shipped_scenarios() if name.startswith(incomplete)]


def one_of(*words: str) -> Callable[[str], list[str]]:
    """The completion of a word out of these."""

    def completed(incomplete: str) -> list[str]:
        return [word for word in words if word.startswith(incomplete)]

    return completed


ScenarioRef = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="A scenario file, or the name of a shipped one such as t1.",
        autocompletion=_scenarios,
    ),
]
Seed = Annotated[
    int | None,
    typer.Option("--seed", metavar="N", help="Random seed (0 or more) instead of the scenario's.",
                 callback=within(0, MAX_SEED)),
]  # fmt: skip
Planner = Annotated[
    str | None,
    typer.Option(
        "--planner",
        metavar="NAME",
        help="rrt, rrtstar, informative, tour, or a plug-in as module:function, instead of the scenario's.",
        autocompletion=one_of("rrt", "rrtstar", "informative", "tour"),
    ),
]
AllowPlugin = Annotated[
    bool,
    typer.Option(
        "--allow-plugin",
        help="Run the code of a planner module:function that the scenario's file names; "
        "a planner from --planner or --set is always run.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Change a scenario value, such as ground.pipeline=2 or link.up.loss=0.1."
    ),
]
Rate = Annotated[
    float | None,
    typer.Option("--rate", metavar="R", help=f"Simulation speed: mission seconds per wall second, up to {MAX_RATE:g}.",
                 callback=within(0, MAX_RATE, above=True)),
]  # fmt: skip
OutFolder = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Folder for report.json, map.png, rmse.png and mission.mcap."),
]
ReportFile = Annotated[Path | None, typer.Option("--report", metavar="FILE", help="File for the report (JSON).")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]
AsJsonLines = Annotated[bool, typer.Option("--json", help="Print JSON documents instead of text, one a line.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress on standard error.")]
Keys = Annotated[
    Path | None,
    typer.Option(
        "--keys",
        metavar="DIR",
        help="The mission's keys (he3 keys init), for TLS and access rules.",
    ),
]
Lockstep = Annotated[
    bool, typer.Option("--lockstep", help="Separate processes in virtual time: exact, repeatable, as fast as possible.")
]

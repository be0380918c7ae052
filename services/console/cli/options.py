"""Flags that several commands share, described once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ScenarioRef = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="A scenario file, or the name of a shipped one such as t1.")
]
Seed = Annotated[int | None, typer.Option("--seed", metavar="N", help="Seed, instead of the scenario's.")]
Planner = Annotated[
    str | None,
    typer.Option(
        "--planner", metavar="NAME", help="rrt, rrtstar, informative, tour, or your own module:function, instead."
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Another value, such as ground.pipeline=2 or link.up.loss=0.1."),
]
Rate = Annotated[float | None, typer.Option("--rate", metavar="R", help="Mission seconds a wall second.")]
OutFolder = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Folder for report.json, map.png, rmse.png and mission.mcap."),
]
ReportFile = Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Where the report goes.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress on standard error.")]
Mission = Annotated[str | None, typer.Option("--mission", metavar="NAME", help="Which running mission is meant.")]
Earth = Annotated[
    str | None, typer.Option("--earth", metavar="ENDPOINT", help="Its Earth router, such as tcp/10.0.0.2:7448.")
]
Lockstep = Annotated[
    bool, typer.Option("--lockstep", help="Separate processes in virtual time: exact, repeatable, as fast as it goes.")
]

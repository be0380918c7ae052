"""``he3 demo``: the main job, for somebody who has just arrived."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.console.cli.options import AsJson, Quiet, Seed, Settings
from services.console.cli.run import run_and_report

SCENARIO = "t1-nominal"
OUT = Path("runs") / "demo"

ABOUT = """Mission '{mission}': rover and field on the Moon, ground station and recorder on Earth, and the link between.
Each is a process of its own, in virtual time: every delay is exact, and days take as long as planning them does.
Look in from another terminal with: he3 status, he3 watch, he3 map show mean, he3 link show, he3 time show
"""

EXAMPLES = """\b
Examples:
  he3 demo                                the mission, its report and pictures
  he3 demo --set ground.planner=tour      with the planner that drives least
"""


def demo(
    seed: Seed = None,
    settings: Settings = None,
    rate: Annotated[
        float | None,
        typer.Option("--rate", metavar="R", help="On the wall clock instead: mission seconds a wall second, say 4000."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for everything that it leaves.")] = OUT,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """A whole mission: 150 holes on the Moon, five processes, Earth 1.28 s away."""
    from services.console.launch.scenarios import choose

    chosen = choose(SCENARIO, seed=seed, rate=rate, settings=settings or ())
    if not (json or quiet):
        typer.echo(ABOUT.format(mission=chosen.scenario.name), err=True)
    run_and_report(chosen, "lockstep" if rate is None else "zenoh", out, None, json=json, quiet=quiet)

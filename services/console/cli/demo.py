"""``he3 demo``: the whole system in one command, for a first look."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from he3.errors import He3Error
from services.console.cli.options import MAX_RATE, AsJson, Quiet, Seed, Settings, within
from services.console.cli.run import run_and_report

if TYPE_CHECKING:
    from schemas.report import MissionReport
    from services.console.launch.baseline import Baseline

SCENARIO = "t1"
PUBLISHED = "t1-paper"
OUT = Path("runs") / "demo"

ABOUT = """Mission '{mission}': rover and field on the Moon, ground station and recorder on Earth, and the link between.
Each is a separate process in virtual time: every delay is exact, and a mission of days takes minutes.
From another terminal: he3 status, he3 watch, he3 map show mean, he3 link show, he3 time show
"""

EXAMPLES = """\b
Examples:
  he3 demo                                          the mission, its report and pictures
  he3 demo --seed 7                                 other measurement errors, other choices
  he3 demo --set ground.planner=informative         with another planner
  he3 demo --no-compare                             without the published protocol beside it
"""


def demo(
    seed: Seed = None,
    settings: Settings = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            metavar="R",
            help="On the wall clock instead: mission seconds a wall second, such as 4000.",
            callback=within(0, MAX_RATE, above=True),
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for report, pictures and recording.")] = OUT,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare/--no-compare", help="Also run the published protocol with the same seed, at low priority."
        ),
    ] = True,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run a whole mission: 150 samples, five processes, a one-way light time of 1.28 s."""
    from services.console.launch.baseline import Baseline
    from services.console.launch.scenarios import choose

    chosen = choose(SCENARIO, seed=seed, rate=rate, settings=settings or ())
    if not (json or quiet):
        typer.echo(ABOUT.format(mission=chosen.scenario.name), err=True)
    # What the user sets of the ground is the difference to show; everything else is set for both missions.
    shared = [text for text in settings or () if not text.startswith("ground.")]
    beside = Baseline(PUBLISHED, chosen.scenario.seed, shared) if compare and not json else None
    with beside if beside is not None else nullcontext():
        report = run_and_report(chosen, "lockstep" if rate is None else "zenoh", out, None, json=json, quiet=quiet)
        if beside is not None:
            _compare(report, beside, quiet)


def _compare(report: MissionReport, beside: Baseline, quiet: bool) -> None:
    """Print the line that compares the mission with the published protocol, or the reason why there is none."""

    def show(line: str) -> None:
        if not quiet:
            typer.echo(f"{beside.scenario}: {line}", err=True)

    try:
        published = beside.report(show)
    except He3Error as error:
        typer.echo(f"no comparison with the published protocol: {error}", err=True)
        return
    typer.echo(comparison_line(report, published))


def comparison_line(report: MissionReport, published: MissionReport) -> str:
    """Error and metres of a mission and of the published protocol on one line."""
    return (
        f"{report.planner}: {_figures(report)}; "
        f"published protocol ({published.scenario}, same seed): {_figures(published)}"
    )


def _figures(report: MissionReport) -> str:
    error = "" if report.rmse_ppb is None else f"{report.rmse_ppb:.2f} ppb after "
    return f"{error}{report.path_length_m / 1000:.1f} km"

"""``he3 run`` and ``he3 demo``: a whole mission, from its scenario to its report."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from he3.errors import He3Error, InvalidInput
from services.console.cli.flag_groups import with_flags
from services.console.cli.mission_flags import MissionFlags
from services.console.cli.options import (
    MAX_RATE,
    AsJson,
    Lockstep,
    OutFolder,
    Quiet,
    ReportFile,
    ScenarioRef,
    Seed,
    Settings,
    within,
)

if TYPE_CHECKING:
    from schemas.report import MissionReport
    from services.console.launch.baseline import Baseline
    from services.console.launch.scenarios import Chosen

EXAMPLES = """\b
Examples:
  he3 run t1 --in-process --out runs/t1             # one process, virtual time
  he3 run t1 --lockstep --out runs/t1               # five processes, virtual time
  he3 run t1 --rate 2000 --out runs/t1              # five processes, wall clock
  he3 run my.toml --in-process --planner tour --seed 7 --report tour-7.json
  he3 run short --in-process --set link.down.loss=0.3 --json
"""

DEMO_SCENARIO = "t1"
PUBLISHED = "t1-paper"
DEMO_OUT = Path("runs") / "demo"

DEMO_ABOUT = """Mission '{mission}': rover and field on the Moon, ground station and recorder on Earth, and the link.
Each is a separate process in virtual time: every delay is exact, and a mission of days takes minutes.
From another terminal: he3 status, he3 watch, he3 map show mean, he3 link show, he3 time show
"""

SECURE_ABOUT = """Its keys are in {keys} and are deleted at its end. Each process has its own key; the routers deny all
other clients. To command it: he3 command pause --identity {keys}/identities/operator-demo
"""

DEMO_EXAMPLES = """\b
Examples:
  he3 demo                                          # the mission, its report and pictures
  he3 demo --seed 7                                 # other measurement errors, other choices
  he3 demo --set ground.planner=informative         # with another planner
  he3 demo --secure                                 # with TLS and temporary keys
  he3 demo --no-compare                             # without the published protocol beside it
"""

EventsFile = Annotated[
    Path | None,
    typer.Option(
        "--events", metavar="FILE", help="File for the event log, in virtual time; the same for every driver."
    ),
]
InProcess = Annotated[
    bool, typer.Option("--in-process", help="All services in this process, in virtual time: exact, and fastest.")
]


@with_flags
def run(
    flags: MissionFlags,
    scenario: ScenarioRef,
    in_process: InProcess = False,
    lockstep: Lockstep = False,
    report: ReportFile = None,
    out: OutFolder = None,
    events: EventsFile = None,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run a whole mission and report on it."""
    if sum((in_process, lockstep, flags.rate is not None)) > 1:
        raise InvalidInput("expected one of --in-process, --lockstep and --rate, got more")
    if events is not None and not (in_process or lockstep):
        raise InvalidInput(
            "--events: expected it with --in-process or --lockstep, where every event has its exact time"
        )
    if in_process and flags.keys is not None:
        raise InvalidInput("--keys: expected it with separate processes, got --in-process, which opens no connection")
    driver = "in-process" if in_process else "lockstep" if lockstep else "zenoh"
    run_and_report(flags.chosen(scenario), driver, out, report, json=json, quiet=quiet, events=events)


def run_and_report(
    chosen: Chosen,
    driver: str,
    out: Path | None,
    report: Path | None,
    *,
    json: bool,
    quiet: bool,
    events: Path | None = None,
) -> MissionReport:
    """Run the chosen scenario with that driver: show its progress, write its files, print and return its report.

    A picture or a recording that could not be written is reported on standard error; it is no failure. Raises He3Error,
    after all of that, if the report could not be written, for a mission that failed, and for one that took no sample:
    its map has no information on the site.
    """
    from schemas.wire import printable
    from services.console.client.time_format import speed
    from services.console.report.outputs import outputs
    from services.console.report.progress import progress_for
    from services.console.report.summary import summary_lines

    mission = chosen.scenario
    where = outputs(out, report, events)
    how = {
        "in-process": "in this process, virtual time",
        "lockstep": "separate processes, virtual time",
        "zenoh": f"separate processes, simulation speed {speed(mission.rate)}",
    }[driver]
    title = f"{mission.name} · {mission.region} · {mission.ground.planner} · seed {mission.seed}"
    progress = progress_for(title, how, quiet)
    if driver == "in-process":
        from services.console.launch.in_process import run_in_process

        scores_rounds = json or not quiet or where.report is not None
        written = run_in_process(mission, where, progress, events, scores_rounds=scores_rounds)
    else:
        from services.console.launch.separate import run_separate

        written = run_separate(chosen, where, progress, driver == "lockstep", events)
    done = written.report
    typer.echo(done.model_dump_json(indent=2) if json else "\n".join(summary_lines(done, written.files)))
    for problem in done.output_problems:
        typer.echo(f"he3: {printable(problem)}", err=True)
    if written.report_error is not None:
        raise written.report_error
    if not done.completed:
        raise He3Error(f"the mission failed {done.mission_time_s:.0f} s after its beginning: {done.detail}")
    if done.samples == 0:
        raise He3Error(f"the mission took no sample: {done.detail or 'the ground gives no reason'}")
    return done


def demo(
    seed: Seed = None,
    settings: Settings = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            metavar="R",
            help="Run on the wall clock at this simulation speed: mission seconds per wall second, such as 4000.",
            callback=within(0, MAX_RATE, above=True),
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for report, pictures and recording.")
    ] = DEMO_OUT,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare/--no-compare", help="Also run the published protocol with the same seed, at low priority."
        ),
    ] = True,
    secure: Annotated[
        bool, typer.Option("--secure", help="Use temporary keys: TLS, and access rules for each process.")
    ] = False,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run a whole mission: 150 samples, five processes, a one-way light time of 1.28 s."""
    from services.console.launch.keys import temporary_keys
    from services.console.launch.scenarios import choose

    with temporary_keys() if secure else nullcontext() as keys:
        chosen = choose(DEMO_SCENARIO, seed=seed, rate=rate, settings=settings or (), keys=keys)
        if not (json or quiet):
            typer.echo(DEMO_ABOUT.format(mission=chosen.scenario.name), err=True)
            if keys is not None:
                typer.echo(SECURE_ABOUT.format(keys=keys), err=True)
        _demonstrate(chosen, settings or (), out, compare=compare, wall_clock=rate is not None, json=json, quiet=quiet)


def _demonstrate(
    chosen: Chosen, settings: Sequence[str], out: Path, *, compare: bool, wall_clock: bool, json: bool, quiet: bool
) -> None:
    """Run the mission, and the published protocol beside it; print the line that compares the two."""
    from services.console.launch.baseline import Baseline

    # What the user sets of the ground is the difference to show; everything else is set for both missions.
    shared = [text for text in settings if not text.startswith("ground.")]
    beside = Baseline(PUBLISHED, chosen.scenario.seed, shared) if compare and not json else None
    with beside if beside is not None else nullcontext():
        report = run_and_report(chosen, "zenoh" if wall_clock else "lockstep", out, None, json=json, quiet=quiet)
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

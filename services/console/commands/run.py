"""``he3 run``: a whole mission, from its scenario to its report."""

from __future__ import annotations

from typing import Annotated

import typer

from he3.errors import InvalidInput
from services.console.commands.options import (
    AsJson,
    OutFolder,
    Planner,
    Quiet,
    Rate,
    ReportFile,
    ScenarioRef,
    Seed,
    Settings,
)

EXAMPLES = """\b
Examples:
  he3 run t1-nominal --in-process --out runs/t1     here, in virtual time
  he3 run t1-nominal --rate 2000 --out runs/t1      five processes over Zenoh
  he3 run my.toml --in-process --planner tour --seed 7 --report tour-7.json
  he3 run short --in-process --set link.down.loss=0.3 --json
"""


def run(
    scenario: ScenarioRef,
    in_process: Annotated[
        bool, typer.Option("--in-process", help="All services in this process, in virtual time: exact and fast.")
    ] = False,
    rate: Rate = None,
    seed: Seed = None,
    planner: Planner = None,
    settings: Settings = None,
    report: ReportFile = None,
    out: OutFolder = None,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run a whole mission and report on it."""
    from services.console.outputs import outputs
    from services.console.progress import progress_for
    from services.console.scenarios import choose
    from services.console.summary import summary_lines

    if in_process and rate is not None:
        raise InvalidInput("--rate: expected it without --in-process, which runs in virtual time")
    chosen = choose(scenario, seed=seed, planner=planner, rate=rate, settings=settings or ())
    mission = chosen.scenario
    where = outputs(out, report)
    progress = progress_for(
        f"{mission.name} · {mission.region} · {mission.ground.planner} · seed {mission.seed}",
        "in this process, virtual time" if in_process else f"separate processes, rate {mission.rate:g}",
        quiet,
    )
    if in_process:
        from services.console.in_process import run_in_process

        done, files = run_in_process(mission, where, progress)
    else:
        from services.console.separate import run_separate

        done, files = run_separate(chosen, where, progress)
    if json:
        typer.echo(done.model_dump_json(indent=2))
    else:
        typer.echo("\n".join(summary_lines(done, files)))

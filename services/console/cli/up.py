"""``he3 up``: start the services and keep them running until Ctrl-C."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.mission_flags import MissionFlags
from services.console.cli.options import (
    Lockstep,
    OutFolder,
    Quiet,
    ScenarioRef,
)

if TYPE_CHECKING:
    from services.console.report.outputs import Written

EXAMPLES = """\b
Examples:
  he3 up t1                           # in real time, at the endpoints of the scenario
  he3 up t1 --rate 100 &              # then: he3 status; he3 map at 120 340
  he3 up t1 --lockstep &              # in virtual time: he3 time pause; he3 time step; he3 time rate 100
  he3 up t1 --rate 500 --out runs/a   # with recording, report and pictures in runs/a
  he3 up t1 --journal j/              # a mission that continues after a restart
  he3 up t1 --keys keys/              # with TLS and access rules (made by he3 keys init keys/)
"""

LOOK_EVERY_S = 0.2

JournalFolder = Annotated[
    Path | None,
    typer.Option("--journal", metavar="DIR", help="Folder of the journals; the mission continues from them."),
]


@with_flags
def up(
    flags: MissionFlags,
    scenario: ScenarioRef,
    lockstep: Lockstep = False,
    out: OutFolder = None,
    journal: JournalFolder = None,
    quiet: Quiet = False,
) -> None:
    """Start the services and keep them running; Ctrl-C stops all. Without --out nothing is recorded.

    With --out, report and pictures are written when the mission is over.
    """
    import time

    from services.console.client.mission_client import MissionClient
    from services.console.launch.endpoints import endpoints_of, require_free
    from services.console.launch.separate import checked_region, outcome_of, services_of
    from services.console.report.outputs import claimed, outputs, write_outcome

    chosen = flags.chosen(scenario)
    mission = chosen.scenario
    endpoints = endpoints_of(chosen)
    viewer = None if chosen.keys is None else chosen.keys.viewer
    where = outputs(out, None)
    region = checked_region(mission)
    services = services_of(
        chosen, where, endpoints, lockstep=lockstep, pace=flags.rate, journal=journal, log_to_terminal=not quiet
    )
    began = time.monotonic()
    with claimed(where, journal=journal):
        # First what the user named: an output in use is refused even if the endpoints are in use, too.
        require_free(endpoints)
        with (
            services as (launcher, _),
            MissionClient.when_up(
                endpoints.earth, mission.name, launcher.check, identity=viewer, insecure=flags.insecure
            ) as client,
        ):
            client.wait_for_ground(launcher.check)
            typer.echo(
                f"mission '{mission.name}' is up: Earth at {endpoints.earth}, Moon at {endpoints.moon}; "
                "Ctrl-C stops it",
                err=True,
            )
            state = None if out is None else client.state(start_ns=mission.start_ns)
            while True:
                for line in launcher.check_vital():
                    typer.echo(f"he3: {line}", err=True)
                status = None if state is None else state.status
                if state is not None and status is not None and status.is_over:
                    outcome = outcome_of(client, state, status, mission, region, began, lockstep)
                    written = write_outcome(outcome, region, where, None, ())
                    for line in over_lines(mission.name, status.phase.value, written):
                        typer.echo(f"he3: {line}", err=True)
                    state = None
                time.sleep(LOOK_EVERY_S)


def over_lines(mission: str, phase: str, written: Written) -> list[str]:
    """Lines on a mission that is over while its services still run: its files, and what could not be written."""
    from schemas.wire import printable

    files = ", ".join(str(path) for path in written.files if path.suffix != ".mcap") or "no report"
    problems = [printable(problem) for problem in written.report.output_problems]
    if written.report_error is not None:
        problems.append(str(written.report_error))
    return [f"mission '{mission}' is over ({phase}): wrote {files}; its services still answer", *problems]

"""The ``he3`` command line: its commands and their place in the help."""

from __future__ import annotations

from typing import Annotated

import typer

from services.console.cli import (
    alarms,
    area,
    audit,
    authority,
    bench,
    campaign,
    command,
    foxglove,
    keys,
    link,
    log,
    map,
    plan,
    recording,
    region,
    rehearse,
    replay,
    run,
    schemas,
    stack,
    status,
    time,
    up,
    watch,
    web,
)

ABOUT = """Helium-3 prospecting on the Moon: a rover, a map with its uncertainty, and the light time to Earth.

Start with: he3 demo
"""


def build() -> typer.Typer:
    """The command line application; building it imports no slow module."""
    app = typer.Typer(
        name="he3",
        help=ABOUT,
        invoke_without_command=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )
    app.callback()(_common)
    app.command("demo", short_help="Run a demonstration mission.", epilog=run.DEMO_EXAMPLES)(run.demo)
    app.command("run", short_help="Run a whole mission and report on it.", epilog=run.EXAMPLES)(run.run)
    app.add_typer(campaign.app, name="campaign", help="Thousands of missions from one study: fly them, report on them.")
    app.command("up", short_help="Start the services and keep them running.", epilog=up.EXAMPLES)(up.up)
    app.command("status", short_help="Show processes, rover, map and link.", epilog=status.EXAMPLES)(status.status)
    app.command("rehearse", epilog=rehearse.EXAMPLES, short_help="Fly the rest of the mission ahead.")(
        rehearse.rehearse
    )
    app.command("log", epilog=log.EXAMPLES, short_help="Show what happened and what was changed.")(log.log)
    app.command("watch", short_help="Follow a running mission.", epilog=watch.EXAMPLES)(watch.watch)
    app.command("web", short_help="Serve the operator's page for a browser.", epilog=web.EXAMPLES)(web.web)
    app.add_typer(map.app, name="map", help="The live map: a place, a picture, files, tables, an area.")
    app.add_typer(
        time.app, name="time", help="Mission time: show it, pause it, step it, limit its speed.", epilog=time.EXAMPLES
    )
    app.command("foxglove", short_help="Stream a mission to Foxglove.", epilog=foxglove.EXAMPLES)(foxglove.foxglove)
    app.add_typer(link.app, name="link", help="The link between Earth and Moon: show it, change it.")
    app.add_typer(command.app, name="command", help="Send the rover a telecommand.")
    app.add_typer(area.app, name="area", help="Keep-outs and areas of interest: list, add, rename, remove.")
    app.command("commands", short_help="List the telecommands and their stages.", epilog=command.EXAMPLES)(
        command.commands
    )
    app.add_typer(alarms.app, name="alarms", help="What needs attention: show it, acknowledge it, shelve it.")
    app.add_typer(stack.app, name="stack", help="A list of telecommands with conditions: check it, send it.")
    app.add_typer(keys.app, name="keys", help="Certificates: who may connect, and as what.", epilog=keys.EXAMPLES)
    app.add_typer(plan.app, name="plan", help="A plan that waits for approval: show, approve, revise it.")
    app.add_typer(authority.app, name="authority", help="Who commands the rover: show it, take it, release it.")
    app.add_typer(audit.app, name="audit", help="The audit log: who did what.", epilog=audit.EXAMPLES)
    app.add_typer(region.app, name="region", help="Regions: show them, build them from rasters, fetch real ones.")
    app.add_typer(region.app, name="reference", hidden=True)  # the former name: scripts use it, an error stays one line
    app.command("replay", short_help="Summarise a recording.", epilog=replay.EXAMPLES)(replay.replay)
    app.add_typer(recording.app, name="recording", help="The file of a recording: repair it.")
    app.command("schemas", epilog=schemas.EXAMPLES, short_help="Print the JSON Schema of every message.")(
        schemas.schemas
    )
    app.add_typer(bench.app, name="bench", help="Benchmarks against the paper, other software, the machine.")
    return app


def _show_version(wanted: bool) -> None:
    """Print the version and exit. It is the flag's callback, so that no command is needed."""
    if wanted:
        from services.runtime.heartbeat import software_version

        typer.echo(f"he3-seeker {software_version()}")
        raise typer.Exit


def _common(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Flags of the command itself; without a command, what to do next."""
    if context.invoked_subcommand is None:
        from services.console.cli.next_steps import next_steps
        from services.console.client.run_file import running_missions

        typer.echo(next_steps(running_missions()), nl=False)

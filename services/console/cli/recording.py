"""``he3 recording``: what is done with the file of a recording."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import Annotated

import typer

from services.console.cli.options import AsJson

EXAMPLES = """\b
Examples:
  he3 recording repair runs/t1/mission.mcap            # after a recorder was killed
"""

app = typer.Typer(no_args_is_help=True)


@app.command(short_help="Complete the file that a killed recorder left.", epilog=EXAMPLES)
def repair(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording: mission.mcap.")], json: AsJson = False
) -> None:
    """Complete a recording with index and summary, so that every program opens it. All whole records stay.

    A complete file is left as it is. Where records in the middle are damaged, the file as it was is kept beside it, as
    FILE-damaged-1.mcap. Exit code 1 if records were lost, as far as the file tells.
    """
    from dataclasses import asdict

    from services.recorder.repair import repair as repaired

    done = repaired(file)
    if json:
        typer.echo(json_format.dumps(asdict(done), indent=2, default=str))
    elif not done.repaired:
        typer.echo(f"complete   {done.file}: {done.messages} messages, nothing to repair")
    else:
        typer.echo(f"repaired   {done.file}: {done.messages} messages")
        for line in done.repaired:
            typer.echo(f"completed  {line}" if line not in done.lost else f"lost       {line}")
        for line in done.lost:
            if line not in done.repaired:
                typer.echo(f"missing    {line}")
        if done.kept is not None:
            typer.echo(f"kept       the file as it was: {done.kept}")
    if done.lost:
        raise typer.Exit(1)

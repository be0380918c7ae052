"""``he3 rehearse``: the rest of the live mission flown ahead, and what is to be expected of it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson, Quiet, within
from services.console.cli.session import Session

if TYPE_CHECKING:
    from services.console.rehearsal.flight import Flight

EXAMPLES = """\b
Examples:
  he3 rehearse                      when the mission ends, how far it drives, how certain its map will be
  he3 rehearse --draws 40 --json
"""

Draws = Annotated[
    int,
    typer.Option("--draws", metavar="N", help="Number of rehearsals, each on another draw from the posterior.",
                 callback=within(2, 200)),
]  # fmt: skip


@with_flags
def rehearse(
    session: Session,
    draws: Draws = 10,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Fly the rest of the live mission ahead in virtual time, and say what is to be expected.

    The live mission is asked for a copy of its state and is not touched. Each rehearsal has its own measurements, drawn
    from the posterior, and hidden hazards and losses on the link of its own.
    """
    import json as json_format

    from services.console.rehearsal.flight import Start
    from services.console.rehearsal.forecast import rehearse as flown

    with session.join() as client:
        name = f"{client.mission} at {client.earth}"
        under_way = tuple(status.command for status in client.commands() if status.end is None)
        start = Start(client.fork(), client.link(), under_way)
    done = 0

    def report(_: Flight) -> None:
        nonlocal done
        done += 1
        if not quiet and sys.stderr.isatty():
            typer.echo(f"\r{done} of {draws} rehearsals", nl=done == draws, err=True)

    forecast = flown(start, draws, report)
    if json:
        typer.echo(json_format.dumps({"mission": name, **forecast.document()}, indent=2))
        return
    for row, text in (("mission", name), *forecast.rows()):
        typer.echo(f"{row:<10} {text}")

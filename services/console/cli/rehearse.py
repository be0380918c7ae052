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
  he3 rehearse                      # when the mission ends, how far it drives, how certain its map will be
  he3 rehearse --against "planner informative"
  he3 rehearse --against "keep-out crater 100,100 150,100 125,150" --draws 20
  he3 rehearse --draws 40 --json
"""

Draws = Annotated[
    int,
    typer.Option("--draws", metavar="N", help="Number of rehearsals, each on another draw from the posterior.",
                 callback=within(2, 200)),
]  # fmt: skip
Against = Annotated[
    str | None,
    typer.Option("--against", metavar="ALTERNATIVE",
                 help="Rehearse this beside the mission as planned: 'planner NAME', commands as of he3 command, or "
                 "both, with ; between them. Nothing is sent."),
]  # fmt: skip


@with_flags
def rehearse(
    session: Session,
    draws: Draws = 10,
    against: Against = None,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Fly the rest of the live mission ahead in virtual time, and say what is to be expected.

    The live mission is asked for a copy of its state and is not touched. Each rehearsal has its own measurements, drawn
    from the posterior, and hidden hazards and losses on the link of its own. With --against, an alternative is
    rehearsed beside it.
    """
    import json as json_format

    from services.console.rehearsal.alternative import alternatives_of
    from services.console.rehearsal.forecast import compared, start_of
    from services.console.rehearsal.forecast import rehearse as flown

    alternatives = alternatives_of(against)
    with session.join() as client:
        name = f"{client.mission} at {client.earth}"
        start = start_of(client)
    done, flights = 0, draws * len(alternatives)

    def report(_: Flight) -> None:
        nonlocal done
        done += 1
        if not quiet and sys.stderr.isatty():
            typer.echo(f"\r{done} of {flights} rehearsals", nl=done == flights, err=True)

    forecast, *others = flown(start, draws, report, alternatives=alternatives)
    if json:
        documents = [{**other.document(), "more": other.differences(forecast)} for other in others]
        typer.echo(json_format.dumps({"mission": name, **forecast.document(), "against": documents}, indent=2))
        return
    rows = [("mission", name), *forecast.rows()]
    if others:
        rows = [("mission", name), *forecast.notes(), ("draws", forecast.drawn())]
        table = compared(forecast, others[0])
        widths = [max(len(row[column]) for row in table) for column in range(4)]
        for cells in table:
            typer.echo("  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())
        typer.echo()
    for row, text in rows:
        typer.echo(f"{row:<10} {text}")

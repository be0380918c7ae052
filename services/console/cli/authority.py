"""``he3 authority``: who commands the rover, one person at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson
from services.console.cli.session import NamedSession, Session

if TYPE_CHECKING:
    from schemas.authority import AuthorityState

EXAMPLES = """\b
Examples:
  he3 authority show
  he3 authority take                              # from now on, others' commands are refused; but 'safe' never is
  he3 authority take --force operator.ben         # take it over from ben, who holds it
  he3 authority release
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command(epilog=EXAMPLES)
@with_flags
def show(
    session: Session,
    json: AsJson = False,
) -> None:
    """Show who holds command authority."""

    with session.join() as client:
        _show(client.authority(), json)


@app.command(epilog=EXAMPLES)
@with_flags
def take(
    session: NamedSession,
    force: Annotated[
        str | None,
        typer.Option("--force", metavar="HOLDER", help="Take it over from this present holder, named in full."),
    ] = None,
    json: AsJson = False,
) -> None:
    """Take command authority."""

    with session.join() as client:
        _show(client.take_authority(force), json)


@app.command(short_help="Release command authority.", epilog=EXAMPLES)
@with_flags
def release(
    session: NamedSession,
    json: AsJson = False,
) -> None:
    """Release command authority; the sender of the next command becomes its holder."""

    with session.join() as client:
        _show(client.release_authority(), json)


def _show(state: AuthorityState, json: bool) -> None:
    from services.console.client.time_format import utc

    if json:
        typer.echo(state.model_dump_json(indent=2))
    elif state.holder is None:
        typer.echo("no one holds command authority")
    else:
        how = "taken" if state.explicit else "by commanding"
        typer.echo(
            f"{state.holder} holds command authority{f' since {utc(state.since)}' if state.since else ''} ({how})"
        )

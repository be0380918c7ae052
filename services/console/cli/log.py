"""``he3 log``: what happened, what was commanded and changed, and by whom."""

from __future__ import annotations

from typing import Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson, check_one_format, checked, one_of
from services.console.cli.session import Session

EXAMPLES = """\b
Examples:
  he3 log                                   # all of it, oldest first
  he3 log --kind command --kind link        # what was commanded, and what changed on the link
  he3 log --since 2h --text safe
  he3 log --csv > log.csv
  he3 log --json | jq '.[] | select(.by != "")'
"""

KINDS = ("event", "command", "link", "alarm", "plan", "decision", "interest", "authority", "goal")


def _kind(words: list[str] | None) -> list[str] | None:
    for word in words or ():
        if word not in KINDS:
            raise typer.BadParameter(f"expected one of {', '.join(KINDS)}; got '{word[:80]}'")
    return words


def _since(text: str) -> str:
    from services.console.client.time_format import parse_moment

    parse_moment(text, 0)
    return text


@with_flags
def log(
    session: Session,
    kind: Annotated[
        list[str] | None,
        typer.Option("--kind", metavar="KIND", help=f"Only {', '.join(KINDS)}; repeatable.", callback=_kind,
                     autocompletion=one_of(*KINDS)),
    ] = None,
    since: Annotated[
        str | None,
        typer.Option("--since", metavar="TIME", help="Since 2h after the beginning, or since a time in UTC.",
                     callback=checked(_since)),
    ] = None,
    text: Annotated[str, typer.Option("--text", metavar="TEXT", help="Only lines with this text (case ignored).")] = "",
    csv: Annotated[bool, typer.Option("--csv", help="Print comma-separated values.")] = False,
    json: AsJson = False,
) -> None:  # fmt: skip
    """Show the log: events, commands with their stages, plans, the link, interests, authority, alarms."""
    import json as json_format

    check_one_format(csv, json)
    from schemas.mission_log import MissionLog
    from services.console.cli.alarms import alarms_of
    from services.console.client.log_lines import as_csv, chosen, documents, log_lines
    from services.console.client.time_format import parse_moment, utc

    with session.join() as client:
        start_ns = client.clock().start_ns
        kept: MissionLog = client.log()
        found = alarms_of(client, client.state())
        lines = log_lines(kept, client.commands(), client.link().events, (*found.history, *found.current))
    lines = chosen(lines, kind or (), None if since is None else parse_moment(since, start_ns), text)
    if json:
        typer.echo(json_format.dumps(documents(lines), indent=2))
    elif csv:
        typer.echo(as_csv(lines), nl=False)
    else:
        for line in lines:
            by = f"  by {line.by}" if line.by else ""
            typer.echo(f"{utc(line.at, 0)}  {line.kind:<9} {line.name.replace('_', ' '):<20} {line.text}{by}")

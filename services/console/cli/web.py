"""``he3 web``: the operator's page in a browser."""

from __future__ import annotations

from typing import Annotated

import typer

from services.console.cli.options import Earth, Mission

EXAMPLES = """\b
Examples:
  he3 web                              look on: http://127.0.0.1:8030
  he3 web --authority                  command the rover and set the link from the page
  he3 web --bind 0.0.0.0 --allow-host moonbase.lan      for other machines; there is no password
"""


def web(
    port: Annotated[int, typer.Option("--port", metavar="N", help="Where it listens; 0 takes a free one.")] = 8030,
    bind: Annotated[str, typer.Option("--bind", metavar="ADDRESS", help="Loopback unless you say so.")] = "127.0.0.1",
    authority: Annotated[bool, typer.Option("--authority", help="Let the page send commands.")] = False,
    allow_host: Annotated[
        list[str] | None, typer.Option("--allow-host", metavar="NAME", help="Another name to be reached by.")
    ] = None,
    mission: Mission = None,
    earth: Earth = None,
) -> None:
    """Serve the operator's page: the live map, rover, link, commands and alarms. Read-only without --authority."""
    from services.console.client.mission_client import MissionClient
    from services.console.web.running import serve

    with MissionClient(earth, mission, name="web") as client:
        serve(client, bind, port, authority, tuple(allow_host or ()), lambda line: typer.echo(line, err=True))

"""``he3 web``: the operator's page in a browser."""

from __future__ import annotations

from typing import Annotated

import typer

from services.console.cli.options import Earth, IdentityFolder, Insecure, Mission, checked, within

EXAMPLES = """\b
Examples:
  he3 web                              the page at http://127.0.0.1:8030/
  he3 web --authority                  command the rover and change the link from the page
  he3 web --bind 0.0.0.0 --allow-host moonbase.lan      for other machines; there is no password
"""

MAX_PORT = 65_535


def _host(text: str) -> str:
    from services.console.web.address import host_name

    return host_name(text)


def _hosts(texts: list[str] | None) -> list[str]:
    return [checked(_host)(text) for text in texts or ()]


def web(
    port: Annotated[
        int,
        typer.Option("--port", metavar="N", help="Port to listen on (0 to 65535); 0 takes a free one.",
                     callback=within(0, MAX_PORT)),
    ] = 8030,
    bind: Annotated[
        str, typer.Option("--bind", metavar="ADDRESS", help="Address to listen on, IPv4 or IPv6.")
    ] = "127.0.0.1",
    authority: Annotated[bool, typer.Option("--authority", help="Let the page send commands.")] = False,
    allow_host: Annotated[
        list[str] | None,
        typer.Option("--allow-host", metavar="NAME", help="Another name that browsers may reach the page by.",
                     callback=_hosts),
    ] = None,
    mission: Mission = None,
    earth: Earth = None,
    identity: IdentityFolder = None,
    insecure: Insecure = False,
) -> None:  # fmt: skip
    """Serve the operator's page: the live map, rover, link, commands and alarms. Read-only without --authority."""
    from services.console.client.mission_client import MissionClient
    from services.console.web.running import serve

    with MissionClient(earth, mission, name="web", identity=identity, insecure=insecure) as client:
        serve(client, bind, port, authority, tuple(allow_host or ()), lambda line: typer.echo(line, err=True))

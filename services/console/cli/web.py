"""``he3 web``: the operator's page in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from he3.errors import InvalidInput
from services.console.cli.flag_groups import with_flags
from services.console.cli.options import checked, within
from services.console.cli.session import Session

EXAMPLES = """\b
Examples:
  he3 web                              # the page at http://127.0.0.1:8030/
  he3 web --authority                  # the page may command and change the link
  he3 web --recording runs/a/mission.mcap                     # the same page over a recording, at any time of it
  he3 web --bind 0.0.0.0 --allow-host moonbase.lan --identity keys/identities/operator-anna     # for other machines
  he3 web --bind 10.0.0.2 --certificate page.pem --key page-key.pem --login-file logins
"""

MAX_PORT = 65_535


def _host(text: str) -> str:
    from services.console.web.address import host_name

    return host_name(text)


def _hosts(texts: list[str] | None) -> list[str]:
    return [checked(_host)(text) for text in texts or ()]


@with_flags
def web(
    session: Session,
    port: Annotated[
        int,
        typer.Option("--port", metavar="N", help="Port to listen on (0 to 65535); 0 takes a free one.",
                     callback=within(0, MAX_PORT)),
    ] = 8030,
    bind: Annotated[
        str, typer.Option("--bind", metavar="ADDRESS", help="Address to listen on, IPv4 or IPv6.")
    ] = "127.0.0.1",
    authority: Annotated[
        bool, typer.Option("--authority", help="Let the page command; off loopback, or with keys, after a login.")
    ] = False,
    allow_host: Annotated[
        list[str] | None,
        typer.Option("--allow-host", metavar="NAME", help="Another name that browsers may reach the page by.",
                     callback=_hosts),
    ] = None,
    certificate: Annotated[
        Path | None, typer.Option("--certificate", metavar="FILE", help="Serve over TLS with this certificate (PEM).")
    ] = None,
    key: Annotated[
        Path | None, typer.Option("--key", metavar="FILE", help="Key of the certificate (PEM, no password, mode 0600).")
    ] = None,
    page_identity: Annotated[
        Path | None,
        typer.Option("--page-identity", metavar="DIR",
                     help="Folder of the page's identity: its TLS, and people's certificates; else --identity's."),
    ] = None,
    login_file: Annotated[
        Path | None,
        typer.Option("--login-file", metavar="FILE", help="File for the addresses with logins; none is printed."),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option("--recording", metavar="FILE", help="Show this recording, mission.mcap, in place of a mission."),
    ] = None,
) -> None:  # fmt: skip
    """Serve the operator's page: the live map, rover, link, commands and alarms.

    On this machine it can be read without a login. With --authority it commands; where the mission has keys, or other
    machines can reach the page, that takes the address with a login that it prints, or a certificate.
    For other machines the page is served over TLS: with --identity, or with --certificate and --key.
    With --recording it shows a mission that was recorded, at any time and pace; a recording cannot be commanded.
    """
    from services.console.rehearsal.forecast import rehearse_live
    from services.console.web.identity import Tls
    from services.console.web.running import PageOptions, serve
    from services.runtime.trust.identity import load_identity

    if (certificate is None) != (key is None):
        raise InvalidInput("--certificate and --key: expected both or neither, got one")
    tls = None if certificate is None or key is None else Tls(certificate, key)
    own = None if page_identity is None else load_identity(page_identity)
    hosts = tuple(allow_host or ())
    if recording is not None:
        from schemas.wire import printable
        from services.console.replay.mission import RecordedMission

        if authority or session.mission is not None or session.earth is not None:
            raise InvalidInput("--recording: expected none of --authority, --mission and --earth, got one")
        options = PageOptions(bind, port, False, hosts, tls, own, insecure=session.insecure, login_file=login_file)
        with RecordedMission(recording) as recorded:
            for note in recorded.notes:
                typer.echo(f"he3: {printable(f'{recording}: {note}')}", err=True)
            serve(recorded, options, lambda line: typer.echo(line, err=True), recorded)
        return
    with session.join(name="web") as client:
        who = client.identity if own is None else own
        options = PageOptions(bind, port, authority, hosts, tls, who, insecure=session.insecure, login_file=login_file)
        serve(client, options, lambda line: typer.echo(line, err=True), rehearse=rehearse_live)

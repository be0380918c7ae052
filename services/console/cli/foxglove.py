"""``he3 foxglove``: a running mission for Foxglove, over its WebSocket protocol."""

from __future__ import annotations

from typing import Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.options import within
from services.console.cli.session import Session

EXAMPLES = """\b
Examples:
  he3 foxglove                    # then in Foxglove: Open connection, Foxglove WebSocket, ws://127.0.0.1:8765
  he3 foxglove --port 0           # at a free port, which it prints
"""

MAX_PORT = 65_535


@with_flags
def foxglove(
    session: Session,
    port: Annotated[
        int,
        typer.Option("--port", metavar="N", help="Port to listen on (0 to 65535); 0 takes a free one.",
                     callback=within(0, MAX_PORT)),
    ] = 8765,
    bind: Annotated[str, typer.Option("--bind", metavar="ADDRESS", help="IP address to listen on.")] = "127.0.0.1",
) -> None:  # fmt: skip
    """Stream a running mission to Foxglove: map, samples, paths, rover and log, to be seen and not to be commanded.

    The topics are those of a recording (docs/recordings.md), and so is the layout. The protocol has no login: every
    program of this machine, also a page in its browser, can read the stream. Off loopback it takes --insecure.
    """
    from services.console.foxglove_stream import check_loopback, stream

    warning = check_loopback(bind, session.insecure)
    with session.join(name="foxglove") as client:
        if warning is not None:
            typer.echo(f"he3 foxglove: {warning}", err=True)
        stream(client, bind, port, lambda line: typer.echo(line, err=True))

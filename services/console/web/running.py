"""Runs the page's server until it is told to stop."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import TYPE_CHECKING

from he3.errors import He3Error
from services.console.web.address import listening, own_names, url_of
from services.console.web.hub import Hub

if TYPE_CHECKING:
    from services.console.client.mission_client import MissionClient


def serve(
    mission: MissionClient,
    bind: str,
    port: int,
    authority: bool,
    other_hosts: tuple[str, ...],
    say: Callable[[str], None],
) -> None:
    """Serve until Ctrl-C; `say` is called with the line that has the page's address.

    other_hosts: further names of this server, each in the spelling of `host_name`. Raises InvalidInput for an address
    that is not this machine's, He3Error when the port is taken or packages are missing.
    """
    try:
        import uvicorn

        from services.console.web.server import page
    except ImportError as error:
        raise He3Error(f"he3 web needs {error.name}: pip install 'he3-seeker[console]'") from None
    listener = listening(bind, port)
    hosts = own_names(listener, bind) | frozenset(other_hosts)
    hub = Hub(mission, authority)
    hub.begin()
    config = uvicorn.Config(
        page(hub, sorted(hosts)), log_level="warning", ws="none", lifespan="off", timeout_graceful_shutdown=1
    )

    class PageServer(uvicorn.Server):
        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            hub.close()  # streams never end by themselves
            await super().shutdown(sockets)

    server = PageServer(config)
    role = "with command authority" if authority else "read-only; --authority lets it command"
    say(f"mission '{mission.mission}' at {url_of(listener, bind)} ({role}); Ctrl-C stops it")
    try:
        server.run(sockets=[listener])
    finally:
        hub.close()
        listener.close()

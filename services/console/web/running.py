"""Runs the page's server until it is told to stop."""

from __future__ import annotations

import socket
from collections.abc import Callable

from he3.errors import He3Error
from services.console.client.mission_client import MissionClient
from services.console.web.hub import Hub

OWN_NAMES = ("127.0.0.1", "localhost", "[::1]")


def serve(
    mission: MissionClient,
    bind: str,
    port: int,
    authority: bool,
    other_hosts: tuple[str, ...],
    say: Callable[[str], None],
) -> None:
    """Serve until Ctrl-C; `say` gets the address. Raises He3Error when the port is taken or packages are missing."""
    try:
        import uvicorn

        from services.console.web.server import page
    except ImportError as error:
        raise He3Error(f"he3 web needs {error.name}: pip install 'he3-seeker[console]'") from None
    listening = _listening(bind, port)
    hosts = {*OWN_NAMES, *other_hosts}
    if bind not in ("0.0.0.0", "::"):
        hosts.add(bind)
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
    shown = "127.0.0.1" if bind in ("0.0.0.0", "::") else bind
    say(
        f"mission '{mission.mission}' at http://{shown}:{listening.getsockname()[1]}/ "
        f"{'with command authority' if authority else '(looking on; --authority lets it command)'}; Ctrl-C stops it"
    )
    try:
        server.run(sockets=[listening])
    finally:
        hub.close()
        listening.close()


def _listening(bind: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in bind else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((bind, port))
    except OSError as error:
        listening.close()
        raise He3Error(f"cannot listen at {bind}:{port}: {error.strerror}; expected a free port (--port)") from None
    return listening

"""Runs the page's server until it is told to stop."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from he3.errors import He3Error, InvalidInput
from schemas.roles import Role
from services.console.web.access import READ, Access, Caller, no_certificates
from services.console.web.address import is_loopback, listening, own_names, urls_of
from services.console.web.hub import Hub
from services.console.web.identity import Tls, certified_by, tls_of
from services.runtime.files.output import failed, replace_output
from services.runtime.service_manager import ServiceManager

if TYPE_CHECKING:
    from services.console.client.mission_client import MissionClient
    from services.console.web.hub import Recording
    from services.console.web.rehearsals import Rehearse
    from services.runtime.trust.identity import Identity

UNSAFE = "INSECURE: no TLS; anyone on the network path can read the logins and command"
READERS, COMMANDERS = frozenset({Role.VIEWER}), frozenset({Role.VIEWER, Role.OPERATOR, Role.CONTROLLER})


@dataclass(frozen=True, slots=True)
class PageOptions:
    """Where and how the page is served."""

    bind: str
    port: int
    authority: bool = False
    """Whether a login with the right to command is issued."""
    other_hosts: tuple[str, ...] = ()
    """Further names of this server, each in the spelling of `host_name`."""
    tls: Tls | None = None
    identity: Identity | None = None
    """Identity of this server; people of its mission may log in by their certificates."""
    insecure: bool = False
    """Whether the page may be served without TLS off loopback."""
    login_file: Path | None = None
    """File for the addresses with tokens; None: they are printed."""


def serve(
    mission: MissionClient,
    options: PageOptions,
    say: Callable[[str], None],
    recording: Recording | None = None,
    rehearse: Rehearse | None = None,
) -> None:
    """Serve until Ctrl-C; `say` gets the lines with the page's addresses. recording, rehearse: see `Hub`.

    Raises InvalidInput for an address that is not this machine's or one off loopback without TLS, He3Error when the
    port is taken or packages are missing.
    """
    try:
        import uvicorn

        from services.console.web.connections import BoundedListener, allow_connections, protocol_of, share_heaps
        from services.console.web.server import page
    except ImportError as error:
        raise He3Error(f"he3 web needs {error.name}: pip install 'he3-seeker[console]'") from None
    with closing(listening(options.bind, options.port)) as raw:
        local = is_loopback(raw)
        tls, warning = _protection(options, local)
        tls_options = {} if tls is None else tls.options()
        access = Access(
            raw.getsockname()[1],
            anonymous=_without_login(options, mission, local and tls is None),
            able=_able(mission, recording),
            secure=tls is not None,
            certified=no_certificates if options.identity is None or tls is None else certified_by(options.identity),
        )
        hosts = own_names(raw, options.bind) | frozenset(options.other_hosts)
        urls = urls_of(raw, options.bind, "http" if tls is None else "https")
        allow_connections()
        share_heaps()
        with closing(BoundedListener(raw)) as listener:
            hub = Hub(mission, recording, rehearse)
            hub.begin()
            config = uvicorn.Config(
                page(hub, sorted(hosts), access, warning or mission.warning or mission.recording_note),
                http=protocol_of(listener),
                loop="asyncio",  # another loop would accept connections by itself
                log_level="error",
                access_log=False,
                server_header=False,
                proxy_headers=False,
                ws="none",
                lifespan="off",
                timeout_graceful_shutdown=1,
                **tls_options,
            )

            manager = ServiceManager()

            class PageServer(uvicorn.Server):
                async def startup(self, sockets: list[socket.socket] | None = None) -> None:
                    await super().startup(sockets)
                    manager.ready()

                async def on_tick(self, counter: int) -> bool:
                    manager.alive()  # ten times a second, from the loop that answers
                    return await super().on_tick(counter)

                async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
                    manager.stopping()
                    hub.close()  # streams never end by themselves
                    await super().shutdown(sockets)

            try:
                _announce(mission.mission, urls, access, options, say, warning, recording is not None)
                PageServer(config).run(sockets=[listener])
            finally:
                hub.close()


def _able(mission: MissionClient, recording: Recording | None) -> frozenset[Role]:
    """The rights of the server itself."""
    if recording is not None:
        return READERS
    return READ if mission.identity is None else frozenset({Role.VIEWER, mission.identity.role})


def _without_login(options: PageOptions, mission: MissionClient, plain: bool) -> frozenset[Role]:
    """The roles of a caller that has not logged in; plain: the page is on loopback and without TLS.

    Every program of the machine may command a mission without keys, so a login at its page would protect nothing.
    """
    if not plain:
        return frozenset()
    open_to_all = options.authority and mission.identity is None and options.login_file is None
    return COMMANDERS if open_to_all else READERS


def _protection(options: PageOptions, local: bool) -> tuple[Tls | None, str | None]:
    """The files of TLS, and a warning if there is none and other machines can reach the page."""
    tls = options.tls
    if tls is None and not local and options.identity is not None:
        tls = tls_of(options.identity)
    if tls is not None or local:
        return tls, None
    if not options.insecure:
        raise InvalidInput(
            f"--bind {options.bind}: expected TLS off loopback: --identity, or --certificate and --key "
            "(--insecure serves without)"
        )
    return None, UNSAFE


def _announce(
    mission: str,
    urls: list[str],
    access: Access,
    options: PageOptions,
    say: Callable[[str], None],
    warning: str | None,
    recorded: bool,
) -> None:
    """Print the addresses of the page, and issue the tokens."""
    lines = []
    what_of = "recording of mission" if recorded else "mission"
    local = access.caller("", None)
    needs_login = local is None
    if options.authority and local is not None and local.roles == COMMANDERS:
        lines.append(("", "with command authority"))
    elif options.authority:
        token = access.new_token(Caller("page.commander", COMMANDERS))
        lines.append((f"login?token={token}", "with command authority"))
    if needs_login:
        token = access.new_token(Caller("page.reader", READERS))
        lines.append((f"login?token={token}", "read-only"))
    elif not options.authority:
        lines.append(("", "read-only" if recorded else "read-only; --authority lets it command"))
    if warning is not None:
        say(f"he3 web: {warning}")
    if options.login_file is not None:
        text = "".join(f"{url}{path} ({what})\n" for path, what in lines for url in urls)
        try:
            replace_output(options.login_file, text.encode())
        except OSError as error:
            raise failed(f"--login-file {options.login_file}: cannot write", error) from None
        say(f"{what_of} '{mission}' at {', '.join(urls)}, logins in {options.login_file}; Ctrl-C stops it")
        return
    for path, what in lines:
        say(f"{what_of} '{mission}' at {', '.join(url + path for url in urls)} ({what}); Ctrl-C stops it")

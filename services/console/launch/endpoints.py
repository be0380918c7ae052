"""Where the two routers of a mission that is started here listen."""

from __future__ import annotations

import errno
import os
import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from he3.errors import He3Error
from schemas.topics import Side
from services.runtime.trust.endpoint_policy import is_encrypted

if TYPE_CHECKING:
    from services.console.launch.scenarios import Chosen

MAX_PORT = 65_536


@dataclass(frozen=True, slots=True)
class Endpoints:
    """Where the two routers listen."""

    moon: str
    earth: str


def endpoints_of(chosen: Chosen) -> Endpoints:
    """The endpoints that the chosen scenario and its keys name; raises InvalidInput for one that may not be used."""
    return Endpoints(chosen.endpoint(Side.MOON), chosen.endpoint(Side.EARTH))


def free_endpoints(protocol: str = "tcp") -> Endpoints:
    """Two endpoints on loopback that are free at this moment."""
    with socket.socket() as moon, socket.socket() as earth:
        for each in (moon, earth):
            each.bind(("127.0.0.1", 0))
        ports = moon.getsockname()[1], earth.getsockname()[1]
    return Endpoints(*(f"{protocol}/127.0.0.1:{port}" for port in ports))


@contextmanager
def endpoints_near(wanted: Endpoints) -> Iterator[Endpoints]:
    """The wanted endpoints, at which clients look by default, if they are free on this machine; else two free ones.

    Other missions of this user cannot take them while the `with` statement lasts.
    """
    moon, earth = _loopback_port(wanted.moon), _loopback_port(wanted.earth)
    protocol = "tls" if is_encrypted(wanted.earth) else "tcp"
    if moon is None or earth is None:
        yield free_endpoints(protocol)
        return
    with ExitStack() as held:
        try:
            # An abstract socket is a lock without a file: it ends with the process, and no link can stand in its place.
            claim = held.enter_context(socket.socket(socket.AF_UNIX))
            claim.bind(f"\0he3-{os.getuid()}-{moon}-{earth}")
            for port in (moon, earth):
                _bind("127.0.0.1", port)
        except OSError:
            held.close()
            yield free_endpoints(protocol)
            return
        yield wanted


def require_free(endpoints: Endpoints) -> None:
    """Raise He3Error if another program of this machine listens at one of the endpoints.

    The link would find out too, but only seconds later. A TCP endpoint is checked only if its address is
    one of this machine's.
    """
    for side, endpoint in (("moon", endpoints.moon), ("earth", endpoints.earth)):
        found = re.fullmatch(r"(?:tcp|tls)/\[?([^/\s\[\]]+)\]?:(\d{1,5})", endpoint)
        if found is None or int(found[2]) >= MAX_PORT:
            continue
        try:
            _bind(found[1], int(found[2]))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise He3Error(
                    f"cannot listen as the {side} router at {endpoint}: the address is in use by another program; "
                    f"choose another, as in --set network.{side}={endpoint.rpartition(':')[0]}:{_free_port()}"
                ) from None


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def _bind(host: str, port: int) -> None:
    """Bind a socket to the address and close it; raises OSError if the address cannot be bound."""
    numeric = "127.0.0.1" if host == "localhost" else host
    flags = socket.AI_NUMERICHOST  # no name is looked up: that can take long
    family, kind, protocol, _, address = socket.getaddrinfo(numeric, port, type=socket.SOCK_STREAM, flags=flags)[0]
    with socket.socket(family, kind, protocol) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(address)


def _loopback_port(endpoint: str) -> int | None:
    found = re.fullmatch(r"(?:tcp|tls)/(?:127\.0\.0\.1|localhost):(\d{1,5})", endpoint)
    return int(found[1]) if found and 0 < int(found[1]) < MAX_PORT else None

"""Which endpoints a process may use: TLS with an identity, or plain on loopback; anything else only as `--insecure`."""

from __future__ import annotations

import ipaddress
import re

from he3.errors import InvalidInput

INSECURE_WARNING = (
    "INSECURE: {endpoint} is not on loopback and has no TLS: any client can read, forge and command everything"
)
_ENCRYPTED = "tls/"
"""The one protocol of Zenoh's for which client certificates and access rules by their names were seen to hold."""


def is_encrypted(endpoint: str) -> bool:
    """Whether the endpoint uses TLS, with which peers prove their identity."""
    return endpoint.startswith(_ENCRYPTED)


def is_local(endpoint: str) -> bool:
    """Whether only processes of this machine reach that endpoint."""
    if endpoint.startswith("unixsock-stream/"):
        return True
    found = re.fullmatch(r"[a-z]+/(?:\[([^\]]+)\]|([^/:]+)):\d+(?:[?#].*)?", endpoint)
    if found is None:
        return False
    host = found[1] or found[2]
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_endpoint(endpoint: str, *, identified: bool, insecure: bool = False) -> str | None:
    """A warning, or None, for an endpoint that may be used.

    identified: whether the process has an identity. insecure: whether the user has asked for it.
    Raises InvalidInput, in one line, for TLS without an identity or with options of the endpoint's own, an identity
    without TLS, and an endpoint that others can reach without TLS.
    """
    if is_encrypted(endpoint):
        if re.search("[?#]", endpoint):
            # Zenoh would take them in place of the identity's: another authority, or no certificates of clients.
            raise InvalidInput(f"{endpoint[:100]}: expected a TLS endpoint as tls/HOST:PORT, got one with options")
        if not identified:
            raise InvalidInput(f"{endpoint}: expected an identity for TLS: give --identity DIR (see 'he3 keys')")
        return None
    if identified:
        raise InvalidInput(f"{endpoint}: expected a tls/ endpoint with --identity, got one without TLS")
    if is_local(endpoint):
        return None
    if not insecure:
        raise InvalidInput(
            f"{endpoint}: expected TLS off loopback: tls/... with --identity DIR (see 'he3 keys'), "
            "or --insecure to let every client command the mission"
        )
    return INSECURE_WARNING.format(endpoint=endpoint)


def with_tls(endpoint: str) -> str:
    """The endpoint with TLS in place of plain TCP; raises InvalidInput for an endpoint of another protocol."""
    if is_encrypted(endpoint):
        return endpoint
    if not endpoint.startswith("tcp/"):
        raise InvalidInput(f"{endpoint}: expected a tcp/ or tls/ endpoint with keys")
    return f"tls/{endpoint.removeprefix('tcp/')}"

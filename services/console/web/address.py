"""Addresses of the page's server: where it listens, what it prints, and the Host headers that it accepts."""

from __future__ import annotations

import errno
import fcntl
import ipaddress
import re
import socket
import struct
from pathlib import Path

from he3.errors import He3Error, InvalidInput

Address = ipaddress.IPv4Address | ipaddress.IPv6Address

_NAME = re.compile(r"(?!-)[a-z0-9_-]{1,63}(?<!-)(\.(?!-)[a-z0-9_-]{1,63}(?<!-))*")
_WITH_PORT = re.compile(r"(?P<host>\[[^\[\]]*\]|[^:\[\]]*)(?::(?P<port>\d{1,5}))?")
_NOT_OURS = frozenset({errno.EADDRNOTAVAIL, errno.EINVAL, errno.EAFNOSUPPORT})
"""Error numbers of binding an address that no interface of this machine has."""
_SIOCGIFADDR = 0x8915  # Linux, netdevice(7)
LOOPBACK_NAMES = frozenset({"127.0.0.1", "localhost", "::1"})
LOOPBACK = {socket.AF_INET: "127.0.0.1", socket.AF_INET6: "::1"}


def host_name(text: str) -> str:
    """The host of NAME, NAME:PORT, ADDRESS or [ADDRESS]:PORT in one spelling: lower case, no dot at its end, no port.

    Raises InvalidInput for anything else.
    """
    found = address_of(text) or normal_host(text)
    if found is None:
        raise InvalidInput(f"expected a host name or address such as moonbase.lan or [fd00::1], got '{text[:80]}'")
    return str(found)


def normal_host(header: str) -> str | None:
    """The host of a Host header in one spelling (addresses as `ipaddress` writes them); None for an invalid host."""
    found = _WITH_PORT.fullmatch(header.strip())
    if found is None or (found["port"] is not None and int(found["port"]) > 65_535):
        return None
    host = found["host"].lower().removesuffix(".")
    if host.startswith("["):
        address = address_of(host[1:-1]) if ":" in host else None
        return None if address is None else str(address)
    address = address_of(host)
    if address is not None:
        return str(address)
    return host if len(host) <= 253 and _NAME.fullmatch(host) else None


def address_of(text: str) -> Address | None:
    """The IP address of that text, an IPv4-mapped one as IPv4; None for other text and for addresses with a zone."""
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        return None
    if "%" in text:
        return None
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is not None:
        return address.ipv4_mapped
    return address


def listening(bind: str, port: int) -> socket.socket:
    """A socket that listens on that address and port (0: a free one).

    Raises InvalidInput for an address that is not one of this machine's, He3Error when the port is taken.
    """
    refusal = InvalidInput(f"--bind: expected an address of this machine that a browser can open, got '{bind}'")
    if not bind or "%" in bind:
        raise refusal
    try:
        found = socket.getaddrinfo(_bare(bind), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, ValueError):
        raise refusal from None
    # A name such as localhost may have both: IPv4 first, as everything on this machine reaches it.
    family, _, _, _, address = min(found, key=lambda each: each[0] != socket.AF_INET)
    # With the protocol named, asyncio sends small answers at once; else each waits 40 ms for more.
    try:
        made = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    except OSError:
        raise refusal from None
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:  # :: stands for every address, IPv4 ones included
            every = ipaddress.ip_address(address[0]).is_unspecified
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, not every)
        made.bind(address)
        made.listen()
    except OSError as error:
        made.close()
        if isinstance(error, PermissionError):
            raise He3Error(f"cannot listen at {bind} port {port}: {error.strerror}; try --port 8030") from None
        if error.errno in _NOT_OURS:
            raise refusal from None
        raise He3Error(
            f"cannot listen at {bind} port {port}: {error.strerror}; expected a free port (--port)"
        ) from None
    return made


def is_loopback(listener: socket.socket) -> bool:
    """Whether only programs of this machine can reach that socket."""
    here = address_of(listener.getsockname()[0])
    return here is not None and here.is_loopback


def urls_of(listener: socket.socket, bind: str, scheme: str = "http") -> list[str]:
    """The addresses of the page as browsers open them: the local one first, then those for other machines."""
    host, port = listener.getsockname()[:2]
    hosts = [host]
    if ipaddress.ip_address(host).is_unspecified:
        hosts = [LOOPBACK[socket.AddressFamily(listener.family)], *addresses_of_this_machine(listener.family)]
    elif address_of(_bare(bind)) is None and any(letter.isalpha() for letter in bind):
        hosts = [bind]  # a name, such as localhost
    return [f"{scheme}://[{each}]:{port}/" if ":" in each else f"{scheme}://{each}:{port}/" for each in hosts]


def addresses_of_this_machine(family: int) -> list[str]:
    """Addresses at which other machines reach this one: IPv4, and for a socket of IPv6 both. Empty if none is known."""
    found = [] if family == socket.AF_INET else [address for address in _ipv6_addresses() if not address.is_link_local]
    usable = [address for address in (*_ipv4_addresses(), *found) if not address.is_loopback]
    return [str(address) for address in usable]


def _ipv4_addresses() -> list[Address]:
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for _, name in socket.if_nameindex():
            try:
                reply = fcntl.ioctl(asking, _SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
            except OSError:  # an interface without an address of IPv4
                continue
            found.append(ipaddress.ip_address(reply[20:24]))
    return found


def _ipv6_addresses() -> list[Address]:
    try:
        lines = Path("/proc/net/if_inet6").read_text(encoding="ascii").splitlines()
    except OSError:
        return []
    return [ipaddress.ip_address(bytes.fromhex(line.split()[0])) for line in lines]


def own_names(listener: socket.socket, bind: str) -> frozenset[str]:
    """The names under which the server is reached besides the address that a connection comes to."""
    here = ipaddress.ip_address(listener.getsockname()[0])
    names = {*LOOPBACK_NAMES, *(() if here.is_unspecified else (normal_host(bind), str(here)))}
    return frozenset(name for name in names if name is not None)


def _bare(bind: str) -> str:
    """The address without brackets, and in its plain spelling."""
    text = bind[1:-1] if bind.startswith("[") and bind.endswith("]") else bind
    address = address_of(text)
    return text if address is None else str(address)

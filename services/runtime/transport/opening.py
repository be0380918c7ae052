"""Configures and opens Zenoh sessions, and reports when that takes long."""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import stat
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from he3.errors import InvalidInput, PeerUnreachable
from services.mission.deployment import deployment
from services.runtime.transport.session import Session

if TYPE_CHECKING:
    from schemas.topics import Side
    from services.runtime.trust.identity import Identity

RETRY_CONNECT_S = 0.3
PROBE_TIMEOUT_S = 1.0
"""Longest wait for a connection to an endpoint that gave no session, to tell why."""
LOOK_EVERY_S = 0.05
SILENT_AFTER_S = 3.0
"""An endpoint that takes a connection and has not replied for this long is reported; a busy router may still reply."""

WhileWaiting = Callable[[float], None]
"""Called while a session is being opened, with the time waited so far [s]; an exception from it ends the wait."""


@dataclass(frozen=True, slots=True)
class RouterGuard:
    """Whom a router lets in, over TLS, and what they may do."""

    identity: Identity
    """Its own; the certificates of the same authority are let in."""
    rules: dict[str, Any]
    """Zenoh's `access_control`; see `services.runtime.trust.access_control`."""


def session_config(side: Side, role: str, endpoint: str, identity: Identity | None = None) -> zenoh.Config:
    """The shipped configuration of that side and role (`router` or `client`), with that endpoint and identity."""
    path = deployment("zenoh", f"{side.value}-{role}.json5")
    try:
        config = zenoh.Config.from_file(str(path))
        config.insert_json5("listen/endpoints" if role == "router" else "connect/endpoints", json.dumps([endpoint]))
        if identity is not None:
            config.insert_json5("transport/link/tls", json.dumps(tls_config(role, identity)))
    except zenoh.ZError as error:
        raise InvalidInput(
            f"{path}: expected a Zenoh configuration and an endpoint, got: {_first_line(error)}"
        ) from None
    return config


def tls_config(role: str, identity: Identity) -> dict[str, Any]:
    """Zenoh's `transport/link/tls` for a `router` or `client` of that identity: both ends prove who they are."""
    own = "listen" if role == "router" else "connect"
    return {
        "root_ca_certificate": str(identity.authority_path),
        f"{own}_certificate": str(identity.certificate_path),
        f"{own}_private_key": str(identity.key_path),
        "enable_mtls": True,
        # A router is known by its certificate's right to serve, which only a link has, not by the name of its host.
        "verify_name_on_connect": False,
        "close_link_on_expiration": True,
    }


def open_router(side: Side, endpoint: str, guard: RouterGuard | None = None) -> zenoh.Session:
    """A session that listens as that side's router; raises PeerUnreachable, with the reason, when it cannot.

    guard: None: every client may do everything. Raises InvalidInput for a Unix socket in place of another file.
    """
    _require_room_for_socket(endpoint)
    config = session_config(side, "router", endpoint, None if guard is None else guard.identity)
    if guard is not None:
        config.insert_json5("access_control", json.dumps(guard.rules))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise PeerUnreachable(f"cannot listen as the {side.value} router at {endpoint}: {_first_line(error)}") from None


def _require_room_for_socket(endpoint: str) -> None:
    """Raise InvalidInput if Zenoh would delete another's file for the Unix socket of that endpoint.

    It deletes what lies at the socket's path, and a file `PATH.lock` of its own at the end. A socket that a killed
    router has left lies beside such a file, which is empty.
    """
    protocol, _, path = endpoint.partition("/")
    if protocol != "unixsock-stream":
        return
    place = Path(re.split("[?#]", path)[0])
    lock = Path(f"{place}.lock")
    found, locked = _status(place), _status(lock)
    if locked is not None and not (stat.S_ISREG(locked.st_mode) and locked.st_size == 0):
        raise InvalidInput(f"{endpoint}: expected no file {lock}, got one that no router has left")
    if found is not None and not (stat.S_ISSOCK(found.st_mode) and locked is not None):
        raise InvalidInput(f"{endpoint}: expected no file there, or a socket that a router has left, got another file")


def _status(path: Path) -> os.stat_result | None:
    """The status of that file or link itself; None if there is none, or it cannot be found out."""
    try:
        return path.lstat()
    except (OSError, ValueError):
        return None


def open_client(
    side: Side, endpoint: str, while_waiting: WhileWaiting = lambda _: None, identity: Identity | None = None
) -> zenoh.Session:
    """A session that is connected to that side's router; raises PeerUnreachable when no router listens there.

    Zenoh waits up to a minute for a program that accepts the connection and sends nothing, in a call that no signal
    interrupts. So the call runs in a thread. while_waiting: called meanwhile, again and again, with the time waited so
    far [s]; an exception from it ends the wait.
    """
    config = session_config(side, "client", endpoint, identity)
    ended = threading.Event()
    opened: list[zenoh.Session] = []
    abandoned: list[bool] = []

    def work() -> None:
        with contextlib.suppress(zenoh.ZError):
            session = zenoh.open(config)
            opened.append(session)
            if abandoned:
                session.close()  # type: ignore[no-untyped-call]
        ended.set()

    threading.Thread(target=work, name="zenoh-open", daemon=True).start()
    began = time.monotonic()
    try:
        while not ended.wait(LOOK_EVERY_S):
            while_waiting(time.monotonic() - began)
    except BaseException:
        abandoned.append(True)
        raise
    if not opened:
        raise PeerUnreachable(f"no {side.value} router at {endpoint}{_what_listens(endpoint, identity)}")
    return opened[0]


def _what_listens(endpoint: str, identity: Identity | None) -> str:
    """What to add about an endpoint that gave no session: that a program listens there, if one does."""
    _, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=PROBE_TIMEOUT_S):
            pass
    except (OSError, ValueError):
        return ""
    if identity is None:
        return (
            ": a program listens there, but not as the router of a mission without keys; "
            "a mission with keys has tls/ endpoints and takes --identity DIR"
        )
    return (
        f": a program listens there, but it and {identity.common_name} do not accept each other; "
        "expected keys of one mission, valid by the clocks of both machines"
    )


def connect_client(
    side: Side,
    endpoint: str,
    mission: str,
    stop: threading.Event,
    on_waiting: Callable[[str], None],
    identity: Identity | None = None,
) -> Session | None:
    """A client session on that side, once its router answers; None if `stop` is set first.

    on_waiting: called with one line if the router does not answer at once, or if another program seems to listen, and
    again when the reason is another one.
    """
    silence = SilenceReport(side, endpoint, on_waiting)
    reported = ""

    def look(waited_s: float) -> None:
        if stop.is_set():
            raise _Stopped
        silence(waited_s)

    with contextlib.suppress(_Stopped):
        while not stop.is_set():
            try:
                return Session(open_client(side, endpoint, look, identity), mission)
            except PeerUnreachable as error:
                if str(error) != reported:
                    reported = str(error)
                    on_waiting(f"{reported}; still trying")
                stop.wait(RETRY_CONNECT_S)
    return None


class SilenceReport:
    """Reports, once, that an endpoint takes the connection and does not reply: a `WhileWaiting`."""

    def __init__(self, side: Side, endpoint: str, report: Callable[[str], None]) -> None:
        self._line = (
            f"{endpoint} takes the connection, but has not replied for {SILENT_AFTER_S:g} s: "
            f"expected the {side.value} router there, got perhaps another program; still waiting"
        )
        self._report = report
        self._reported = False

    def __call__(self, waited_s: float) -> None:
        if waited_s > SILENT_AFTER_S and not self._reported:
            self._reported = True
            self._report(self._line)


class _Stopped(Exception):
    """The process was told to stop while it waited."""


def _first_line(error: Exception) -> str:
    """What the system said, if it did: Zenoh wraps that in its own words, with half a bracket. Else Zenoh's words."""
    line = str(error).splitlines()[0].split(" at /")[0]
    found = re.search(r"([A-Z][^:\[\]]*) \(os error \d+\)", line)
    return line if found is None else found[1]

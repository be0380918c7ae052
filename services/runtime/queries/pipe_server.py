"""The query process: operators' queries answered from the snapshots that come through its standard input.

It has a Zenoh session of its own, keeps what it needs of earlier snapshots, and answers in threads. Whatever is asked,
the node in the owner's process is not disturbed. It ends with its pipe, however the owner ended.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from schemas.topics import Side
from services.runtime.queries.pipe import READY, read_snapshot, say
from services.runtime.queries.server import QueryServer, QueryService
from services.runtime.transport.opening import connect_client

if TYPE_CHECKING:
    from services.runtime.transport.session import Session
    from services.runtime.trust.identity import Identity

SWITCH_INTERVAL_S = 0.0005
"""Python's thread switch interval: a query waits for a computing thread no longer than for the network."""
LARGE_BYTES = 262_144
_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8  # malloc.h of glibc


class SnapshotPublisher(Protocol):
    """Publishes data from each snapshot, beside the replies to queries."""

    def begin(self, session: Session) -> None:
        """Publish on that session from now on."""

    def show(self, snapshot: Any) -> None:
        """Publish from that snapshot from now on; never blocks."""

    def end(self) -> None:
        """Stop publishing."""


def serve_from_pipe(
    service: QueryService,
    name: str,
    publisher: SnapshotPublisher,
    arguments: Sequence[str],
    identity: Identity | None = None,
) -> int:
    """Answer that service's queries from the snapshots on standard input; returns when it ends.

    name: of the owner, the source in the headers of replies. arguments: side, endpoint and mission. publisher: is
    shown each snapshot as well. identity: the owner's.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    _return_large_blocks()
    side, endpoint, mission = arguments
    ended = threading.Event()
    sessions: list[Session] = []
    server = QueryServer(service, name, mission)

    def connect() -> None:
        session = connect_client(Side(side), endpoint, mission, ended, lambda _: None, identity)
        if session is None:
            return
        sessions.append(session)
        for topic in service.topics:
            server.serve(topic, session)
        publisher.begin(session)
        say(READY)

    connecting = threading.Thread(target=connect, name="connect", daemon=True)
    while (given := read_snapshot(sys.stdin.buffer)) is not None:
        number, snapshot = given
        if connecting.ident is None:
            connecting.start()
        if number > 0:
            publisher.show(server.show(snapshot))
        say(b"%d\n" % number)
    ended.set()
    publisher.end()
    for session in sessions:
        session.close()
    # Threads of Zenoh may still hold on to what is going away.
    os._exit(0)


def _return_large_blocks() -> None:
    """Have glibc return large blocks of memory to the system as soon as they are freed, and use few pools.

    Answers of up to 32 MB are made in many threads. By default glibc keeps blocks of the sizes that were freed before,
    in a pool for each thread.
    """
    change = getattr(ctypes.CDLL(None), "mallopt", None)
    if change is not None:
        change(_M_MMAP_THRESHOLD, LARGE_BYTES)
        change(_M_ARENA_MAX, 2)

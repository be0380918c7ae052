"""Bounds on connections: their number, and the time of each to send a request and to read its answer.

The oldest idle connection is closed to make room, so a client that opens many idle ones only loses its own.
"""

from __future__ import annotations

import asyncio
import ctypes
import resource
import socket
import weakref
from contextlib import suppress
from typing import Any

from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from services.console.web.access import common_name_of_peer

MAX_CONNECTIONS = 256
HEADERS_WITHIN_S = 10.0
"""Time limit [s] from the start of a connection, or the first byte of a request, until the headers are complete."""
TAKEN_WITHIN_S = 30.0
"""Longest time [s] in which a client reads nothing of an answer."""
_M_ARENA_MAX = -8  # glibc, malloc.h
_RESERVED_FILES = 128
"""File descriptors reserved for other uses than connections."""

PEER = "he3.peer"
"""Key in the scope of a request: common name of the client's certificate, or None."""


class BoundedListener(socket.socket):
    """A listening socket with a limit on its open connections."""

    def __init__(self, listener: socket.socket, limit: int = MAX_CONNECTIONS) -> None:
        """Replaces `listener`, which is detached."""
        super().__init__(listener.family, listener.type, listener.proto, fileno=listener.detach())
        self._limit = limit
        self._open: list[weakref.ref[socket.socket]] = []
        self.busy: set[int] = set()
        """File numbers of connections that wait for an answer."""

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection; if there are too many, the oldest idle one is closed, or this one if none is idle."""
        self._open = [each for each in self._open if (made := each()) is not None and made.fileno() >= 0]
        made, address = super().accept()
        if len(self._open) >= self._limit:
            idle = next((each for each in self._open if (old := each()) and old.fileno() not in self.busy), None)
            if idle is None:
                made.close()
                raise BlockingIOError
            self._open.remove(idle)
            if (oldest := idle()) is not None:
                with suppress(OSError):
                    oldest.shutdown(socket.SHUT_RDWR)
        self._open.append(weakref.ref(made))
        return made, address


def allow_connections(limit: int = MAX_CONNECTIONS) -> None:
    """Let this process have as many open files as the connections need, as far as the system allows it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 2 * limit + _RESERVED_FILES
    if soft != resource.RLIM_INFINITY and soft < wanted:
        most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def share_heaps() -> None:
    """Let all threads share two heaps, where the C library is glibc.

    By default each thread that answers has a heap of its own, and none gives back what one large answer took: over
    20,000 requests the process grows by 16 % of its memory, with two heaps by 9 %.
    """
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 2)


def protocol_of(listener: BoundedListener) -> type[H11Protocol]:
    """The class of the connections of that listener."""

    class PageProtocol(H11Protocol):
        """A connection with time limits to send requests and to read answers; its requests carry the client's name."""

        _timer: asyncio.TimerHandle | None = None
        _number = -1

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            made = transport.get_extra_info("socket")
            self._number = -1 if made is None else made.fileno()
            tls = transport.get_extra_info("ssl_object")
            self.app = _with_peer(self.app, common_name_of_peer(None if tls is None else tls.getpeercert()))
            self._within(HEADERS_WITHIN_S)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.cycle is not None and not self.cycle.response_complete:
                listener.busy.add(self._number)
                self._stop_timer()
            elif self._timer is None:
                self._within(HEADERS_WITHIN_S)

        def on_response_complete(self) -> None:
            listener.busy.discard(self._number)
            super().on_response_complete()

        def pause_writing(self) -> None:
            super().pause_writing()
            self._within(TAKEN_WITHIN_S)

        def resume_writing(self) -> None:
            super().resume_writing()
            self._stop_timer()

        def connection_lost(self, exc: Exception | None) -> None:
            self._stop_timer()
            listener.busy.discard(self._number)
            super().connection_lost(exc)

        def _within(self, seconds: float) -> None:
            self._stop_timer()
            self._timer = self.loop.call_later(seconds, self.transport.abort)

        def _stop_timer(self) -> None:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None

    return PageProtocol


def _with_peer(app: Any, common_name: str | None) -> Any:
    async def named(scope: Scope, receive: Receive, send: Send) -> None:
        inner: ASGIApp = app
        await inner({**scope, PEER: common_name}, receive, send)

    return named

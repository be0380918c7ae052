"""Messages between the planner process and its owner, over a socket that joins two processes of one program.

A message has a length of eight bytes, the task's number of eight, a kind of one, and a payload. The payload of a task
is a limit on its time (a double; infinite for none) and a pickle.
"""

from __future__ import annotations

import socket
import struct
from typing import Final

MAX_BYTES: Final = 1 << 30
"""Longest message [bytes]; a planning request of 500 x 500 cells has about 2 MB."""

TASK, CANCEL, RESULT, ERROR, DIED, LATE = b"t", b"c", b"r", b"e", b"d", b"l"
"""Kinds. To the server: a task, or a number whose task is to be killed. From it: what a task returned or raised, that
its child died (with the exit code), or that it was killed when its time was up (with the limit)."""

EXIT_CODE, LIMIT_S = struct.Struct("!q"), struct.Struct("!d")
_HEADER = struct.Struct("!QQc")


def send(channel: socket.socket, number: int, kind: bytes, payload: bytes) -> None:
    """Send a message; raises OSError when the other side is gone."""
    channel.sendall(_HEADER.pack(len(payload), number, kind))
    if payload:
        channel.sendall(payload)


def receive(channel: socket.socket) -> tuple[int, bytes, bytes] | None:
    """The next message (number, kind, payload), or None when the other side is gone."""
    try:
        header = _exactly(channel, _HEADER.size)
        if header is None:
            return None
        size, number, kind = _HEADER.unpack(header)
        payload = _exactly(channel, size) if size <= MAX_BYTES else None
        return None if payload is None else (number, kind, bytes(payload))
    except OSError:
        return None


def _exactly(channel: socket.socket, size: int) -> bytearray | None:
    data = bytearray(size)
    view, got = memoryview(data), 0
    while got < size:
        count = channel.recv_into(view[got:])
        if count == 0:
            return None
        got += count
    return data

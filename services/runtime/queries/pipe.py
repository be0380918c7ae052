"""The protocol of the pipes between a service's process, the owner, and its query process.

The owner writes snapshots, numbered from 1 and pickled. The query process connects at the first one, or at an empty one
with number 0: by then the owner has its role in the mission. The query process writes lines: that it is ready, which
snapshot it answers from, and, every second, that it lives. The pipes join two processes of one program and one user: no
other program or user has access to them.
"""

from __future__ import annotations

import os
import pickle
import struct
import threading
import time
from typing import Any, BinaryIO, Final

READY: Final = b"ready\n"
"""The query process answers queries."""
ALIVE: Final = b"alive\n"
"""Sign of life; written from the beginning on, before the process is ready."""
ALIVE_EVERY_S: Final = 1.0

_HEAD: Final = struct.Struct("<QQ")  # number and length of a snapshot
_STDOUT: Final = 1


def write_snapshot(pipe: BinaryIO, number: int, snapshot: Any) -> None:
    """Write a snapshot to an unbuffered pipe; raises OSError when the other end is gone."""
    payload = pickle.dumps(snapshot, protocol=pickle.HIGHEST_PROTOCOL)
    for part in (_HEAD.pack(number, len(payload)), payload):
        rest = memoryview(part)
        while rest:
            rest = rest[pipe.write(rest) :]


def read_snapshot(pipe: BinaryIO) -> tuple[int, Any] | None:
    """Number and content of the next snapshot; None at the end."""
    head = pipe.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    number, length = _HEAD.unpack(head)
    payload = pipe.read(length)
    return (number, pickle.loads(payload)) if len(payload) == length else None


def say(line: bytes) -> None:
    """Write one whole line to the owner; no effect if the owner is gone."""
    try:
        os.write(_STDOUT, line)
    except BrokenPipeError:
        return  # the end of the other pipe ends this process


def say_alive() -> None:
    """Write that this process lives, every second from now on, in a thread."""

    def work() -> None:
        while True:
            say(ALIVE)
            time.sleep(ALIVE_EVERY_S)

    threading.Thread(target=work, name="alive", daemon=True).start()

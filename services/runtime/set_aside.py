"""Inputs from outside that a node could not handle: the first of them are kept in a file, for the repair.

A node refuses what it does not accept. An exception is a defect of the program, but the sender of a message must not
be able to end a service with it, not even at each restart from a journal. So the input is set aside, counted and
reported, and the service continues.
"""

from __future__ import annotations

import base64
import json
from typing import TYPE_CHECKING, Final

from services.runtime.files.input import read_own
from services.runtime.files.output import open_output

if TYPE_CHECKING:
    from pathlib import Path

    from services.runtime.actions import SetAside

MAX_KEPT: Final = 32
"""Inputs in the file."""
MAX_KEPT_BYTES: Final = 65_536
"""Bytes kept of each."""


class SetAsideFile:
    """A file of JSON lines, one for each input that was set aside; later ones than `MAX_KEPT` are not kept."""

    def __init__(self, path: Path | None) -> None:
        """path: None: nothing is kept."""
        self.path = path
        self._kept: int | None = None

    def keep(self, action: SetAside, at: int) -> bool:
        """Keep the input, and the mission time at which it came [ns]; returns whether the file has it."""
        if self.path is None:
            return False
        line = {
            "at": at,
            "input": action.what,
            "error": action.error,
            "traceback": action.traceback,
            "bytes": len(action.payload),
            "payload_base64": base64.b64encode(action.payload[:MAX_KEPT_BYTES]).decode(),
        }
        try:
            if self._kept is None:
                self._kept = len(read_own(self.path).splitlines()) if self.path.exists() else 0
            if self._kept >= MAX_KEPT:
                return False
            with open_output(self.path, append=True) as stream:
                stream.write(json.dumps(line).encode() + b"\n")
        except OSError:
            return False  # the log line has the rest
        self._kept += 1
        return True

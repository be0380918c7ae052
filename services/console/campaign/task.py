"""A task of a campaign: a function by name, its arguments in JSON, and the key that follows from its content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

DONE: Final = "done"
FAILED: Final = "failed"
REFUSED: Final = "refused"
"""How a reply came about. A refused task was not computed: the worker's software is not the campaign's."""
LOST: Final = "lost"
"""The engine has no reply and will never have one, as when its scheduler is gone."""


@dataclass(frozen=True, slots=True)
class Task:
    """One independent task."""

    work: str
    """The function, ``module:function``. It takes the arguments and returns a JSON object."""
    arguments: Mapping[str, Any]
    """Everything that the result depends on, apart from the software."""
    software: str
    """Identity of the software that computes it (`identity.software_identity`)."""
    labels: Mapping[str, Any] = field(default_factory=dict)
    """What the report calls the row by: scenario, seed, values of parameters. They are no part of the key."""

    @property
    def key(self) -> str:
        """SHA-256 of function, arguments and software, in hexadecimal; the same content has the same key anywhere."""
        content = {"work": self.work, "arguments": self.arguments, "software": self.software}
        return hashlib.sha256(canonical(content).encode()).hexdigest()

    def request(self) -> str:
        """The task as the line of text that a worker reads."""
        return canonical({"work": self.work, "arguments": self.arguments, "software": self.software})


@dataclass(frozen=True, slots=True)
class Reply:
    """What a worker says to a task."""

    status: str
    """DONE, FAILED, REFUSED or LOST."""
    result: Mapping[str, Any] | None = None
    error: str = ""
    wall_s: float = 0.0
    """Time that the worker computed [s]."""
    worker: str = ""
    """Host and process id of the worker."""


def reply_of(line: str) -> Reply:
    """The reply of a worker's line of text; raises ValueError for a line that no worker writes."""
    found = json.loads(line)
    if not isinstance(found, dict) or "status" not in found:
        raise ValueError(f"expected a worker's reply, got {line[:80]!r}")
    return Reply(**found)


def canonical(value: Any) -> str:
    """The JSON text of a value: the same for equal values, on one line, ASCII only, without NaN and infinity."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)

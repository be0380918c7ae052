"""The refusal of a query on the wire: a code for programs, and one line of text for people.

The body of a Zenoh error reply is one JSON object, without an envelope:
``{"error": "map: expected a place within ...", "code": "outside_region"}``. Programs decide by the code alone.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import StrEnum

from schemas.wire import printable

MAX_FOREIGN_CHARACTERS = 200
"""Most characters shown of an error reply that is not in this form."""


class RefusalCode(StrEnum):
    """Why a query was refused."""

    INVALID_INPUT = "invalid_input"
    """The request is malformed or contradicts the mission's state; the same request fails again."""
    OUTSIDE_REGION = "outside_region"
    """The request names a place that the region does not contain."""
    NOT_FOUND = "not_found"
    """The request is well formed, but what it names does not exist."""
    NOT_READY = "not_ready"
    """What was requested does not exist yet."""
    BUSY = "busy"
    """Too many queries wait."""
    INTERNAL = "internal"
    """The server failed."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Body of an error reply."""

    error: str
    """One line of the form "expected ..., got ..."."""
    code: RefusalCode = RefusalCode.INVALID_INPUT
    stamp: str | None = None
    """The lockstep stamp: a Zenoh error reply has no attachment, so the body carries it."""

    def encode(self) -> bytes:
        """The refusal as JSON in UTF-8."""
        stamp = {} if self.stamp is None else {"stamp": self.stamp}
        return json.dumps({"error": self.error, "code": self.code.value, **stamp}).encode()


def decode_refusal(payload: bytes) -> Refusal:
    """The refusal in an error reply; `RefusalCode.INTERNAL` with the text as it came for any other form or code."""
    try:
        body = json.loads(payload)
        error, code, stamp = body["error"], body.get("code"), body.get("stamp")
    except (ValueError, TypeError, KeyError, AttributeError):
        return Refusal(printable(payload.decode(errors="replace")[:MAX_FOREIGN_CHARACTERS]), RefusalCode.INTERNAL)
    known = RefusalCode(code) if code in RefusalCode.__members__.values() else RefusalCode.INTERNAL
    return Refusal(printable(str(error)), known, None if stamp is None else str(stamp))

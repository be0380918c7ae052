"""A sealed letter: what the link knows of a message without opening it.

The link carries whatever it is given, well formed or not: only whose it is and its number are read off the outside,
for priorities, for replacing what is out of date, and to show operators what is under way.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from schemas.topics import Custody, Latest, Topic
from services.runtime.node import MissionTime

UNKNOWN_SOURCE = "?"

_HEADER_FIRST = b'{"header":'
_HEADER_LIMIT_BYTES = 2_000
_DECODER = json.JSONDecoder()


@dataclass(frozen=True, slots=True)
class Packet:
    """A message offered to one direction of the link."""

    topic: Topic
    payload: bytes
    source: str
    sequence: int
    subject: tuple[str, ...]
    """Of waiting letters with equal subject only the newest goes; empty: each goes.

    States of one source are of one subject, and so are the repetitions of one message under custody.
    """
    offered_at: MissionTime
    order: int
    """Counts the letters offered to the link."""

    @property
    def priority(self) -> int:
        """Lower goes first."""
        service = self.topic.service
        return service.priority if isinstance(service, Custody | Latest) else 9

    @property
    def size_bits(self) -> int:
        return 8 * len(self.payload)


def sealed(topic: Topic, payload: bytes, offered_at: MissionTime, order: int) -> Packet:
    """The letter that such a payload makes; one that cannot be read has source '?' and sequence 0."""
    header = _header(payload)
    source, sequence = header.get("source"), header.get("sequence")
    readable = isinstance(source, str) and isinstance(sequence, int) and not isinstance(sequence, bool)
    readable = readable and 0 <= sequence < 2**63  # type: ignore[operator]
    subject: tuple[str, ...] = ()
    if readable and isinstance(topic.service, Latest):
        subject = (topic.name, str(source), *_distinct(topic.service, payload))
    elif readable and isinstance(topic.service, Custody):
        subject = (topic.name, str(source), str(header.get("incarnation")), str(sequence))
    return Packet(
        topic=topic,
        payload=payload,
        source=str(source)[:64] if readable else UNKNOWN_SOURCE,
        sequence=int(sequence) if readable else 0,  # type: ignore[arg-type]
        subject=subject,
        offered_at=offered_at,
        order=order,
    )


def _header(payload: bytes) -> dict[str, Any]:
    """The header as it stands in the payload, unchecked; empty when there is none to be read."""
    try:
        if payload.startswith(_HEADER_FIRST):
            text = payload[len(_HEADER_FIRST) : _HEADER_LIMIT_BYTES].decode("utf-8", "replace")
            header = _DECODER.raw_decode(text)[0]
        else:
            header = json.loads(payload)["header"]
    except (ValueError, TypeError, KeyError, IndexError, RecursionError):
        return {}
    return header if isinstance(header, dict) else {}


def _distinct(service: Latest, payload: bytes) -> tuple[str, ...]:
    """What tells one subject of the topic from another: the values of the body's fields that the service names."""
    if not service.distinct:
        return ()
    try:
        body = json.loads(payload)["body"]
        return tuple(str(body[name]) for name in service.distinct)
    except (ValueError, TypeError, KeyError, IndexError, RecursionError):
        return ("?",)

"""A packet: a message as the link carries it, with what the link reads from its header.

The link carries every payload, well formed or not. It reads the source and the sequence of the message, for priorities,
for replacing outdated messages, and to show operators what is in flight; it neither checks nor changes the payload.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from schemas.codec import Passed, header_of
from schemas.commands import CommandKind
from schemas.topics import COMMAND, Custody, Latest, Topic
from schemas.wire import MAX_COUNT, printable

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime

UNKNOWN_SOURCE = "?"
URGENT = -1
"""Priority before that of all topics."""


@dataclass(frozen=True, slots=True)
class Packet:
    """A message offered to one direction of the link."""

    topic: Topic
    payload: bytes
    source: str
    sequence: int
    subject: tuple[str, ...]
    """Subject: only the newest waiting packet of a subject is sent; empty: each packet is sent.

    The states of one source have one subject, and so have the repetitions of one message under custody.
    """
    offered_at: MissionTime
    order: int
    """Counts the packets offered to the link."""
    urgent: bool = False
    """Whether it is a telecommand that makes the rover safe: it is sent first, and a place is kept for it."""

    @property
    def flow(self) -> tuple[str, str]:
        """Topic and source: the packets among which the capacity of a queue is shared."""
        return self.topic.name, self.source

    @property
    def priority(self) -> int:
        """Lower values are sent first."""
        if self.urgent:
            return URGENT
        service = self.topic.service
        return service.priority if isinstance(service, Custody | Latest) else 9

    @property
    def size_bits(self) -> int:
        return 8 * len(self.payload)


def packet_of(topic: Topic, payload: bytes, offered_at: MissionTime, order: int) -> Packet:
    """The packet of that payload; if its header cannot be read, the source is '?' and the sequence 0."""
    header = header_of(payload)
    source, sequence = header.get("source"), header.get("sequence")
    readable = isinstance(source, str) and isinstance(sequence, int) and not isinstance(sequence, bool)
    readable = readable and 0 <= sequence < MAX_COUNT  # type: ignore[operator]
    subject: tuple[str, ...] = ()
    if readable and isinstance(topic.service, Latest):
        subject = (topic.name, str(source), *_distinct(topic.service, payload))
    elif readable and isinstance(topic.service, Custody):
        subject = (topic.name, str(source), str(header.get("incarnation")), str(sequence))
    return Packet(
        topic=topic,
        payload=payload,
        source=printable(str(source))[:64] if readable else UNKNOWN_SOURCE,
        sequence=int(sequence) if readable else 0,  # type: ignore[arg-type]
        subject=subject,
        offered_at=offered_at,
        order=order,
        urgent=topic is COMMAND and _body_value(payload, "kind") == CommandKind.SAFE.value,
    )


def _distinct(service: Latest, payload: bytes) -> tuple[str, ...]:
    """The values of the body's fields that distinguish the topic's subjects."""
    return tuple(str(_body_value(payload, name)) for name in service.distinct)


def _body_value(payload: bytes, name: str) -> Any:
    """That field of the body as it is in the payload, unchecked; '?' if it cannot be read."""
    if isinstance(payload, Passed):
        value = getattr(payload.body, name, "?")
        return value.value if isinstance(value, Enum) else value
    try:
        return json.loads(payload)["body"][name]
    except (ValueError, TypeError, KeyError, IndexError, RecursionError):
        return "?"

"""The receiver's half of custody: each message once and in the order of its stream, and acknowledgements back.

A stream is a topic, its source and that source's incarnation. What comes out of turn is held until what is missing
has come; what came before is absorbed; both are acknowledged, so that the sender knows what to repeat. A message is
promised as delivered only when it was handed up: what is merely held may be forgotten in a restart, and the sender
keeps it until then. Rebuilt from a journal with `delivered`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final, NamedTuple

from schemas.link import Acknowledgement
from schemas.topics import Topic
from schemas.wire import Header
from services.runtime.custody.protocol import MAX_GAPS, CustodyConfig, acknowledged_on
from services.runtime.node import MissionTime, seconds

MAX_STREAMS: Final = 1_024
"""Streams that are remembered; the one whose turn is longest past is forgotten first."""


class Delivery(NamedTuple):
    """A message to be handed up."""

    topic: Topic
    header: Header
    body: Any


class Ack(NamedTuple):
    """An acknowledgement to be sent on that topic."""

    topic: Topic
    body: Acknowledgement


@dataclass(frozen=True, slots=True)
class ReceiverCounts:
    """What became of the messages since the start."""

    delivered: int
    repeated: int
    """Absorbed, as they had been delivered or were held."""
    held: int
    overflowed: int
    """Neither held nor acknowledged, for want of room."""


@dataclass(slots=True)
class _Stream:
    next: int = 0
    """Everything below it was handed up."""
    held: dict[int, tuple[Delivery, int]] = field(default_factory=dict)
    held_bytes: int = 0
    last: tuple[int, int, MissionTime] | None = None
    """Sequence, repetition and time of the latest arrival."""
    acknowledged_at: MissionTime | None = None
    ack_due: MissionTime | None = None


class CustodyReceiver:
    """What comes from the other side under custody."""

    def __init__(self, config: CustodyConfig | None = None) -> None:
        self._config = config or CustodyConfig()
        self._pause = seconds(self._config.ack_pause_s)
        self._streams: dict[tuple[Topic, str, int], _Stream] = {}
        self._delivered = self._repeated = self._overflowed = 0

    @property
    def counts(self) -> ReceiverCounts:
        held = sum(len(stream.held) for stream in self._streams.values())
        return ReceiverCounts(self._delivered, self._repeated, held, self._overflowed)

    def delivered(self, topic: Topic, header: Header) -> None:
        """Notes that this message was handed up in an earlier life; it is not handed up again."""
        stream = self._stream(topic, header)
        stream.next = max(stream.next, header.sequence + 1)

    def received(
        self, topic: Topic, header: Header, body: Any, size_bytes: int, now: MissionTime
    ) -> tuple[list[Delivery], list[Ack]]:
        """What is now to be handed up, in order, and the acknowledgements to send once that is safe in the journal."""
        stream = self._stream(topic, header)
        ready: list[Delivery] = []
        if header.held_from is not None and header.held_from > stream.next:
            ready += self._skips_to(stream, header.held_from)
        sequence = header.sequence
        if sequence < stream.next or sequence in stream.held:
            self._repeated += 1
        elif sequence == stream.next:
            ready.append(Delivery(topic, header, body))
            stream.next += 1
            ready += self._follow(stream)
        elif self._has_room(stream, size_bytes):
            stream.held[sequence] = (Delivery(topic, header, body), size_bytes)
            stream.held_bytes += size_bytes
        else:
            self._overflowed += 1
            return ready, []
        self._delivered += len(ready)
        stream.last = (sequence, header.repetition, now)
        if stream.acknowledged_at is None or stream.acknowledged_at + self._pause <= now:
            return ready, [self._acknowledges(topic, header.source, header.incarnation, stream, now)]
        stream.ack_due = stream.acknowledged_at + self._pause
        return ready, []

    def next_due(self) -> MissionTime | None:
        """When `due` wants to be called next."""
        return min((stream.ack_due for stream in self._streams.values() if stream.ack_due is not None), default=None)

    def due(self, now: MissionTime) -> list[Ack]:
        """The acknowledgements whose pause is over."""
        return [
            self._acknowledges(topic, source, incarnation, stream, now)
            for (topic, source, incarnation), stream in self._streams.items()
            if stream.ack_due is not None and stream.ack_due <= now
        ]

    def _stream(self, topic: Topic, header: Header) -> _Stream:
        key = (topic, header.source, header.incarnation)
        stream = self._streams.pop(key, None) or _Stream()
        self._streams[key] = stream  # now the last one, forgotten last
        if len(self._streams) > MAX_STREAMS:
            del self._streams[next(iter(self._streams))]
        return stream

    def _skips_to(self, stream: _Stream, held_from: int) -> Iterable[Delivery]:
        """The source no longer has what is missing below, as it was acknowledged in a life that is forgotten here."""
        ready = []
        for sequence in sorted(sequence for sequence in stream.held if sequence < held_from):
            delivery, size = stream.held.pop(sequence)
            stream.held_bytes -= size
            ready.append(delivery)
        stream.next = held_from
        return [*ready, *self._follow(stream)]

    def _follow(self, stream: _Stream) -> Iterable[Delivery]:
        """What was held and now has its turn."""
        ready = []
        while stream.next in stream.held:
            delivery, size = stream.held.pop(stream.next)
            stream.held_bytes -= size
            ready.append(delivery)
            stream.next += 1
        return ready

    def _has_room(self, stream: _Stream, size_bytes: int) -> bool:
        config = self._config
        return len(stream.held) < config.max_held and stream.held_bytes + size_bytes <= config.max_held_bytes

    def _acknowledges(self, topic: Topic, source: str, incarnation: int, stream: _Stream, now: MissionTime) -> Ack:
        stream.acknowledged_at, stream.ack_due = now, None
        edges = [stream.next - 1, *sorted(stream.held)]
        gaps = [(before + 1, after - 1) for before, after in pairwise(edges) if after > before + 1]
        complete = edges[-1] + 1
        if len(gaps) > MAX_GAPS:  # say nothing of what lies beyond the last gap that can be told
            complete = gaps[MAX_GAPS][0]
            gaps = gaps[:MAX_GAPS]
        sequence, repetition, at = stream.last if stream.last is not None else (None, 0, None)
        body = Acknowledgement(
            stream=topic.name,
            source=source,
            incarnation=incarnation,
            next_sequence=complete,
            gaps=tuple(gaps),
            last_sequence=sequence,
            last_repetition=repetition,
            last_received_at=at,
        )
        return Ack(acknowledged_on(topic), body)

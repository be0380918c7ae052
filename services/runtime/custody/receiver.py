"""The receiver's half of custody: delivers each message once and in the order of its stream, and acknowledges it.

A stream is a topic, its source and that source's incarnation. A message that comes out of turn is held until the
missing ones have come; one that was delivered or is held already is a duplicate. Both are acknowledged, so the sender
knows what to repeat. Only the acknowledgement of a delivered message is final. A held message is lost in a restart, so
the sender keeps it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from schemas.link import MAX_GAPS, Acknowledgement
from services.mission.mission_time import MissionTime, seconds
from services.runtime.custody.protocol import CustodyConfig

if TYPE_CHECKING:
    from schemas.topics import Topic
    from schemas.wire import Header, Wire
    from services.runtime.node import SavedState

MAX_STREAMS: Final = 1_024
"""Streams whose state is kept; the least recently used one is dropped first."""


@dataclass(frozen=True, slots=True)
class Delivery:
    """A message to be delivered to the node."""

    topic: Topic
    header: Header
    body: Any


@dataclass(frozen=True, slots=True)
class Arrival:
    """Which message of a stream arrived last, and when."""

    sequence: int
    repetition: int
    at: MissionTime


@dataclass(slots=True)
class _Stream:
    next: int = 0
    """Every message below it is delivered."""
    held: dict[int, tuple[Delivery, int]] = field(default_factory=dict)
    """Messages out of turn with their size in bytes, by sequence."""
    held_bytes: int = 0
    last: Arrival | None = None
    acknowledged_at: MissionTime | None = None
    ack_at: MissionTime | None = None
    """When the next acknowledgement is to be sent; None: there is nothing new to acknowledge."""

    def release(self, sequence: int) -> Delivery:
        """Removes and returns the held message of that sequence."""
        delivery, size_bytes = self.held.pop(sequence)
        self.held_bytes -= size_bytes
        return delivery

    def release_next(self) -> list[Delivery]:
        """Removes and returns the held messages that are next in order."""
        ready = []
        while self.next in self.held:
            ready.append(self.release(self.next))
            self.next += 1
        return ready

    def skip_to(self, held_from: int) -> list[Delivery]:
        """The held messages that may be delivered because the source keeps no message below `held_from` any more.

        The missing ones were acknowledged by an earlier start of this receiver, whose state was lost.
        """
        ready = [self.release(sequence) for sequence in sorted(self.held) if sequence < held_from]
        self.next = held_from
        return [*ready, *self.release_next()]


class CustodyReceiver:
    """The messages under custody that come from the other side."""

    def __init__(self, config: CustodyConfig | None = None) -> None:
        self._config = config or CustodyConfig()
        self._pause = seconds(self._config.ack_pause_s)
        self._streams: dict[tuple[Topic, str, int], _Stream] = {}

    def received(
        self, topic: Topic, header: Header, body: Wire | None, size_bytes: int, now: MissionTime
    ) -> tuple[list[Delivery], list[Acknowledgement]]:
        """The messages to deliver now, in order, and the acknowledgements to send once they are in the journal."""
        stream = self._stream(topic, header)
        ready: list[Delivery] = []
        if header.held_from is not None and header.held_from > stream.next:
            ready += stream.skip_to(header.held_from)
        sequence = header.sequence
        if sequence == stream.next:
            ready.append(Delivery(topic, header, body))
            stream.next += 1
            ready += stream.release_next()
        elif sequence > stream.next and sequence not in stream.held:
            if not self._has_room(stream, size_bytes):
                return ready, []
            stream.held[sequence] = (Delivery(topic, header, body), size_bytes)
            stream.held_bytes += size_bytes
        stream.last = Arrival(sequence, header.repetition, now)
        if stream.acknowledged_at is None or stream.acknowledged_at + self._pause <= now:
            return ready, [_acknowledge(topic, header.source, header.incarnation, stream, now)]
        stream.ack_at = stream.acknowledged_at + self._pause
        return ready, []

    def next_timer(self) -> MissionTime | None:
        """When `timer_elapsed` is to be called; None if no acknowledgement waits."""
        return min((stream.ack_at for stream in self._streams.values() if stream.ack_at is not None), default=None)

    def timer_elapsed(self, now: MissionTime) -> list[Acknowledgement]:
        """The acknowledgements that are due."""
        return [
            _acknowledge(topic, source, incarnation, stream, now)
            for (topic, source, incarnation), stream in self._streams.items()
            if stream.ack_at is not None and stream.ack_at <= now
        ]

    def _stream(self, topic: Topic, header: Header) -> _Stream:
        key = (topic, header.source, header.incarnation)
        stream = self._streams.pop(key, None) or _Stream()
        self._streams[key] = stream  # at the end, so it is forgotten last
        if len(self._streams) > MAX_STREAMS:
            del self._streams[next(iter(self._streams))]
        return stream

    def _has_room(self, stream: _Stream, size_bytes: int) -> bool:
        config = self._config
        return len(stream.held) < config.max_held and stream.held_bytes + size_bytes <= config.max_held_bytes

    # --- checkpoints --------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """Every stream, the least recently used first, as named parts."""
        return {
            "streams": {
                key: {
                    "next": stream.next,
                    "held": dict(stream.held),
                    "held_bytes": stream.held_bytes,
                    "last": stream.last,
                    "acknowledged_at": stream.acknowledged_at,
                    "ack_at": stream.ack_at,
                }
                for key, stream in self._streams.items()
            }
        }

    def restore(self, state: SavedState) -> None:
        """Restore the receiver from this state."""
        self._streams = {key: _Stream(**parts) for key, parts in state["streams"].items()}


def _acknowledge(topic: Topic, source: str, incarnation: int, stream: _Stream, now: MissionTime) -> Acknowledgement:
    """The acknowledgement of everything that the stream has received; no further one is due."""
    stream.acknowledged_at, stream.ack_at = now, None
    edges = [stream.next - 1, *sorted(stream.held)]
    gaps = [(before + 1, after - 1) for before, after in pairwise(edges) if after > before + 1]
    complete = edges[-1] + 1
    if len(gaps) > MAX_GAPS:  # nothing is said of what lies beyond the last gap that fits
        complete = gaps[MAX_GAPS][0]
        gaps = gaps[:MAX_GAPS]
    last = stream.last
    return Acknowledgement(
        stream=topic.name,
        source=source,
        incarnation=incarnation,
        next_sequence=complete,
        gaps=tuple(gaps),
        last_sequence=None if last is None else last.sequence,
        last_repetition=0 if last is None else last.repetition,
        last_received_at=None if last is None else last.at,
    )

"""The receiver's half of custody: delivers each message once and in the order of its stream, and acknowledges it.

A stream is a topic, its source and that source's incarnation. A message that comes out of turn is held until the
missing ones have come; one that was delivered or is held already is a duplicate. Both are acknowledged, so the sender
knows what to repeat. Only the acknowledgement of a delivered message is final. A held message is lost in a restart, so
the sender keeps it.

A source says with each message which ones it no longer keeps (`held_from`). A receiver that has lost its state believes
that and skips them. A later message that names a lower number contradicts it: it is an old copy, or the claim was
forged. It is neither delivered nor acknowledged, so its source repeats it. If more of them come when old copies can no
longer be under way, the receiver goes back. So a forged number delays a stream by some round trips, and loses nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from schemas.link import MAX_GAPS, Acknowledgement
from services.mission.mission_time import MissionTime, seconds
from services.runtime.custody.protocol import CustodyConfig

if TYPE_CHECKING:
    from schemas.topics import Topic
    from schemas.wire import Header, Wire
    from services.runtime.node import SavedState

MAX_INCARNATIONS: Final = 16
"""Streams of one topic and source whose state is kept; the least recently used one is dropped first."""
MAX_PARTS: Final = 64
"""Separate parts of a skipped range that were delivered all the same, at most."""


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


CONTRADICTIONS: Final = 2
"""So many messages in a row that contradict a skipped range show that it was skipped wrongly."""

Part = tuple[int, int]
"""A range of sequences: the first, and one past the last."""


@dataclass(frozen=True, slots=True)
class Skip:
    """A range of a stream that was skipped because its source said that it keeps none of it."""

    first: int
    end: int
    at: MissionTime
    """When the last part of it was skipped."""
    delivered: tuple[Part, ...] = ()
    """The parts that were delivered nevertheless, ascending."""
    contradicted: int = 0
    """Messages in a row that say that their source keeps some of the range, and are no old copies."""

    def lacks(self, sequence: int) -> bool:
        """Whether that message belongs to the range and was not delivered."""
        return self.first <= sequence < self.end and not _within(self.delivered, sequence)


@dataclass(slots=True)
class _Stream:
    next: int = 0
    """Every message below it is delivered or skipped."""
    skipped: Skip | None = None
    done: tuple[Part, ...] = ()
    """Delivered parts beyond `next`, ascending: what came before the receiver went back."""
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
        while True:
            if self.next in self.held:
                ready.append(self.release(self.next))
                self.next += 1
            elif self.done and self.done[0][0] <= self.next:
                self.next = max(self.next, self.done[0][1])
                self.done = self.done[1:]
            else:
                return ready

    def has(self, sequence: int) -> bool:
        """Whether that message was delivered, skipped or is held."""
        return sequence < self.next or sequence in self.held or _within(self.done, sequence)

    def skip_to(self, held_from: int, now: MissionTime) -> list[Delivery]:
        """The held messages that may be delivered because the source keeps no message below `held_from` any more.

        The missing ones were acknowledged by an earlier start of this receiver, whose state was lost.
        """
        released = [sequence for sequence in sorted(self.held) if sequence < held_from]
        ready = [self.release(sequence) for sequence in released]
        before = self.skipped
        delivered = [part for part in self.done if part[0] < held_from]
        delivered += [(sequence, sequence + 1) for sequence in released]
        first = self.next
        if before is not None:
            first = before.first
            delivered += [*before.delivered, (before.end, self.next)]
        parts = sorted(part for part in delivered if part[0] < part[1])
        if len(parts) > MAX_PARTS:
            first, parts = parts[-MAX_PARTS][0], parts[-MAX_PARTS:]
        self.skipped = Skip(first, held_from, now, tuple(parts))
        self.next = held_from
        return [*ready, *self.release_next()]

    def trusts(self, header: Header, now: MissionTime, copies_under_way: MissionTime) -> bool:
        """Whether the message can be received: it fits to what was skipped, or the stream has gone back for it."""
        skip = self.skipped
        if skip is None:
            return True
        if header.held_from is None:
            return not skip.lacks(header.sequence)
        if header.held_from >= skip.end:
            self.skipped = replace(skip, contradicted=0) if skip.contradicted else skip
            return True
        if now < skip.at + copies_under_way:
            return not skip.lacks(header.sequence) and header.sequence < self.next
        if skip.contradicted + 1 < CONTRADICTIONS:
            self.skipped = replace(skip, contradicted=skip.contradicted + 1)
            return False
        self._go_back(skip, header.held_from)
        return True

    def _go_back(self, skip: Skip, held_from: int) -> None:
        """Expect again what was skipped from `held_from` on."""
        self.done = (*skip.delivered, (skip.end, self.next), *self.done)
        self.next = max(skip.first, held_from)
        self.skipped = replace(skip, end=self.next, delivered=(), contradicted=0) if self.next > skip.first else None
        self.held.clear()  # its source keeps what is held
        self.held_bytes = 0
        self.done = tuple(part for part in self.done if part[0] < part[1] and part[1] > self.next)


class CustodyReceiver:
    """The messages under custody that come from the other side."""

    def __init__(self, config: CustodyConfig | None = None) -> None:
        self._config = config or CustodyConfig()
        self._pause = seconds(self._config.ack_pause_s)
        self._copies_under_way = 4 * seconds(self._config.round_trip_s + self._config.margin_s)
        self._streams: dict[tuple[Topic, str, int], _Stream] = {}

    def received(
        self, topic: Topic, header: Header, body: Wire | None, size_bytes: int, now: MissionTime
    ) -> tuple[list[Delivery], list[Acknowledgement]]:
        """The messages to deliver now, in order, and the acknowledgements to send once they are in the journal."""
        stream = self._stream(topic, header)
        ready: list[Delivery] = []
        sequence, held_from = header.sequence, header.held_from or 0
        if held_from > stream.next:
            ready += stream.skip_to(held_from, now)
        if not stream.trusts(header, now, self._copies_under_way):
            return ready, []
        if sequence == stream.next:
            ready.append(Delivery(topic, header, body))
            stream.next += 1
            ready += stream.release_next()
        elif not stream.has(sequence):
            if not self._has_room(stream, size_bytes):
                return ready, []
            stream.held[sequence] = (Delivery(topic, header, body), size_bytes)
            stream.held_bytes += size_bytes
        stream.last = Arrival(sequence, header.repetition, now)
        if stream.acknowledged_at is None or stream.acknowledged_at + self._pause <= now:
            return ready, [_acknowledge(topic, header.source, header.incarnation, stream, now)]
        stream.ack_at = stream.acknowledged_at + self._pause
        return ready, []

    def objection(self, topic: Topic, header: Header) -> str | None:
        """One line on a message whose sequence its source cannot have reached; None if there is nothing to object.

        A source has a bounded number of messages under way, so the numbers of a known stream do not jump.
        """
        stream = self._streams.get((topic, header.source, header.incarnation))
        if stream is None:
            return None
        furthest = stream.next + self._config.max_held
        if header.sequence <= furthest:
            return None
        return f"{topic.name}: expected a sequence up to {furthest} of {header.source}, got {header.sequence}"

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
        same = [other for other in self._streams if other[:2] == key[:2]]
        if len(same) > MAX_INCARNATIONS:
            del self._streams[same[0]]
        return stream

    def _has_room(self, stream: _Stream, size_bytes: int) -> bool:
        """Whether the stream may hold that much more; what the least recently used others hold is dropped for it."""
        config = self._config
        if len(stream.held) >= config.max_held or stream.held_bytes + size_bytes > config.max_held_bytes:
            return False
        held_bytes = sum(each.held_bytes for each in self._streams.values()) + size_bytes
        for other in self._streams.values():
            if held_bytes <= config.max_held_bytes:
                break
            if other is not stream and other.held:  # its source keeps them, and sends them again
                held_bytes -= other.held_bytes
                other.held.clear()
                other.held_bytes = 0
        return True

    # --- checkpoints --------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """Every stream, the least recently used first, as named parts."""
        return {
            "streams": {
                key: {
                    "next": stream.next,
                    "skipped": stream.skipped,
                    "done": stream.done,
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


def _within(parts: tuple[Part, ...], sequence: int) -> bool:
    return any(first <= sequence < end for first, end in parts)


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

"""What an outbox remembers of the messages that it keeps, and what an acknowledgement says of them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from schemas.link import Acknowledgement
from schemas.topics import Topic
from services.runtime.custody.protocol import MAX_GAPS, State
from services.runtime.node import MissionTime


class Sending(NamedTuple):
    """One time that a message was sent."""

    number: int
    """Counts the sendings of all messages."""
    at: MissionTime
    last_bit_at: MissionTime
    """When it should have left at the known rate."""


@dataclass(slots=True, eq=False)
class Kept:
    """A message and where it stands."""

    topic: Topic
    incarnation: int
    sequence: int
    payload: bytes
    priority: int
    order: int
    state: State = State.WAITING
    repetitions: int = 0
    """How often it was sent; what was restored counts as sent once in its earlier life."""
    sendings: dict[int, Sending] = field(default_factory=dict)
    """The first and the latest, by repetition."""
    queued: bool = False

    @property
    def turn(self) -> tuple[int, int]:
        return self.priority, self.order

    @property
    def last_sending(self) -> int:
        return next(reversed(self.sendings.values())).number if self.sendings else 0

    @property
    def last_sent_at(self) -> MissionTime:
        return next(reversed(self.sendings.values())).at if self.sendings else 0


@dataclass(slots=True, eq=False)
class Stream:
    """The messages of one topic and incarnation that are not yet acknowledged."""

    kept: dict[int, Kept] = field(default_factory=dict)
    """By sequence, rising."""
    sent: dict[int, Kept] = field(default_factory=dict)
    """Those under way, in the order of sending."""
    held: dict[int, Kept] = field(default_factory=dict)
    """Those that the receiver has out of turn."""
    in_turn: bool = True
    """False while an earlier incarnation of the topic has messages left, or what was restored is not yet sorted out."""
    doublings: int = 0
    in_vain: int = 0
    """Repetitions since the other side was last heard."""
    waits_since: MissionTime = 0
    newest_ack: tuple[int, int] = (-1, -1)

    @property
    def oldest_sent(self) -> Kept | None:
        """The message whose time is up first."""
        return next(iter(self.sent.values()), None) or next(iter(self.held.values()), None)

    def witness(self, ack: Acknowledgement) -> int:
        """Number of the latest sending that is known to have come, as far as this acknowledgement shows; 0: none."""
        witness = 0
        for sequence, kept in self.kept.items():
            if sequence >= ack.next_sequence:
                break
            if kept.state is State.SENT and len(kept.sendings) == 1 and not missing(ack, sequence):
                witness = max(witness, kept.last_sending)
        sending = self.last_to_come(ack)
        return max(witness, sending.number) if sending is not None else witness

    def last_to_come(self, ack: Acknowledgement) -> Sending | None:
        """The sending whose arrival brought this acknowledgement about, if it is of this life and still remembered."""
        kept = self.kept.get(ack.last_sequence) if ack.last_sequence is not None else None
        sending = kept.sendings.get(ack.last_repetition) if kept is not None else None
        if sending is None or ack.last_received_at is None or sending.at > ack.last_received_at:
            return None
        return sending


def turn(kept: Kept) -> tuple[int, int]:
    """What messages are sorted by in a queue."""
    return kept.turn


def missing(ack: Acknowledgement, sequence: int) -> bool:
    """Whether the receiver says that it does not have that sequence."""
    if sequence >= ack.next_sequence:
        return len(ack.gaps) < MAX_GAPS  # one that is full of gaps says nothing of what lies beyond
    index = bisect_right(ack.gaps, sequence, key=lambda gap: gap[0]) - 1
    return index >= 0 and ack.gaps[index][0] <= sequence <= ack.gaps[index][1]


def below(kept: dict[int, Kept], limit: int) -> Iterator[int]:
    """The sequences below that limit, rising."""
    for sequence in kept:
        if sequence >= limit:
            return
        yield sequence

"""The sender's streams: the messages of one topic and incarnation, and their state according to an acknowledgement."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from schemas.link import MAX_GAPS
from services.runtime.custody.protocol import MessageState, Signal, next_state

if TYPE_CHECKING:
    from schemas.link import Acknowledgement
    from schemas.topics import Topic
    from schemas.wire import Header
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState

REMEMBERED_TRANSMISSIONS: Final = 8
"""Transmissions of one message whose times are known: the first and the latest."""


@dataclass(frozen=True, slots=True)
class Transmission:
    """One time that a message was sent."""

    number: int
    """Counts the transmissions of all messages, from 1."""
    at: MissionTime
    last_bit_at: MissionTime
    """When the last bit leaves, at the known rate."""


@dataclass(slots=True, eq=False)
class KeptMessage:
    """A message that is not yet acknowledged, and where it stands."""

    topic: Topic
    incarnation: int
    sequence: int
    payload: bytes
    priority: int
    order: int
    """Counts the messages offered."""
    state: MessageState = MessageState.WAITING
    repetitions: int = 0
    """How often the message was sent so far."""
    transmissions: dict[int, Transmission] = field(default_factory=dict)
    """Transmissions by repetition, in order."""
    queued: bool = False
    """Whether it is in the window's queue."""

    @property
    def turn(self) -> tuple[int, int]:
        """Sort key: messages are sent in this order."""
        return self.priority, self.order

    @property
    def last_transmission(self) -> int:
        """Number of its last transmission; 0 if it has not been sent."""
        return next(reversed(self.transmissions.values())).number if self.transmissions else 0

    @property
    def last_sent_at(self) -> MissionTime:
        return next(reversed(self.transmissions.values())).at if self.transmissions else 0

    def signal(self, signal: Signal) -> None:
        """Move the message to its next state by the table of `protocol`."""
        self.state = next_state(self.state, signal)

    def transmitted(self, transmission: Transmission) -> None:
        """Note that it was sent once more."""
        if len(self.transmissions) >= REMEMBERED_TRANSMISSIONS:
            del self.transmissions[list(self.transmissions)[1]]  # the first is the most likely to have arrived first
        self.transmissions[self.repetitions] = transmission
        self.repetitions += 1
        self.signal(Signal.TRANSMITTED)


@dataclass(slots=True, eq=False)
class SendStream:
    """The messages of one topic and incarnation that are not yet acknowledged."""

    kept: dict[int, KeptMessage] = field(default_factory=dict)
    """Messages by sequence, ascending."""
    sent: dict[int, KeptMessage] = field(default_factory=dict)
    """Messages under way, in the order of sending."""
    held: dict[int, KeptMessage] = field(default_factory=dict)
    """Messages that the receiver holds out of turn."""
    in_turn: bool = True
    """False while an earlier incarnation of the topic has messages left."""
    doublings: int = 0
    """How often the wait has been doubled."""
    unanswered: int = 0
    """Repetitions since the last message from the other side."""
    waits_since: MissionTime = 0
    highest_sent: int = -1
    """Highest sequence that was ever sent: no other can be acknowledged."""
    newest_ack: tuple[MissionTime, int, int] = (-1, -1, -1)
    """Time, incarnation and sequence of the newest acknowledgement; see `made`."""

    @property
    def oldest_sent(self) -> KeptMessage | None:
        """The message whose timer runs: the one longest under way, else one that is held."""
        return next(iter(self.sent.values()), None) or next(iter(self.held.values()), None)

    def latest_arrival(self, ack: Acknowledgement) -> int:
        """Number of the latest transmission known to have arrived, by this acknowledgement; 0 if none is."""
        latest = 0
        for sequence in below(self.kept, ack.next_sequence):
            message = self.kept[sequence]
            if message.state is MessageState.SENT and len(message.transmissions) == 1 and not missing(ack, sequence):
                latest = max(latest, message.last_transmission)
        transmission = self.acknowledged_transmission(ack)
        return max(latest, transmission.number) if transmission is not None else latest

    def acknowledged_transmission(self, ack: Acknowledgement) -> Transmission | None:
        """The transmission whose arrival led to this acknowledgement, if it is of this start and still remembered."""
        message = self.kept.get(ack.last_sequence) if ack.last_sequence is not None else None
        transmission = message.transmissions.get(ack.last_repetition) if message is not None else None
        if transmission is None or ack.last_received_at is None or transmission.at > ack.last_received_at:
            return None
        return transmission

    # --- checkpoints --------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "kept": [_kept(message) for message in self.kept.values()],
            "sent": list(self.sent),
            "held": list(self.held),
            "in_turn": self.in_turn,
            "doublings": self.doublings,
            "unanswered": self.unanswered,
            "waits_since": self.waits_since,
            "highest_sent": self.highest_sent,
            "newest_ack": self.newest_ack,
        }

    @classmethod
    def restored(cls, state: SavedState) -> SendStream:
        """The stream restored from this state."""
        kept = {message["sequence"]: KeptMessage(**message) for message in state["kept"]}
        return cls(
            kept=kept,
            sent={sequence: kept[sequence] for sequence in state["sent"]},
            held={sequence: kept[sequence] for sequence in state["held"]},
            in_turn=state["in_turn"],
            doublings=state["doublings"],
            unanswered=state["unanswered"],
            waits_since=state["waits_since"],
            highest_sent=state["highest_sent"],
            newest_ack=state["newest_ack"],
        )


def _kept(message: KeptMessage) -> SavedState:
    return {
        "topic": message.topic,
        "incarnation": message.incarnation,
        "sequence": message.sequence,
        "payload": message.payload,
        "priority": message.priority,
        "order": message.order,
        "state": message.state,
        "repetitions": message.repetitions,
        "transmissions": dict(message.transmissions),
        "queued": message.queued,
    }


def made(header: Header, now: MissionTime) -> tuple[MissionTime, int, int]:
    """The order in which a source made its messages, as far as a message that comes now shows it.

    Time counts first, and no message was made after it came. So a number or a time that its source never reached
    outdates what follows for no longer than that was under way.
    """
    return min(header.made_at, now), header.incarnation, header.sequence


def missing(ack: Acknowledgement, sequence: int) -> bool:
    """Whether the receiver says that it does not have that sequence."""
    if sequence >= ack.next_sequence:
        return len(ack.gaps) < MAX_GAPS  # an acknowledgement full of gaps says nothing of what lies beyond
    index = bisect_right(ack.gaps, sequence, key=lambda gap: gap[0]) - 1
    return index >= 0 and ack.gaps[index][0] <= sequence <= ack.gaps[index][1]


def below(kept: dict[int, KeptMessage], limit: int) -> Iterator[int]:
    """The sequences below that limit, ascending."""
    for sequence in kept:
        if sequence >= limit:
            return
        yield sequence

"""Custody: a message is kept by its sender until its receiver has it, whatever the link does meanwhile.

`custody_outbox` keeps and repeats, `custody_inbox` puts in order, absorbs repetitions and acknowledges. Both are
without I/O. Here is what they share: the settings, the life of a kept message as one table, and the round trip.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

from he3.errors import He3Error
from schemas.link import Direction, DirectionConditions, LinkConditions
from schemas.topics import ACK_DOWN, ACK_UP, Custody, Topic
from services.runtime.node import SECOND, MissionTime

MAX_GAPS: Final = 64  # runs of missing messages that one acknowledgement may name, by its schema
MARGIN_S: Final = 2.0  # s beyond the round trip; covers the pause between acknowledgements and the timers' slack
ACK_BITS: Final = 3_600  # bits of one acknowledgement on the wire, about 450 bytes [calc]


class CustodyQueueFull(He3Error):
    """More messages await acknowledgement than the outbox may hold; nothing was dropped for the new one."""


@dataclass(frozen=True, slots=True)
class CustodyConfig:
    """How long to wait for an acknowledgement, and how much to keep. Times in seconds of mission time."""

    round_trip_s: float = 2.6
    """First guess; measured from then on."""
    margin_s: float = MARGIN_S
    """Waited beyond the round trip at least."""
    rate_bit_s: float | None = None
    """Rate at which this side's messages leave, as far as known: what queues ahead is waited for."""
    max_wait_s: float = 600.0
    """Repetitions of one message come at least this often while the other side is heard (or every two round trips)."""
    silent_repetitions: int = 4
    """So many repetitions with no word from the other side, and timers are suspended."""
    probe_s: float = 300.0
    """While suspended, one message is tried this often (or every two round trips, if that is more)."""
    max_messages: int = 100_000
    max_bytes: int = 256 * 1024 * 1024
    window_messages: int = 256
    """Sent and not yet acknowledged, at most; the rest waits here, in order of priority."""
    window_bytes: int = 4 * 1024 * 1024
    """A single larger message is sent alone."""
    ack_pause_s: float = 0.2
    """Two acknowledgements of one stream are at least this far apart."""
    max_held: int = 4_096
    """Messages of one stream that the inbox keeps while one before them is missing."""
    max_held_bytes: int = 32 * 1024 * 1024

    @classmethod
    def over(cls, link: LinkConditions, direction: Direction) -> CustodyConfig:
        """Settings for the sender of that direction, over a link with these conditions."""
        there, back = (link.up, link.down) if direction is Direction.UP else (link.down, link.up)
        light_s = there.one_way_light_time_s + back.one_way_light_time_s
        ack_s = 0.0 if back.rate_bit_s is None else ACK_BITS / back.rate_bit_s
        return cls(
            round_trip_s=light_s + ack_s,
            margin_s=MARGIN_S + _unsteadiness_s(there) + _unsteadiness_s(back) + ack_s,
            rate_bit_s=there.rate_bit_s,
        )


def _unsteadiness_s(way: DirectionConditions) -> float:
    return way.jitter_s + (way.one_way_light_time_s if way.reorder > 0 else 0.0)


class State(Enum):
    """Where a kept message stands."""

    WAITING = "waits to be sent"
    SENT = "sent, its timer runs"
    SUSPENDED = "sent, no contact, no timer"
    HELD = "with the receiver, who waits for one before it"
    ACKNOWLEDGED = "delivered, no longer kept"


class Signal(Enum):
    """What happens to a kept message."""

    TRANSMITTED = "it was sent"
    TIMED_OUT = "no acknowledgement in time"
    MISSED = "one sent after it came, it did not"
    SILENCE = "the other side has not been heard for long"
    HEARD = "the other side was heard again"
    OUT_OF_TURN = "the receiver has it, but not one before it"
    ACKNOWLEDGED = "the receiver has it and all before it"


TRANSITIONS: Final[dict[tuple[State, Signal], State]] = {
    (State.WAITING, Signal.TRANSMITTED): State.SENT,
    (State.WAITING, Signal.OUT_OF_TURN): State.HELD,  # an earlier sending came through after all
    (State.WAITING, Signal.ACKNOWLEDGED): State.ACKNOWLEDGED,
    (State.SENT, Signal.TIMED_OUT): State.WAITING,
    (State.SENT, Signal.MISSED): State.WAITING,
    (State.SENT, Signal.SILENCE): State.SUSPENDED,
    (State.SENT, Signal.OUT_OF_TURN): State.HELD,
    (State.SENT, Signal.ACKNOWLEDGED): State.ACKNOWLEDGED,
    (State.SUSPENDED, Signal.TIMED_OUT): State.WAITING,  # tried as a probe
    (State.SUSPENDED, Signal.HEARD): State.SENT,
    (State.SUSPENDED, Signal.OUT_OF_TURN): State.HELD,
    (State.SUSPENDED, Signal.ACKNOWLEDGED): State.ACKNOWLEDGED,
    (State.HELD, Signal.OUT_OF_TURN): State.HELD,
    (State.HELD, Signal.TIMED_OUT): State.WAITING,  # nothing else is left to try
    (State.HELD, Signal.MISSED): State.WAITING,  # the receiver restarted and no longer has it
    (State.HELD, Signal.ACKNOWLEDGED): State.ACKNOWLEDGED,
}
"""The whole life of a kept message: what is not in the table does not happen."""


def following(state: State, signal: Signal) -> State:
    """The state after the signal; raises He3Error, naming both, for a transition that is not in the table."""
    try:
        return TRANSITIONS[state, signal]
    except KeyError:
        raise He3Error(f"custody: a message that is '{state.value}' cannot see '{signal.value}'") from None


def under_custody(topic: Topic) -> bool:
    """Whether messages of that topic are kept until they are acknowledged."""
    return isinstance(topic.service, Custody) and topic.direction is not None


def acknowledged_on(topic: Topic) -> Topic:
    """The topic on which messages of that topic are acknowledged: the other way."""
    return ACK_DOWN if topic.direction is Direction.UP else ACK_UP


class RoundTrip:
    """The time [ns] from a message's last bit to its acknowledgement: mean and variation, smoothed as in RFC 6298."""

    def __init__(self, guess: MissionTime, margin: MissionTime) -> None:
        self._mean = guess
        self._variation: MissionTime = 0
        self._margin = margin

    @property
    def mean(self) -> MissionTime:
        return self._mean

    @property
    def wait(self) -> MissionTime:
        """How long to wait for an acknowledgement before the message is sent again [ns]."""
        return self._mean + max(self._margin, 4 * self._variation)

    def measured(self, round_trip: MissionTime) -> None:
        """Takes in one measurement [ns]."""
        self._variation += (abs(self._mean - round_trip) - self._variation) // 4
        self._mean += (round_trip - self._mean) // 8


def bits_time(size_bytes: int, rate_bit_s: float | None) -> MissionTime:
    """How long [ns] so many bytes take at that rate; 0 without one."""
    return 0 if rate_bit_s is None else round(8 * size_bytes * SECOND / rate_bit_s)

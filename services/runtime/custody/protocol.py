"""Custody: the settings of both halves, and the life of a message that is kept, as one table.

A sender keeps each message under custody until its receiver has acknowledged it. `sender` sends and repeats,
`receiver` orders, removes duplicates and acknowledges.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

from he3.errors import He3Error
from schemas.link import Direction, DirectionConditions, LinkConditions
from services.mission.mission_time import SECOND, MissionTime

MARGIN_S: Final = 2.0  # s beyond the round trip; covers the pause between acknowledgements and the timers' slack
ACK_BITS: Final = 3_600  # bits of one acknowledgement on the wire, about 450 bytes [calc]


class CustodyQueueFull(He3Error):
    """The sender keeps as many messages as it may. The new one was refused; none was dropped for it."""


@dataclass(frozen=True, slots=True)
class CustodyConfig:
    """Waiting times and capacities of custody. Times are in seconds of mission time."""

    round_trip_s: float = 2.6
    """First estimate of the round trip; later ones are measured."""
    margin_s: float = MARGIN_S
    """Least wait beyond the round trip."""
    rate_bit_s: float | None = None
    """Rate at which this side's messages leave, if known; the wait then includes the bytes queued ahead."""
    max_wait_s: float = 600.0
    """Longest time between two repetitions of a message while there is contact (or two round trips, if longer)."""
    silent_repetitions: int = 4
    """The timers are suspended after this many repetitions without any message from the other side."""
    probe_s: float = 300.0
    """While suspended, one message is sent this often (or every two round trips, if longer)."""
    max_messages: int = 100_000
    max_bytes: int = 256 * 1024 * 1024
    window_messages: int = 256
    """Messages sent and not yet acknowledged, at most; the others wait in order of priority."""
    window_bytes: int = 4 * 1024 * 1024
    """Total size of those messages, at most. A single larger message is sent alone."""
    ack_pause_s: float = 0.2
    """Least time between two acknowledgements of one stream."""
    max_held: int = 4_096
    """Messages of one stream that the receiver holds while an earlier one is missing."""
    max_held_bytes: int = 32 * 1024 * 1024

    @classmethod
    def over(cls, link: LinkConditions, direction: Direction) -> CustodyConfig:
        """Settings for the sender of that direction, over a link with these conditions."""
        there, back = (link.up, link.down) if direction is Direction.UP else (link.down, link.up)
        light_s = there.one_way_light_time_s + back.one_way_light_time_s
        ack_s = 0.0 if back.rate_bit_s is None else ACK_BITS / back.rate_bit_s
        return cls(
            round_trip_s=light_s + ack_s,
            margin_s=MARGIN_S + _variation_s(there) + _variation_s(back) + ack_s,
            rate_bit_s=there.rate_bit_s,
        )


def _variation_s(way: DirectionConditions) -> float:
    """The longest delay of a message beyond the light time [s]."""
    return way.jitter_s + (way.one_way_light_time_s if way.reorder > 0 else 0.0)


class MessageState(Enum):
    """States of a kept message."""

    WAITING = "waiting to be sent"
    SENT = "sent, timer running"
    SUSPENDED = "sent, no contact, no timer"
    HELD = "held by the receiver, an earlier one is missing"
    ACKNOWLEDGED = "delivered, no longer kept"


class Signal(Enum):
    """Events of a kept message."""

    TRANSMITTED = "transmitted"
    TIMED_OUT = "not acknowledged in time"
    MISSED = "overtaken by one sent later"
    SILENCE = "contact lost"
    CONTACT = "contact regained"
    OUT_OF_TURN = "received, an earlier one is missing"
    ACKNOWLEDGED = "received with all before it"


TRANSITIONS: Final[dict[tuple[MessageState, Signal], MessageState]] = {
    (MessageState.WAITING, Signal.TRANSMITTED): MessageState.SENT,
    (MessageState.WAITING, Signal.OUT_OF_TURN): MessageState.HELD,  # an earlier transmission arrived after all
    (MessageState.WAITING, Signal.ACKNOWLEDGED): MessageState.ACKNOWLEDGED,
    (MessageState.SENT, Signal.TIMED_OUT): MessageState.WAITING,
    (MessageState.SENT, Signal.MISSED): MessageState.WAITING,
    (MessageState.SENT, Signal.SILENCE): MessageState.SUSPENDED,
    (MessageState.SENT, Signal.OUT_OF_TURN): MessageState.HELD,
    (MessageState.SENT, Signal.ACKNOWLEDGED): MessageState.ACKNOWLEDGED,
    (MessageState.SUSPENDED, Signal.TIMED_OUT): MessageState.WAITING,  # sent as a probe
    (MessageState.SUSPENDED, Signal.CONTACT): MessageState.SENT,
    (MessageState.SUSPENDED, Signal.OUT_OF_TURN): MessageState.HELD,
    (MessageState.SUSPENDED, Signal.ACKNOWLEDGED): MessageState.ACKNOWLEDGED,
    (MessageState.HELD, Signal.OUT_OF_TURN): MessageState.HELD,
    (MessageState.HELD, Signal.TIMED_OUT): MessageState.WAITING,  # no other message of the stream is left to repeat
    (MessageState.HELD, Signal.MISSED): MessageState.WAITING,  # the receiver restarted and no longer holds it
    (MessageState.HELD, Signal.ACKNOWLEDGED): MessageState.ACKNOWLEDGED,
}
"""Every transition of a kept message; any other is an error."""


def next_state(state: MessageState, signal: Signal) -> MessageState:
    """The state after the signal; raises He3Error, naming both, for a transition that is not in the table."""
    try:
        return TRANSITIONS[state, signal]
    except KeyError:
        raise He3Error(f"custody: no transition from '{state.value}' upon '{signal.value}'") from None


def transmission_time(size_bytes: int, rate_bit_s: float | None) -> MissionTime:
    """Time [ns] to transmit that many bytes at that rate; 0 if the rate is not known."""
    return 0 if rate_bit_s is None else round(8 * size_bytes * SECOND / rate_bit_s)

"""One direction of the link: a transmitter, a queue in front of it, and the space behind it.

A letter waits until the transmitter is free and there is contact, is sent at the direction's rate, and arrives one
light time after its last bit left: arrival = departure + transmission time + light time, in integer nanoseconds.
The rules, where a choice had to be made:

- Lower priority values are sent first, equal ones in the order in which they were offered; nothing is interrupted.
- Of topics where only the newest counts, a newer letter takes the place of the older one that still waits; and so
  does the repetition of a message under custody, which therefore never waits twice.
- A letter is not begun when contact would end before its last bit; a smaller one that fits goes first. One that is
  longer than any contact to come is sent in pieces, with pauses where there is no contact (only with `hold`).
- What conditions say holds for what begins to be sent from then on; what is under way keeps its arrival.
- Letters lost, doubled, held back or damaged are drawn from the generator, the same number of draws for each letter,
  so that changing one condition leaves the draws for all others as they were.
- With `drop`, what is offered out of contact, or still waits when contact ends, is lost.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left, insort
from dataclasses import dataclass, replace
from enum import StrEnum
from random import Random

from schemas.link import AtEdge, DirectionConditions, DirectionCounts
from schemas.topics import Custody
from services.link.contact import Contact, Span
from services.link.packet import Packet
from services.runtime.node import SECOND, MissionTime, seconds


class Reason(StrEnum):
    """Why a letter will never arrive."""

    LOST = "lost on the way"
    OUT_OF_CONTACT = "out of contact"
    QUEUE_FULL = "queue full"
    SUPERSEDED = "replaced by a newer one while it waited"


@dataclass(frozen=True, slots=True)
class Drop:
    """A letter that will not arrive."""

    packet: Packet
    reason: Reason
    at: MissionTime


@dataclass(frozen=True, slots=True)
class Flight:
    """A letter that has begun to be sent, with the payload that will come out."""

    packet: Packet
    payload: bytes
    departs_at: MissionTime
    arrives_at: MissionTime


@dataclass(frozen=True, slots=True)
class Limits:
    """How much a direction holds."""

    waiting: int = 10_000
    """Letters in front of the transmitter."""
    waiting_bytes: int = 64 * 1024 * 1024
    flying: int = 100_000
    """Letters under way."""


@dataclass(slots=True)
class _Tally:
    offered: int = 0
    repeated: int = 0
    delivered: int = 0
    lost: int = 0
    dropped_out_of_contact: int = 0
    dropped_queue_full: int = 0
    superseded: int = 0
    duplicated: int = 0
    corrupted: int = 0
    bytes_delivered: int = 0


@dataclass(frozen=True, slots=True)
class _Fate:
    """What the draws for one letter say, each uniform in [0, 1) but for the seed of the damage."""

    damage: int
    loss: float
    jitter: float
    reorder: float
    held_back: float
    duplicate: float
    second_held_back: float
    corrupt: float

    @classmethod
    def drawn(cls, generator: Random) -> _Fate:
        damage = generator.getrandbits(64)
        return cls(damage, *(generator.random() for _ in range(7)))


class Channel:
    """What is offered at one end, and when it comes out at the other. Time never runs backwards between calls."""

    def __init__(
        self,
        conditions: DirectionConditions,
        contact: Contact,
        generator: Random,
        at_edge: AtEdge = AtEdge.HOLD,
        limits: Limits | None = None,
    ) -> None:
        self._conditions = conditions
        self._contact = contact
        self._at_edge = at_edge
        self._generator = generator
        self._limits = limits or Limits()
        self._waiting: list[Packet] = []  # by (priority, order)
        self._waiting_bytes = 0
        self._flying: list[tuple[MissionTime, int, Flight]] = []  # heap by (arrival, count)
        self._flights = 0
        self._seen: MissionTime = 0  # everything that had to begin before this time has begun
        self._free_at: MissionTime = 0  # when the transmitter ends what it is sending
        self._last_arrival: MissionTime = 0
        self._tally = _Tally()
        self._highest: dict[tuple[str, ...], int] = {}  # sequence offered so far, of each stream under custody
        self._drops: list[Drop] = []

    def offer(self, packet: Packet, now: MissionTime) -> None:
        """Takes a letter in; it leaves at once when nothing is before it and there is contact."""
        self.advance(now)
        self._tally.offered += 1
        self._tally.repeated += self._is_repetition(packet)
        if self._at_edge is AtEdge.DROP and not self._contact.open_at(now):
            self._drop(packet, Reason.OUT_OF_CONTACT, now)
            return
        if not self._replaces(packet, now) and self._has_room_for(packet, now):
            insort(self._waiting, packet, key=_turn)
            self._waiting_bytes += len(packet.payload)
        self.advance(now)

    def advance(self, now: MissionTime) -> None:
        """Begins to send everything whose turn has come by now, each at its own time."""
        while self._waiting and self._begin_next(now):
            pass
        self._seen = max(self._seen, now)

    def change(self, conditions: DirectionConditions, contact: Contact, at_edge: AtEdge, now: MissionTime) -> None:
        """Puts other conditions in force for what begins to be sent from now on."""
        self.advance(now)
        self._conditions, self._contact, self._at_edge = conditions, contact, at_edge
        self.advance(now)

    def reseed(self, generator: Random) -> None:
        """Draws from another generator from now on."""
        self._generator = generator

    def arrived(self, now: MissionTime) -> list[Flight]:
        """Takes out what has arrived by now, in the order of arrival, then of departure."""
        self.advance(now)
        flights = []
        while self._flying and self._flying[0][0] <= now:
            flight = heapq.heappop(self._flying)[2]
            self._tally.delivered += 1
            self._tally.bytes_delivered += len(flight.payload)
            flights.append(flight)
        return flights

    def next_event(self) -> MissionTime | None:
        """When something arrives or may begin to be sent next; None: only an offer or a change can move anything."""
        times = [self._flying[0][0]] if self._flying else []
        if self._waiting:
            if self._free_at > self._seen:
                times.append(self._free_at)
            change = self._contact.changes_at(self._seen)
            if change is not None:
                times.append(change)
        return min(times, default=None)

    def drops(self) -> list[Drop]:
        """What was found to be lost since the last call, oldest first."""
        drops, self._drops = self._drops, []
        return drops

    def flights(self) -> list[Flight]:
        """What is under way, next to arrive first."""
        return [entry[2] for entry in sorted(self._flying, key=lambda entry: entry[:2])]

    def waiting(self) -> list[Packet]:
        """What waits to be sent, next to go first."""
        return list(self._waiting)

    @property
    def idle(self) -> bool:
        """Whether nothing waits and nothing is under way."""
        return not self._waiting and not self._flying

    @property
    def counts(self) -> DirectionCounts:
        """What became of everything that was offered."""
        tally = self._tally
        return DirectionCounts(
            offered=tally.offered,
            repeated=tally.repeated,
            delivered=tally.delivered,
            lost=tally.lost,
            dropped_out_of_contact=tally.dropped_out_of_contact,
            dropped_queue_full=tally.dropped_queue_full,
            superseded=tally.superseded,
            duplicated=tally.duplicated,
            corrupted=tally.corrupted,
            waiting=len(self._waiting),
            in_flight=len(self._flying),
            bytes_delivered=tally.bytes_delivered,
        )

    # --- the queue ----------------------------------------------------------------------------------------------

    def _is_repetition(self, packet: Packet) -> bool:
        """Whether the message was offered before: under custody, a stream's new messages come in their order."""
        if not isinstance(packet.topic.service, Custody) or not packet.subject:
            return False
        stream = packet.subject[:-1]
        highest = self._highest.get(stream, -1)
        self._highest[stream] = max(highest, packet.sequence)
        return packet.sequence <= highest

    def _replaces(self, packet: Packet, now: MissionTime) -> bool:
        """Puts the letter in the place of an older one of its subject; False when there is none that waits."""
        if not packet.subject:
            return False
        for index, older in enumerate(self._waiting):
            if older.subject == packet.subject:
                self._drop(older, Reason.SUPERSEDED, now)
                self._waiting[index] = replace(packet, order=older.order)
                self._waiting_bytes += len(packet.payload) - len(older.payload)
                return True
        return False

    def _has_room_for(self, packet: Packet, now: MissionTime) -> bool:
        """Makes room by dropping what matters less, newest first; False when that is the letter itself."""
        limits, size = self._limits, len(packet.payload)
        if len(self._flying) >= limits.flying or size > limits.waiting_bytes:
            self._drop(packet, Reason.QUEUE_FULL, now)
            return False
        while len(self._waiting) >= limits.waiting or self._waiting_bytes + size > limits.waiting_bytes:
            least = self._waiting[-1]
            if least.priority <= packet.priority:
                self._drop(packet, Reason.QUEUE_FULL, now)
                return False
            self._remove(least)
            self._drop(least, Reason.QUEUE_FULL, now)
        return True

    def _remove(self, packet: Packet) -> None:
        del self._waiting[bisect_left(self._waiting, _turn(packet), key=_turn)]
        self._waiting_bytes -= len(packet.payload)

    def _drop(self, packet: Packet, reason: Reason, at: MissionTime) -> None:
        if reason is Reason.LOST:
            self._tally.lost += 1
        elif reason is Reason.OUT_OF_CONTACT:
            self._tally.dropped_out_of_contact += 1
        elif reason is Reason.QUEUE_FULL:
            self._tally.dropped_queue_full += 1
        else:
            self._tally.superseded += 1
        self._drops.append(Drop(packet, reason, at))

    # --- the transmitter ----------------------------------------------------------------------------------------

    def _begin_next(self, now: MissionTime) -> bool:
        """Sends the first waiting letter that can go by now, or drops what contact has left behind; False: neither."""
        free = max(self._seen, self._free_at)
        if self._at_edge is AtEdge.DROP and self._drop_at_edge(now):
            return True
        if free > now:
            return False
        span = self._contact.span_from(free)
        while span is not None and span.opens <= now:
            begins = max(free, span.opens)
            for packet in self._waiting:
                ends = self._last_bit(packet, begins, span)
                if ends is not None:
                    self._remove(packet)
                    self._send(packet, begins, ends)
                    return True
            span = self._contact.span_from(span.closes) if span.closes is not None else None
        return False

    def _drop_at_edge(self, now: MissionTime) -> bool:
        """With `drop`: loses all that waits when contact ends before the transmitter is free for it."""
        span = self._contact.span_from(self._seen)
        inside = span is not None and span.opens <= self._seen
        edge = span.closes if span is not None and inside else self._seen
        if edge is None or edge > now or (inside and self._free_at < edge and self._someone_fits(span)):
            return False
        for packet in self._waiting:
            self._drop(packet, Reason.OUT_OF_CONTACT, edge)
        self._waiting.clear()
        self._waiting_bytes = 0
        return True

    def _someone_fits(self, span: Span | None) -> bool:
        begins = max(self._seen, self._free_at)
        return span is not None and any(
            span.fits(begins, transmission_time(packet.size_bits, self._conditions.rate_bit_s))
            for packet in self._waiting
        )

    def _last_bit(self, packet: Packet, begins: MissionTime, span: Span) -> MissionTime | None:
        """When the last bit would leave if sending began then, within that contact; None: it may not begin."""
        duration = transmission_time(packet.size_bits, self._conditions.rate_bit_s)
        if span.fits(begins, duration):
            return begins + duration
        if self._at_edge is AtEdge.DROP:
            return None
        longest = self._contact.longest_from(begins)
        if longest is None or duration <= longest:
            return None
        return self._contact.after(begins, duration)

    def _send(self, packet: Packet, begins: MissionTime, ends: MissionTime) -> None:
        conditions, fate = self._conditions, _Fate.drawn(self._generator)
        self._free_at = ends
        if fate.loss < conditions.loss:
            self._drop(packet, Reason.LOST, begins)
            return
        light_time = seconds(conditions.one_way_light_time_s)
        jitter = round(seconds(conditions.jitter_s) * (2 * fate.jitter - 1))
        arrival = ends + max(0, light_time + jitter)
        if conditions.jitter_s > 0:
            arrival = max(arrival, self._last_arrival)
        payload = packet.payload
        if fate.corrupt < conditions.corrupt and payload:
            payload = damaged(payload, Random(fate.damage))
            self._tally.corrupted += 1
        if fate.reorder < conditions.reorder:
            arrival += round(light_time * fate.held_back)
        else:
            self._last_arrival = max(self._last_arrival, arrival)
        self._fly(Flight(packet, payload, begins, arrival))
        if fate.duplicate < conditions.duplicate:
            self._tally.duplicated += 1
            self._fly(Flight(packet, payload, begins, arrival + round(light_time * fate.second_held_back)))

    def _fly(self, flight: Flight) -> None:
        self._flights += 1
        heapq.heappush(self._flying, (flight.arrives_at, self._flights, flight))


def transmission_time(size_bits: int, rate_bit_s: float | None) -> int:
    """How long so many bits take at that rate [ns], rounded up; 0 without a rate. Exact for every float."""
    if rate_bit_s is None:
        return 0
    numerator, denominator = rate_bit_s.as_integer_ratio()
    return -(-size_bits * SECOND * denominator // numerator)


def damaged(payload: bytes, generator: Random) -> bytes:
    """The payload with one to four bytes changed."""
    damage = bytearray(payload)
    for position in generator.sample(range(len(payload)), min(len(payload), generator.randint(1, 4))):
        damage[position] ^= generator.randint(1, 255)
    return bytes(damage)


def _turn(packet: Packet) -> tuple[int, int]:
    return packet.priority, packet.order

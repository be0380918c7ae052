"""One direction of the link: a queue, a transmitter, and the path through space.

A packet waits until the transmitter is free and there is contact. It is sent at the direction's rate, and arrives one
light time after its last bit was sent: arrival = departure + transmission time + light time, in integer nanoseconds.
Where a choice had to be made, the rules are:

- Lower priority values are sent first, equal ones in the order in which they were offered. Sending is not interrupted.
- On topics where only the newest message counts, a newer packet takes the place of the older one that waits. So does
  the repetition of a message under custody, which therefore never waits twice.
- Sending does not begin if contact ends before the last bit; a smaller packet that fits goes first. A packet that is
  longer than any contact to come is sent in parts, with pauses while there is no contact (only with `hold`).
- Conditions apply to packets whose sending begins after the change. Packets in flight keep their arrival.
- With `drop`, a packet is lost that is offered out of contact, or that still waits when contact ends.
"""

from __future__ import annotations

import heapq
from collections import Counter, OrderedDict
from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING, Final

from schemas.link import AtEdge, DirectionConditions, DirectionCounts
from schemas.topics import Custody
from services.link.counts import Counts, DropReason
from services.link.impairments import Draws, transit
from services.link.transmit_queue import TransmitQueue
from services.mission.mission_time import SECOND, MissionTime

if TYPE_CHECKING:
    from services.link.contact import Contact, Span
    from services.link.packet import Packet


MAX_STREAMS: Final = 1_024
"""Streams under custody whose highest sequence is known, for the count of repetitions."""


@dataclass(frozen=True, slots=True)
class Drop:
    """A packet that will not arrive."""

    packet: Packet
    reason: DropReason
    at: MissionTime


@dataclass(frozen=True, slots=True)
class Flight:
    """A packet whose sending has begun, with the payload that will arrive."""

    packet: Packet
    payload: bytes
    departs_at: MissionTime
    arrives_at: MissionTime


@dataclass(frozen=True, slots=True)
class Limits:
    """Capacity of a direction."""

    waiting: int = 10_000
    """Packets in the queue."""
    waiting_bytes: int = 64 * 1024 * 1024
    flying: int = 100_000
    """Packets in flight."""
    flying_bytes: int = 64 * 1024 * 1024
    """Their payloads together. A flow (one topic and source) may have a quarter of both."""


class Channel:
    """One direction: packets enter by `offer` and leave by `arrived`. Time must not run backwards between calls."""

    def __init__(
        self,
        conditions: DirectionConditions,
        contact: Contact,
        generator: Random,
        at_edge: AtEdge = AtEdge.HOLD,
        limits: Limits | None = None,
    ) -> None:
        limits = limits or Limits()
        self._conditions = conditions
        self._contact = contact
        self._at_edge = at_edge
        self._generator = generator
        self._max_flying = limits.flying
        self._max_flying_bytes = limits.flying_bytes
        self._flying_of: Counter[tuple[str, str]] = Counter()  # packets, by flow
        self._flying_bytes_of: Counter[tuple[str, str]] = Counter()
        self._queue = TransmitQueue(limits.waiting, limits.waiting_bytes)
        self._flying: list[tuple[MissionTime, int, Flight]] = []  # heap by (arrival, number)
        self._flights = 0
        self._advanced_to: MissionTime = 0  # everything that had to begin before this time has begun
        self._free_at: MissionTime = 0  # when the transmitter ends what it is sending
        self._last_arrival: MissionTime = 0
        self._counts = Counts()
        self._highest: OrderedDict[tuple[str, ...], int] = OrderedDict()  # sequence, of each stream under custody
        self._drops: list[Drop] = []

    def offer(self, packet: Packet, now: MissionTime) -> None:
        """Accepts a packet; it is sent at once if no other packet waits and there is contact."""
        self.advance(now)
        self._counts.offered += 1
        self._counts.repeated += self._is_repetition(packet)
        if self._at_edge is AtEdge.DROP and not self._contact.open_at(now):
            self._drop(packet, DropReason.OUT_OF_CONTACT, now)
            return
        self._enqueue(packet, now)
        self.advance(now)

    def advance(self, now: MissionTime) -> None:
        """Begins to send every packet whose turn has come by now, each at its own time."""
        while self._queue and self._begin_next(now):
            pass
        if now > self._advanced_to:
            self._advanced_to = now

    def change(self, conditions: DirectionConditions, contact: Contact, at_edge: AtEdge, now: MissionTime) -> None:
        """Puts other conditions in force for packets whose sending begins from now on."""
        self.advance(now)
        self._conditions, self._contact, self._at_edge = conditions, contact, at_edge
        self.advance(now)

    def reseed(self, generator: Random) -> None:
        """Uses another random generator from now on."""
        self._generator = generator

    def arrived(self, now: MissionTime) -> list[Flight]:
        """Removes and returns the packets that have arrived by now, in the order of arrival, then of departure."""
        self.advance(now)
        flights: list[Flight] = []
        while self._flying and self._flying[0][0] <= now:
            flight = heapq.heappop(self._flying)[2]
            self._count_flight(flight, -1)
            self._counts.delivered += 1
            self._counts.bytes_delivered += len(flight.payload)
            flights.append(flight)
        return flights

    def next_event(self) -> MissionTime | None:
        """When the next packet arrives or may be sent; None if nothing happens without an offer or a change."""
        if not self._queue:
            return self._flying[0][0] if self._flying else None
        times = [self._flying[0][0]] if self._flying else []
        if self._free_at > self._advanced_to:
            times.append(self._free_at)
        change = self._contact.changes_at(self._advanced_to)
        if change is not None:
            times.append(change)
        return min(times, default=None)

    def drops(self) -> list[Drop]:
        """Removes and returns the drops since the last call, oldest first."""
        if not self._drops:
            return []
        drops, self._drops = self._drops, []
        return drops

    def flights(self) -> list[Flight]:
        """The packets in flight, next to arrive first."""
        return [entry[2] for entry in sorted(self._flying, key=lambda entry: entry[:2])]

    def waiting(self) -> list[Packet]:
        """The packets that wait to be sent, next first."""
        return list(self._queue)

    @property
    def idle(self) -> bool:
        """Whether no packet waits and none is in flight."""
        return not len(self._queue) and not self._flying

    @property
    def in_flight(self) -> int:
        """Packets whose sending has begun and that have not arrived."""
        return len(self._flying)

    @property
    def counts(self) -> DirectionCounts:
        """Counts of what happened to the packets offered."""
        return self._counts.report(waiting=len(self._queue), in_flight=self.in_flight)

    # --- the queue ------------------------------------------------------------------------------------------------

    def _is_repetition(self, packet: Packet) -> bool:
        """Whether the message was offered before: the new messages of a stream under custody come in order."""
        if not isinstance(packet.topic.service, Custody) or not packet.subject:
            return False
        stream = packet.subject[:-1]
        highest = self._highest.pop(stream, -1)
        self._highest[stream] = max(highest, packet.sequence)
        if len(self._highest) > MAX_STREAMS:
            self._highest.popitem(last=False)
        return packet.sequence <= highest

    def _enqueue(self, packet: Packet, now: MissionTime) -> None:
        older = self._queue.supersede(packet)
        if older is not None:
            self._drop(older, DropReason.SUPERSEDED, now)
            return
        dropped = [packet] if self._has_no_room_in_flight(packet) else self._queue.add(packet)
        for each in dropped:
            self._drop(each, DropReason.QUEUE_FULL, now)

    def _has_no_room_in_flight(self, packet: Packet) -> bool:
        if packet.urgent:
            return False
        flow = packet.flow
        return (
            len(self._flying) >= self._max_flying
            or self._flying_bytes_of.total() >= self._max_flying_bytes
            or 4 * self._flying_of[flow] >= self._max_flying
            or 4 * self._flying_bytes_of[flow] >= self._max_flying_bytes
        )

    def _count_flight(self, flight: Flight, sign: int) -> None:
        flow = flight.packet.flow
        self._flying_of[flow] += sign
        self._flying_bytes_of[flow] += sign * len(flight.payload)
        if not self._flying_of[flow]:
            del self._flying_of[flow], self._flying_bytes_of[flow]

    def _drop(self, packet: Packet, reason: DropReason, at: MissionTime) -> None:
        self._counts.add_drop(reason)
        self._drops.append(Drop(packet, reason, at))

    # --- the transmitter ------------------------------------------------------------------------------------------

    def _begin_next(self, now: MissionTime) -> bool:
        """Sends the first packet that may be sent by now, or drops those left when contact ended; False if neither."""
        free = max(self._advanced_to, self._free_at)
        if self._at_edge is AtEdge.DROP and self._drop_at_edge(now):
            return True
        if free > now:
            return False
        span = self._contact.span_from(free)
        while span is not None and span.opens <= now:
            begins = max(free, span.opens)
            for packet in self._queue:
                ends = self._last_bit_sent(packet, begins, span)
                if ends is not None:
                    self._queue.remove(packet)
                    self._send(packet, begins, ends)
                    return True
            span = self._contact.span_from(span.closes) if span.closes is not None else None
        return False

    def _drop_at_edge(self, now: MissionTime) -> bool:
        """With `drop`: drops all packets that wait if contact ends before the transmitter is free for one that fits."""
        span = self._contact.span_from(self._advanced_to)
        inside = span is not None and span.opens <= self._advanced_to
        edge = span.closes if span is not None and inside else self._advanced_to
        if edge is None or edge > now or (inside and self._free_at < edge and self._any_fits(span)):
            return False
        for packet in self._queue.clear():
            self._drop(packet, DropReason.OUT_OF_CONTACT, edge)
        return True

    def _any_fits(self, span: Span | None) -> bool:
        begins = max(self._advanced_to, self._free_at)
        return span is not None and any(span.fits(begins, self._duration(packet)) for packet in self._queue)

    def _last_bit_sent(self, packet: Packet, begins: MissionTime, span: Span) -> MissionTime | None:
        """When the last bit is sent if sending begins then, within that contact; None if it may not begin."""
        duration = self._duration(packet)
        if span.fits(begins, duration):
            return begins + duration
        if self._at_edge is AtEdge.DROP:
            return None
        longest = self._contact.longest_from(begins)
        if longest is None or duration <= longest:
            return None
        return self._contact.after(begins, duration)

    def _duration(self, packet: Packet) -> MissionTime:
        return transmission_time(packet.size_bits, self._conditions.rate_bit_s)

    def _send(self, packet: Packet, begins: MissionTime, ends: MissionTime) -> None:
        self._free_at = ends
        draws = Draws.of(self._generator)
        passage = transit(packet.payload, self._conditions, draws, self._last_arrival - ends)
        if passage is None:
            self._drop(packet, DropReason.LOST, begins)
            return
        self._counts.corrupted += passage.corrupted
        self._counts.duplicated += len(passage.delays) - 1
        if not passage.reordered:
            self._last_arrival = max(self._last_arrival, ends + passage.delays[0])
        for delay in passage.delays:
            self._flights += 1
            flight = Flight(packet, passage.payload, begins, ends + delay)
            self._count_flight(flight, 1)
            heapq.heappush(self._flying, (flight.arrives_at, self._flights, flight))


def transmission_time(size_bits: int, rate_bit_s: float | None) -> MissionTime:
    """Time to send that many bits at that rate [ns], rounded up; 0 without a rate. Exact for every float."""
    if rate_bit_s is None:
        return 0
    numerator, denominator = rate_bit_s.as_integer_ratio()
    return -(-size_bits * SECOND * denominator // numerator)

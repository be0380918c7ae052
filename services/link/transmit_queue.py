"""The queue in front of a transmitter: by priority, then in the order of offering; bounded in packets and bytes.

A flow is the packets of one topic and source. When the queue is full, a flow that has more than half of it makes room:
its newest packet is dropped. So no flow pushes out the others, whatever its priority. Urgent packets have places of
their own.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from services.link.packet import Packet


URGENT_PLACES: Final = 16
"""Urgent packets for which there is always room."""


class TransmitQueue:
    """Packets that wait to be sent."""

    def __init__(self, max_packets: int, max_bytes: int) -> None:
        self._max_packets = max_packets
        self._max_bytes = max_bytes
        self._packets: list[Packet] = []
        self._bytes = 0
        self._by_subject: dict[tuple[str, ...], Packet] = {}
        self._packets_of: Counter[tuple[str, str]] = Counter()
        self._bytes_of: Counter[tuple[str, str]] = Counter()
        self._urgent = 0

    def __len__(self) -> int:
        return len(self._packets)

    def __iter__(self) -> Iterator[Packet]:
        """The packets, next to be sent first."""
        return iter(self._packets)

    def supersede(self, packet: Packet) -> Packet | None:
        """Replaces a waiting packet of the same subject by this one; returns the older one, None if there is none."""
        if not packet.subject:
            return None
        older = self._by_subject.get(packet.subject)
        if older is None or older.priority != packet.priority:
            return None
        grown = len(packet.payload) - len(older.payload)
        if self._bytes + grown > self._max_bytes:
            return None  # it is added like any other, if there is room
        self.remove(older)
        self._insert(replace(packet, order=older.order))
        return older

    def add(self, packet: Packet) -> list[Packet]:
        """Adds the packet; returns the packets dropped to make room, possibly the packet itself.

        The newest packets of a flow that has more than half of the queue are dropped first, then those of lower
        priority, the newest of them first.
        """
        size = len(packet.payload)
        if size > self._max_bytes:
            return [packet]
        if packet.urgent:
            if self._urgent >= URGENT_PLACES:
                return [packet]
            self._insert(packet)
            return []
        dropped: list[Packet] = []
        while len(self._packets) - self._urgent >= self._max_packets or self._bytes + size > self._max_bytes:
            last = self._dispensable(packet)
            if last is None:
                return [*dropped, packet]
            self.remove(last)
            dropped.append(last)
        self._insert(packet)
        return dropped

    def _dispensable(self, packet: Packet) -> Packet | None:
        """The packet to drop for this one; None: this one."""
        flow = self._dominant_flow()
        if flow is not None:
            if flow == packet.flow:
                return None
            return next(each for each in reversed(self._packets) if each.flow == flow and not each.urgent)
        last = self._packets[-1]
        return None if last.priority <= packet.priority or last.urgent else last

    def _dominant_flow(self) -> tuple[str, str] | None:
        for counts, limit in ((self._packets_of, self._max_packets), (self._bytes_of, self._max_bytes)):
            for flow, count in counts.items():
                if 2 * count > limit:
                    return flow
        return None

    def _insert(self, packet: Packet) -> None:
        insort(self._packets, packet, key=_turn)
        if packet.subject:
            self._by_subject[packet.subject] = packet
        self._count(packet, 1)

    def remove(self, packet: Packet) -> None:
        """Takes out a packet that waits."""
        del self._packets[bisect_left(self._packets, _turn(packet), key=_turn)]
        if self._by_subject.get(packet.subject) is packet:
            del self._by_subject[packet.subject]
        self._count(packet, -1)

    def clear(self) -> list[Packet]:
        """Takes out and returns all packets."""
        packets = list(self._packets)
        for packet in packets:
            self.remove(packet)
        return packets

    def _count(self, packet: Packet, sign: int) -> None:
        size = sign * len(packet.payload)
        self._bytes += size
        if packet.urgent:
            self._urgent += sign
            return
        for counts, change in ((self._packets_of, sign), (self._bytes_of, size)):
            counts[packet.flow] += change
        if not self._packets_of[packet.flow]:
            del self._packets_of[packet.flow], self._bytes_of[packet.flow]


def _turn(packet: Packet) -> tuple[int, int]:
    return packet.priority, packet.order

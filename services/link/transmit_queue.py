"""The queue in front of a transmitter: by priority, then in the order of offering; bounded in packets and bytes."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from services.link.packet import Packet


class TransmitQueue:
    """Packets that wait to be sent."""

    def __init__(self, max_packets: int, max_bytes: int) -> None:
        self._max_packets = max_packets
        self._max_bytes = max_bytes
        self._packets: list[Packet] = []
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._packets)

    def __iter__(self) -> Iterator[Packet]:
        """The packets, next to be sent first."""
        return iter(self._packets)

    def supersede(self, packet: Packet) -> Packet | None:
        """Replaces a waiting packet of the same subject by this one; returns the older one, None if there is none."""
        if not packet.subject:
            return None
        for index, older in enumerate(self._packets):
            if older.subject == packet.subject:
                self._packets[index] = replace(packet, order=older.order)
                self._bytes += len(packet.payload) - len(older.payload)
                return older
        return None

    def add(self, packet: Packet) -> list[Packet]:
        """Adds the packet; returns the packets dropped to make room, possibly the packet itself.

        Packets of lower priority are dropped first, the newest of them first.
        """
        size = len(packet.payload)
        if size > self._max_bytes:
            return [packet]
        dropped: list[Packet] = []
        while len(self._packets) >= self._max_packets or self._bytes + size > self._max_bytes:
            last = self._packets[-1]
            if last.priority <= packet.priority:
                return [*dropped, packet]
            self.remove(last)
            dropped.append(last)
        insort(self._packets, packet, key=_turn)
        self._bytes += size
        return dropped

    def remove(self, packet: Packet) -> None:
        """Takes out a packet that waits."""
        del self._packets[bisect_left(self._packets, _turn(packet), key=_turn)]
        self._bytes -= len(packet.payload)

    def clear(self) -> list[Packet]:
        """Takes out and returns all packets."""
        packets, self._packets, self._bytes = self._packets, [], 0
        return packets


def _turn(packet: Packet) -> tuple[int, int]:
    return packet.priority, packet.order

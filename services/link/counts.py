"""Counts of the packets of one direction, by outcome."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum

from schemas.link import DirectionCounts


class DropReason(StrEnum):
    """Why a packet will not arrive."""

    LOST = "lost on the way"
    OUT_OF_CONTACT = "out of contact"
    QUEUE_FULL = "queue full"
    SUPERSEDED = "replaced by a newer one while it waited"


@dataclass(slots=True)
class Counts:
    """Totals since the channel was made; the fields are those of `DirectionCounts`."""

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

    def add_drop(self, reason: DropReason) -> None:
        """Counts a packet that will not arrive."""
        match reason:
            case DropReason.LOST:
                self.lost += 1
            case DropReason.OUT_OF_CONTACT:
                self.dropped_out_of_contact += 1
            case DropReason.QUEUE_FULL:
                self.dropped_queue_full += 1
            case DropReason.SUPERSEDED:
                self.superseded += 1

    def report(self, waiting: int, in_flight: int) -> DirectionCounts:
        """The counts as the link reports them."""
        return DirectionCounts(**asdict(self), waiting=waiting, in_flight=in_flight)

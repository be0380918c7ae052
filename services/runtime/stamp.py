"""The stamp of a message in virtual time, its Zenoh attachment. Payloads are the same as on the wall clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from schemas.link import LATEST_CLOCK_NS

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime


@dataclass(frozen=True, slots=True)
class Stamp:
    """Sender, number, step and time of a message."""

    sender: str
    process: str
    """Identifies the start of the sender."""
    number: int
    """Counts what the sender has sent."""
    step: int
    at: MissionTime

    def encode(self) -> bytes:
        return f"{self.sender}\t{self.process}\t{self.number}\t{self.step}\t{self.at}".encode()


def read_stamp(attachment: bytes) -> Stamp | None:
    """The stamp; None for any other attachment, which a message from outside the mission may have."""
    if not attachment or len(attachment) > _MAX_BYTES:
        return None
    try:
        sender, process, number, step, at = attachment.decode("ascii").split("\t")
        return Stamp(sender, process, _natural(number), _natural(step), _natural(at)) if sender else None
    except ValueError:
        return None


_MAX_BYTES = 250
_LIMIT = LATEST_CLOCK_NS


def _natural(digits: str) -> int:
    if not digits.isdigit():
        raise ValueError(f"expected digits, got {digits!r}")
    number = int(digits)
    if number >= _LIMIT:
        raise ValueError(f"expected a number below {_LIMIT}, got {digits}")
    return number

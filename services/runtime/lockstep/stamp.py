"""The stamp that travels beside each message in virtual time, as an attachment: payloads stay as they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime


@dataclass(frozen=True, slots=True)
class Stamp:
    """What travels beside a message in virtual time: who sent it as its how-manieth, in which step, at what time."""

    sender: str
    process: str
    """Which start of the sender."""
    number: int
    step: int
    at: MissionTime

    def encode(self) -> bytes:
        return f"{self.sender}\t{self.process}\t{self.number}\t{self.step}\t{self.at}".encode()


def read_stamp(attachment: bytes) -> Stamp | None:
    """The stamp, or None for a message from outside, whatever it carries."""
    if not attachment or len(attachment) > _MAX_BYTES:
        return None
    try:
        sender, process, number, step, at = attachment.decode("ascii").split("\t")
        return Stamp(sender, process, _natural(number), _natural(step), _natural(at)) if sender else None
    except ValueError:
        return None


_MAX_BYTES = 250


def _natural(digits: str) -> int:
    if not digits.isdigit():
        raise ValueError(f"expected digits, got {digits!r}")
    return int(digits)

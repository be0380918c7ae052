"""The stamp that travels beside each message in virtual time, as an attachment: payloads stay as they are."""

from __future__ import annotations

from dataclasses import dataclass

from services.node import MissionTime


@dataclass(frozen=True, slots=True)
class Stamp:
    """What travels beside a message in virtual time: who sent it as its how-manieth, in which step, at what time."""

    sender: str
    number: int
    step: int
    at: MissionTime

    def encode(self) -> bytes:
        return f"{self.sender}\t{self.number}\t{self.step}\t{self.at}".encode()


def read_stamp(attachment: bytes) -> Stamp | None:
    """The stamp, or None for a message from outside."""
    parts = attachment.decode(errors="replace").split("\t")
    if len(parts) != 4 or not all(part.isdigit() for part in parts[1:]):
        return None
    return Stamp(parts[0], int(parts[1]), int(parts[2]), int(parts[3]))

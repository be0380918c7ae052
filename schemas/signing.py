"""The bytes that a signature covers: the same at the signer and where it is verified, whatever carries the message.

`repetition`, `held_from` and the checksum change on the way and are not covered. The body counts as the bytes that are
sent: nothing is parsed and written again before it is verified.
"""

from __future__ import annotations

import json
from enum import StrEnum

from schemas.wire import Header

_PURPOSE = b"he3 message 1\n"
"""Prefix of the signed bytes, so that no other signature of a key counts as a message's."""


class Part(StrEnum):
    """What a signed text is: a signature of one does not count for another."""

    MESSAGE = "message"
    QUERY = "query"
    REPLY = "reply"
    AUTHORIZATION = "authorization"
    """The consent of a person to a command, which the ground passes on in messages of its own."""


def signed_bytes(part: Part, topic: str, header: Header, body: bytes) -> bytes:
    """The bytes to sign. topic: name in the topic table. body: as it is sent."""
    fields = (
        part.value,
        topic,
        header.version,
        header.mission,
        header.instance,
        header.source,
        header.incarnation,
        header.sequence,
        header.made_at,
        header.expires_at,
        header.start,
        header.signer,
    )
    return _PURPOSE + json.dumps(fields, separators=(",", ":")).encode() + b"\n" + body

"""Bytes from a message and a message from bytes: JSON in an envelope, sealed with a checksum, checked once at the edge.

A payload that its topic does not admit (unknown field, NaN, other version, other mission, a source that does not make
such messages, too long) is refused with `Refused`, whose text is one line: "WHERE: expected ..., got ...".
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Callable
from typing import Any, ClassVar

from pydantic import TypeAdapter, ValidationError

from schemas.topics import Topic
from schemas.validation import one_line
from schemas.wire import SCHEMA_VERSION, Envelope, Header, Wire, printable

_OPENING = b'{"header":'
_SEAL = re.compile(rb',"checksum":(\d{1,10})},"body":')
_DECODER = json.JSONDecoder()
_HEADER_LIMIT_BYTES = 2_000
"""Length of the beginning of a message in which the checksum is searched; a header is much shorter."""


Sign = Callable[[Header, bytes], Header]


class Refused(ValueError):
    """A payload that its topic does not admit; the text is one line."""

    kind: ClassVar[str] = "malformed"
    """What is wrong, in one or two words: refusals of one kind are counted together."""


class Damaged(Refused):
    """A payload whose checksum is wrong: it was changed on the way."""

    kind = "damaged"


class Oversized(Refused):
    """A payload that is longer than its topic allows."""

    kind = "oversized"


class Foreign(Refused):
    """A message of another schema version, mission or sender than its topic is for."""

    kind = "foreign"


class TooMany(Refused):
    """A message for which a process has no room, because it is slower than those that send."""

    kind = "too many"


class NotPermitted(Refused):
    """A message that its sender may not send, or that does not prove who sent it, or when."""

    kind = "not permitted"


class Passed(bytes):
    """A message of `encode`, with the header and the body that it was made of, for a reader in the same process.

    Messages are frozen, so such a reader is given the same objects, and nothing is parsed. The bytes are those of
    `encode`. Any copy of them that was changed is plain bytes again, and is checked like every other message.
    """

    header: Header
    body: Wire


def encode(header: Header, body: Wire, sign: Sign | None = None) -> bytes:
    """The message as JSON in UTF-8, sealed with its checksum.

    sign: returns the header with signer and signature, given the header and the body as it is sent; None: not signed.
    """
    content = _json(body)
    return _sealed(header if sign is None else sign(header, content), content)


def passed(header: Header, body: Wire) -> Passed:
    """The same bytes as `encode` gives, for readers in this process."""
    content = _json(body)
    head, checksum = _head_and_checksum(header, content)
    message = Passed(_joined(head, checksum, content))
    message.header = header.model_copy(update={"checksum": checksum})
    message.body = body
    return message


def restamped(payload: bytes, held_from: int | None, repetition: int) -> bytes:
    """A message of `encode` with another `held_from` and repetition, to send it again; the checksum is recomputed."""
    seal = _SEAL.search(payload, 0, _HEADER_LIMIT_BYTES)
    if seal is None or not payload.startswith(_OPENING):
        raise Refused("expected a message that was sealed with a checksum, got one without")
    header = Header.model_validate_json(payload[len(_OPENING) : seal.start()] + b"}")
    return _sealed(
        header.model_copy(update={"held_from": held_from, "repetition": repetition}), payload[seal.end() : -1]
    )


def _sealed(header: Header, body: bytes) -> bytes:
    return _joined(*_head_and_checksum(header, body), body)


def _joined(head: bytes, checksum: int, body: bytes) -> bytes:
    return b'%b%b,"checksum":%d},"body":%b}' % (_OPENING, head[:-1], checksum, body)


def _head_and_checksum(header: Header, body: bytes) -> tuple[bytes, int]:
    """The header as it is sent, without its checksum, and the checksum of header and body."""
    left_out = {"checksum"}
    if header.held_from is None:
        left_out.add("held_from")
    if header.repetition == 0:
        left_out.add("repetition")
    head = _json(header, left_out)
    return head, zlib.crc32(body, zlib.crc32(head))


def _json(model: Wire, left_out: set[str] | None = None) -> bytes:
    """The model as JSON in UTF-8, without those fields: `model_dump_json` would decode it, only to be encoded again."""
    return type(model).__pydantic_serializer__.to_json(model, exclude=left_out)


def body_of(payload: bytes) -> bytes:
    """The body, as JSON, of a message of `encode`; raises Refused for anything else."""
    seal = _SEAL.search(payload, 0, _HEADER_LIMIT_BYTES)
    if seal is None or not payload.startswith(_OPENING):
        raise Refused("expected a message that was sealed with a checksum, got one without")
    return payload[seal.end() : -1]


def _check_seal(payload: bytes, where: str) -> bool:
    """Whether the message has a checksum where `encode` puts it; raises Damaged if it is wrong."""
    seal = _SEAL.search(payload, 0, _HEADER_LIMIT_BYTES)
    if seal is None or not payload.startswith(_OPENING):
        return False
    head = zlib.crc32(payload[len(_OPENING) : seal.start()] + b"}")
    came = zlib.crc32(memoryview(payload)[seal.end() : -1], head)
    if came != int(seal[1]):
        raise Damaged(f"{where}: expected checksum {seal[1].decode()} as in the header, got {came}: damaged")
    return True


def decode(topic: Topic, payload: bytes, mission: str) -> tuple[Header, Any]:
    """Header and body of a message of that topic; raises Refused with one line for anything else."""
    return _decode(topic, topic.payload, payload, mission, topic.max_bytes, topic.sources)


def raw_objection(topic: Topic, payload: bytes) -> Refused | None:
    """Why the topic does not admit a message, judged by its length and its source; None if it may."""
    where = topic.name
    if len(payload) > topic.max_bytes:
        return Oversized(f"{where}: expected at most {topic.max_bytes} bytes, got {len(payload)}")
    source = header_of(payload).get("source")
    if topic.sources is None or (isinstance(source, str) and source in topic.sources):
        return None
    shown = printable(source)[:64] if isinstance(source, str) else "none"
    return Foreign(f"{where}: expected a message of {' or '.join(sorted(topic.sources))}, got one of '{shown}'")


def header_of(payload: bytes) -> dict[str, Any]:
    """The header as it is in the payload, unchecked; empty if it cannot be read."""
    if isinstance(payload, Passed):
        return vars(payload.header)
    try:
        if payload.startswith(_OPENING):
            text = payload[len(_OPENING) : _HEADER_LIMIT_BYTES].decode("utf-8", "replace")
            header = _DECODER.raw_decode(text)[0]
        else:
            header = json.loads(payload)["header"]
    except (ValueError, TypeError, KeyError, IndexError, RecursionError):
        return {}
    return header if isinstance(header, dict) else {}


def decode_reply(topic: Topic, payload: bytes, mission: str) -> tuple[Header, Any]:
    """Header and body of the answer to a query of that topic; raises Refused with one line for anything else."""
    if topic.reply is None:
        raise Refused(f"{topic.key(mission)}: is not a query, so there is nothing to answer")
    return _decode(topic, topic.reply, payload, mission, topic.max_reply_bytes, topic.reply_sources, " (reply)")


def _decode(
    topic: Topic,
    body_type: type[Wire],
    payload: bytes,
    mission: str,
    limit: int,
    sources: frozenset[str] | None,
    what: str = "",
) -> tuple[Header, Any]:
    """Header and body; what: of the topic's key the message is."""

    def expected(text: str, kind: type[Refused] = Foreign) -> Refused:
        return kind(f"{topic.key(mission)}{what}: expected {text}")

    if len(payload) > limit:
        raise expected(f"at most {limit} bytes, got {len(payload)}", Oversized)
    if isinstance(payload, Passed) and type(payload.body) is body_type:
        header, body = payload.header, payload.body
    else:
        header, body = _parsed(body_type, payload, f"{topic.key(mission)}{what}")
    if header.version != SCHEMA_VERSION:
        raise expected(f"schema version {SCHEMA_VERSION}, got {header.version}")
    if header.mission != mission:
        raise expected(f"mission '{mission}', got '{header.mission}'")
    if sources is not None and header.source not in sources:
        raise expected(f"a message of {' or '.join(sorted(sources))}, got one of '{header.source}'")
    return header, body


def _parsed(body_type: type[Wire], payload: bytes, where: str) -> tuple[Header, Any]:
    """Header and body, each of the right form; raises Refused."""
    sealed = _check_seal(payload, where)
    try:
        envelope = _adapter(body_type).validate_json(payload)
    except ValidationError as error:
        _refuse_other_version(payload, where)
        raise Refused(f"{where}: {one_line(error)}") from None
    if envelope.header.checksum is not None and not sealed:
        raise Refused(f"{where}: expected the checksum last in a header without spaces, or none, got another form")
    return envelope.header, envelope.body


_ADAPTERS: dict[type[Wire], TypeAdapter[Any]] = {}


def _adapter(body_type: type[Wire]) -> TypeAdapter[Any]:
    if body_type not in _ADAPTERS:
        _ADAPTERS[body_type] = TypeAdapter(Envelope[body_type])  # type: ignore[valid-type]
    return _ADAPTERS[body_type]


def _refuse_other_version(payload: bytes, where: str) -> None:
    """Raise Refused if the message is of another schema version: its other errors follow from the version."""
    try:
        version = json.loads(payload)["header"]["version"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return
    if version != SCHEMA_VERSION:
        raise Foreign(f"{where}: expected schema version {SCHEMA_VERSION}, got {str(version)[:40]}")

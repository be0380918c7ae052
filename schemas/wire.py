"""How every message stands on the wire: an envelope of header and body, JSON, checked once at the edge.

A payload that is not exactly what its topic asks for (unknown field, NaN, wrong version, too long) is refused with
``Refused``, whose text is one line that says what was expected, what came and where.
"""

from __future__ import annotations

import json
import re
import zlib
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

if TYPE_CHECKING:
    from schemas.topics import Topic

SCHEMA_VERSION = 1
"""Of all schemas together; a message of another version is refused."""

MissionName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,47}$")]
"""Lower-case letters, digits, '-' and '_': it is a chunk of every key."""

Identifier = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}$")]
"""Names a sample, a command, a process."""

MissionTimeNs = Annotated[int, Field(ge=0, lt=2**63)]
"""Mission time (UTC), integer nanoseconds since 1970-01-01T00:00:00Z."""

PositionM = Annotated[float, Field(ge=-1e5, le=1e5)]
"""A site coordinate [m]."""

Text = Annotated[str, Field(max_length=500)]


class Refused(ValueError):
    """A payload that its topic does not admit; the text is one line."""


class Damaged(Refused):
    """A payload that is not what its sender sealed: something on the way changed it."""


class Wire(BaseModel):
    """Root of everything that goes over the wire: frozen, no unknown fields, finite numbers, no silent conversion."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True, ser_json_inf_nan="null")


class Header(Wire):
    """Who made a message, and when; with stream, incarnation and sequence it is unique in a mission."""

    version: int = SCHEMA_VERSION
    mission: MissionName
    source: Identifier
    """Name of the process that made it: rover, ground, field, link, an operator's session."""
    incarnation: Annotated[int, Field(ge=0)]
    """Which start of that process (1, 2, ...); 0 for one that keeps no journal."""
    sequence: Annotated[int, Field(ge=0)]
    """Counts the messages of one source, incarnation and topic, from 0."""
    made_at: MissionTimeNs
    held_from: Annotated[int, Field(ge=0)] | None = None
    """Lowest sequence of the stream that its source still holds for repeating; below it all is acknowledged."""
    repetition: Annotated[int, Field(ge=0)] = 0
    """How often the message had been sent before."""
    checksum: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    """CRC-32 of header (without this field) and body as they stand on the wire; None: not to be checked."""


Body = TypeVar("Body", bound=Wire)


class Envelope(Wire, Generic[Body]):
    """A message as it travels."""

    header: Header
    body: Body


def encode(header: Header, body: Wire) -> bytes:
    """The message as JSON in UTF-8, sealed with its checksum."""
    return _sealed(header, body.model_dump_json().encode())


def restamped(payload: bytes, held_from: int | None, repetition: int) -> bytes:
    """The same message, of our own making, as it stands when it is sent again, and so with another checksum."""
    seal = _SEAL.search(payload, 0, _HEADER_LIMIT_BYTES)
    if seal is None or not payload.startswith(_OPENING):
        raise Refused("expected a message that was sealed with a checksum, got one without")
    header = Header.model_validate_json(payload[len(_OPENING) : seal.start()] + b"}")
    return _sealed(
        header.model_copy(update={"held_from": held_from, "repetition": repetition}), payload[seal.end() : -1]
    )


_OPENING = b'{"header":'
_SEAL = re.compile(rb',"checksum":(\d{1,10})},"body":')
_HEADER_LIMIT_BYTES = 2_000
"""How far into a message the seal is looked for; names and numbers of a header fit many times."""


def _sealed(header: Header, body: bytes) -> bytes:
    left_out = {"checksum"}
    if header.held_from is None:
        left_out.add("held_from")
    if header.repetition == 0:
        left_out.add("repetition")
    head = header.model_dump_json(exclude=left_out).encode()
    checksum = zlib.crc32(body, zlib.crc32(head))
    return b'%b%b,"checksum":%d},"body":%b}' % (_OPENING, head[:-1], checksum, body)


def _check_seal(payload: bytes, where: str) -> bool:
    """Whether the message has a seal where `encode` puts it; raises Damaged when that is broken."""
    seal = _SEAL.search(payload, 0, _HEADER_LIMIT_BYTES)
    if seal is None or not payload.startswith(_OPENING):
        return False
    head = zlib.crc32(payload[len(_OPENING) : seal.start()] + b"}")
    came = zlib.crc32(memoryview(payload)[seal.end() : -1], head)
    if came != int(seal[1]):
        raise Damaged(f"{where}: expected checksum {seal[1].decode()} as the header says, got {came}: damaged")
    return True


def decode(topic: Topic, payload: bytes, mission: str) -> tuple[Header, Any]:
    """Header and body of a message of that topic; raises Refused with one line for anything else."""
    return _decode(topic.payload, payload, mission, topic.key(mission), topic.max_bytes)


def decode_reply(topic: Topic, payload: bytes, mission: str) -> tuple[Header, Any]:
    """Header and body of the answer to a query of that topic; raises Refused with one line for anything else."""
    if topic.reply is None:
        raise Refused(f"{topic.key(mission)}: is not a query, so there is nothing to answer")
    return _decode(topic.reply, payload, mission, f"{topic.key(mission)} (reply)", topic.max_reply_bytes)


def _decode(body_type: type[Wire], payload: bytes, mission: str, where: str, limit: int) -> tuple[Header, Any]:
    if len(payload) > limit:
        raise Refused(f"{where}: expected at most {limit} bytes, got {len(payload)}")
    sealed = _check_seal(payload, where)
    try:
        envelope = _adapter(body_type).validate_json(payload)
    except ValidationError as error:
        _refuse_other_version(payload, where)
        raise Refused(f"{where}: {one_line(error)}") from None
    header: Header = envelope.header
    if header.checksum is not None and not sealed:
        raise Refused(f"{where}: expected the checksum last in a header without spaces, or none, got another form")
    if header.version != SCHEMA_VERSION:
        raise Refused(f"{where}: expected schema version {SCHEMA_VERSION}, got {header.version}")
    if header.mission != mission:
        raise Refused(f"{where}: expected mission '{mission}', got '{header.mission}'")
    return header, envelope.body


_ADAPTERS: dict[type[Wire], TypeAdapter[Any]] = {}


def _adapter(body_type: type[Wire]) -> TypeAdapter[Any]:
    if body_type not in _ADAPTERS:
        _ADAPTERS[body_type] = TypeAdapter(Envelope[body_type])  # type: ignore[valid-type]
    return _ADAPTERS[body_type]


def _refuse_other_version(payload: bytes, where: str) -> None:
    """Name the version first: with another version, every other complaint is noise."""
    try:
        version = json.loads(payload)["header"]["version"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return
    if version != SCHEMA_VERSION:
        raise Refused(f"{where}: expected schema version {SCHEMA_VERSION}, got {str(version)[:40]}")


def one_line(error: ValidationError) -> str:
    """The first complaint of a validation, as 'where: what was expected, got what came' on one line."""
    first = error.errors(include_url=False, include_context=False)[0]
    place = ".".join(str(part) for part in first["loc"]) or "message"
    came = first.get("input")
    shown = "" if first["type"] in {"missing", "json_invalid"} else f", got {_short(came)}"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    message = first["msg"].splitlines()[0].removeprefix("Value error, ")
    return f"{place}: {message[0].lower()}{message[1:]}{shown}{more}"


def _short(value: object, limit: int = 60) -> str:
    shown = repr(value).replace("\n", " ")
    return shown if len(shown) <= limit else shown[: limit - 3] + "..."

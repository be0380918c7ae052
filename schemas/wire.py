"""The types on which every message is built: `Wire`, the header, the envelope and the field types that all share.

`schemas.codec` makes bytes of a message and checks bytes that come in; `schemas.topics` is the table of messages.
"""

from __future__ import annotations

from typing import Annotated, Any, Generic, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

SCHEMA_VERSION = 1
"""Version of all schemas together; a message of another version is refused."""

MissionName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,47}$")]
"""Lower-case letters, digits, '-' and '_': it is a chunk of every key."""

Identifier = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}$")]
"""Name of a sample, a command, an area or a process."""

MissionTimeNs = Annotated[int, Field(ge=0, lt=2**63)]
"""Mission time (UTC), integer nanoseconds since 1970-01-01T00:00:00Z."""

MAX_COUNT = 2**53
"""Every count is lower: programs that read numbers of JSON as doubles hold it exactly."""

Count = Annotated[int, Field(ge=0, lt=MAX_COUNT)]
"""A number of things, or the number of one of them."""

MAX_POSITION_M = 1e5
"""Largest coordinate that messages hold [m]: no site is longer on a side."""

PositionM = Annotated[float, Field(ge=-MAX_POSITION_M, le=MAX_POSITION_M)]
"""A site coordinate [m]."""

CommonName = Annotated[str, Field(pattern=r"^[a-z]+\.[a-z0-9][a-z0-9_-]{0,31}(\.[0-9]{1,9})?$")]
"""Name of an identity: ROLE.NAME, as its certificate has it."""

Signature = Annotated[str, Field(pattern=r"^[0-9a-f]{128}$")]
"""An Ed25519 signature in hexadecimal: each signature has one text only, which base64 does not promise."""

MAX_TEXT = 500
MAX_PROVENANCE = 1000
"""Characters of a text about the origin of data, as a region's document may have them."""


def printable(text: str) -> str:
    """The text on one line, control and direction characters and lone surrogates as escapes: safe to show anywhere."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)


def _harmless(text: str) -> str:
    return text if text.isprintable() else printable(text)[:MAX_TEXT]


Text = Annotated[str, Field(max_length=MAX_TEXT), AfterValidator(_harmless)]
"""A text for people. Characters that control a terminal or the writing direction are escaped in all input."""

PersonName = Annotated[Text, Field(min_length=1, max_length=100)]
"""Who commands: the common name of an identity, or a user and a machine, which nothing proves."""

Provenance = Annotated[str, Field(max_length=MAX_PROVENANCE), AfterValidator(_harmless)]
"""A text for people on the origin of data, such as a product or a citation."""


def is_none(value: object) -> bool:
    """Whether a field is left out of its message (`exclude_if`): one that came later, where it says nothing."""
    return value is None


class Wire(BaseModel):
    """Base of every message: frozen, no unknown fields, finite numbers, no silent conversion."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True, ser_json_inf_nan="null")


def _is_none(value: object) -> bool:
    return value is None


class Header(Wire):
    """Who made a message, and when. Topic, source, incarnation and sequence together are unique in a mission."""

    version: int = SCHEMA_VERSION
    mission: MissionName
    source: Identifier
    """Name of the process that made it: rover, ground, field, link, an operator's session."""
    incarnation: Count
    """Number of the start of that process (1, 2, ...); 0 for one that keeps no journal."""
    sequence: Count
    """Counts the messages of one source, incarnation and topic, from 0."""
    made_at: MissionTimeNs
    held_from: Count | None = None
    """Lowest sequence of its stream that the source still keeps; everything below it is acknowledged."""
    repetition: Count = 0
    """How often the message was sent before; 0 the first time."""
    instance: Identifier | None = Field(default=None, exclude_if=_is_none)
    """The run of the mission, in signed messages: one of an earlier run does not count in this one."""
    expires_at: MissionTimeNs | None = Field(default=None, exclude_if=_is_none)
    """When a signed request ends to count; None: never."""
    start: Identifier | None = Field(default=None, exclude_if=_is_none)
    """A random name of one start of a process: in its signed status its own, in a person's request to it the one for
    which the request counts. So a request that was made for an earlier start is known for a replayed one."""
    signer: CommonName | None = Field(default=None, exclude_if=_is_none)
    """The identity that signed the message; None for one that is not signed."""
    signature: Signature | None = Field(default=None, exclude_if=_is_none)
    """The signature of `schemas.signing.signed_bytes`."""
    checksum: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    """CRC-32 of header (without this field) and body as sent on the wire; None: no check."""

    @model_validator(mode="after")
    def _keeps_itself(self) -> Self:
        if self.held_from is not None and self.held_from > self.sequence:
            raise ValueError(f"expected held_from up to sequence {self.sequence}, got {self.held_from}")
        return self


Body = TypeVar("Body", bound=Wire)


def values_set(change: Wire) -> dict[str, Any]:
    """The fields of a change that say something, as JSON values; what lies in them is whole, defaults included.

    A field that is None, or False by default, leaves things as they are.
    """
    named = {
        name
        for name, field in type(change).model_fields.items()
        if (value := getattr(change, name)) != field.default or not (value is None or value is False)
    }
    return change.model_dump(mode="json", include=named)


class Envelope(Wire, Generic[Body]):
    """A message as it travels."""

    header: Header
    body: Body

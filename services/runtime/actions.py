"""The actions that a host requests from its driver: a node's effects with messages as bytes, each on its side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from schemas.refusal import RefusalCode
from services.runtime.node import Compute, Finish, Keep, LogRecord, PublishSnapshot, SetTimer

if TYPE_CHECKING:
    from schemas.topics import Side, Topic


@dataclass(frozen=True, slots=True)
class Publish:
    """Publish these bytes on the topic's key on that side."""

    topic: Topic
    side: Side
    payload: bytes


@dataclass(frozen=True, slots=True)
class PutQuery:
    """Send a query to the server of the topic on that side. Its end comes as `ReplyArrived` or `QueryUnanswered`."""

    topic: Topic
    side: Side
    payload: bytes
    query: str
    timeout_s: float


@dataclass(frozen=True, slots=True)
class Reply:
    """Reply to the query of that token with these bytes."""

    token: int
    topic: Topic
    payload: bytes


@dataclass(frozen=True, slots=True)
class ReplyError:
    """Refuse the query of that token, with one line on the reason and a code for programs."""

    token: int
    topic: Topic
    why: str
    code: RefusalCode = RefusalCode.INVALID_INPUT


@dataclass(frozen=True, slots=True)
class SetAside:
    """Report an input that the node could not handle because of a defect, and keep it for diagnosis."""

    what: str
    """The input: topic, length and checksum."""
    payload: bytes
    """Its bytes; empty if it had none."""
    error: str
    """Type and text of the exception, and the place where it was raised."""
    traceback: tuple[str, ...]
    number: int
    """Counts the inputs that were set aside since the start."""
    place: str = ""
    """File and line where the exception was raised; empty if that is not known."""


Action = (
    Publish
    | PutQuery
    | Reply
    | ReplyError
    | SetAside
    | SetTimer
    | Compute
    | PublishSnapshot
    | Keep
    | LogRecord
    | Finish
)

"""The actions that a host requests from its driver: a node's effects with messages as bytes, each on its side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from schemas.refusal import RefusalCode
from services.runtime.node import Compute, Finish, LogRecord, PublishSnapshot, SetTimer

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


Action = Publish | PutQuery | Reply | ReplyError | SetTimer | Compute | PublishSnapshot | LogRecord | Finish

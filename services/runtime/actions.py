"""What a host wants done: what a node wants done, with everything in bytes and on its side."""

from __future__ import annotations

from dataclasses import dataclass

from schemas.refusal import RefusalCode
from schemas.topics import Side, Topic
from services.runtime.node import Compute, Finish, LogRecord, PublishSnapshot, SetTimer


@dataclass(frozen=True, slots=True)
class Publish:
    """Put these bytes under the topic's key on that side."""

    topic: Topic
    side: Side
    payload: bytes


@dataclass(frozen=True, slots=True)
class PutQuery:
    """Ask whoever serves the topic on that side; report back under the question's name."""

    topic: Topic
    side: Side
    payload: bytes
    query: str
    timeout_s: float


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer the asker of that token with these bytes."""

    token: int
    topic: Topic
    payload: bytes


@dataclass(frozen=True, slots=True)
class ReplyError:
    """Tell the asker of that token, in one line, why there is no answer."""

    token: int
    topic: Topic
    why: str
    code: RefusalCode = RefusalCode.INVALID_INPUT


Action = Publish | PutQuery | Reply | ReplyError | SetTimer | Compute | PublishSnapshot | LogRecord | Finish

"""The inputs that a driver reports to a host: all events of a process, one frozen type each.

An input is a value, so it can be kept in a journal before it is handled, and be handled again after a restart. The
time at which it is handled is not part of it. `services.runtime.actions` is the other direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from schemas.topics import Topic
    from schemas.wire import Wire
    from services.runtime.node import NoReply


@dataclass(frozen=True, slots=True)
class ProcessStarted:
    """The process runs. This is the first input of each start; `incarnation` counts the starts from 1."""

    incarnation: int


@dataclass(frozen=True, slots=True)
class MessageArrived:
    """A message was published on a topic to which the node listens."""

    topic: Topic
    payload: bytes
    objection: str | None = None
    """Why the command in it must not be carried out, though its sender is the right one; None for all else."""


@dataclass(frozen=True, slots=True)
class QueryArrived:
    """A query that carries a message; the reply is to name the same token."""

    topic: Topic
    payload: bytes
    token: int


@dataclass(frozen=True, slots=True)
class CheckedQueryArrived:
    """A query whose request was made from selector parameters, and checked then."""

    topic: Topic
    request: Wire
    token: int


@dataclass(frozen=True, slots=True)
class ReplyArrived:
    """The reply to the node's own query of that name."""

    query: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class QueryUnanswered:
    """The node's own query of that name has ended without a reply."""

    query: str
    why: NoReply
    detail: str = ""
    """Text of the refusal, if it was refused."""


@dataclass(frozen=True, slots=True)
class TimerElapsed:
    """The time of that timer has come."""

    timer: str


@dataclass(frozen=True, slots=True)
class ComputationEnded:
    """The computation of that name has ended, with a result or with the error that it raised."""

    job: str
    result: Any
    error: Exception | None = None


Input = (
    ProcessStarted
    | MessageArrived
    | QueryArrived
    | CheckedQueryArrived
    | ReplyArrived
    | QueryUnanswered
    | TimerElapsed
    | ComputationEnded
)

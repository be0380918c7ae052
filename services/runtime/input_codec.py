"""A journal's records: one input each, as a channel's name and bytes. Messages are kept exactly as they arrived."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

from he3.errors import He3Error, InvalidInput, NoRoute, NumericalFailure, OutsideRegion, PeerUnreachable
from schemas.topics import BY_NAME
from services.runtime.inputs import (
    CheckedQueryArrived,
    ComputationEnded,
    Input,
    MessageArrived,
    ProcessStarted,
    QueryArrived,
    QueryUnanswered,
    ReplyArrived,
    TimerElapsed,
)
from services.runtime.node import NoReply

if TYPE_CHECKING:
    from services.runtime.state_codec import StateCodec

ERRORS: Final[dict[str, type[He3Error]]] = {
    error.__name__: error
    for error in (He3Error, InvalidInput, NoRoute, NumericalFailure, OutsideRegion, PeerUnreachable)
}
"""Exceptions of a computation that keep their type in a journal; any other becomes a He3Error of the same text."""


def encode_input(given: Input, codec: StateCodec) -> tuple[str, bytes]:
    """Channel and bytes of an input; raises InvalidInput for a result that the codec does not know."""
    match given:
        case ProcessStarted(incarnation):
            return "start", b"%d" % incarnation
        case MessageArrived(topic, payload, None):
            return f"message/{topic.name}", payload
        case MessageArrived(topic, payload, objection):
            return f"objected/{topic.name}", json.dumps(objection).encode() + b"\n" + payload
        case QueryArrived(topic, payload, token):
            return f"query/{topic.name}", b"%d\n" % token + payload
        case CheckedQueryArrived(topic, request, token):
            return f"checked_query/{topic.name}", b"%d\n" % token + request.model_dump_json().encode()
        case ReplyArrived(query, payload):
            return "reply", query.encode() + b"\n" + payload
        case QueryUnanswered(query, why, detail):
            return "unanswered", json.dumps([query, why.name, detail]).encode()
        case TimerElapsed(timer):
            return "timer", timer.encode()
        case ComputationEnded(job, result, error):
            kept = None if error is None else [type(error).__name__, str(error)]
            return "computation", codec.encode([job, result, kept])


def decode_input(channel: str, data: bytes, codec: StateCodec) -> Input:
    """The input of that record; raises InvalidInput for one that `encode_input` does not write."""
    kind, _, name = channel.partition("/")
    head, _, rest = data.partition(b"\n")
    try:
        match kind:
            case "start":
                return ProcessStarted(int(data))
            case "message":
                return MessageArrived(BY_NAME[name], data)
            case "objected":
                return MessageArrived(BY_NAME[name], rest, str(json.loads(head)))
            case "query":
                return QueryArrived(BY_NAME[name], rest, int(head))
            case "checked_query":
                return CheckedQueryArrived(BY_NAME[name], BY_NAME[name].payload.model_validate_json(rest), int(head))
            case "reply":
                return ReplyArrived(head.decode(), rest)
            case "unanswered":
                query, why, detail = json.loads(data)
                return QueryUnanswered(query, NoReply[why], detail)
            case "timer":
                return TimerElapsed(data.decode())
            case "computation":
                job, result, error = codec.decode(data)
                return ComputationEnded(job, result, _error(error))
    except (ValueError, KeyError, TypeError) as error:
        why = str(error).splitlines()[0]
        raise InvalidInput(f"expected a record of channel '{channel}' as a journal holds it: {why}") from None
    raise InvalidInput(f"expected a record of a journal, got one of channel '{channel}'")


def _error(kept: Any) -> He3Error | None:
    if kept is None:
        return None
    name, text = kept
    return ERRORS.get(name, He3Error)(text)

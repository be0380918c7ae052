"""Reads queries, for every process that serves them.

A query that carries a message is the request itself, in our envelope. A query without a payload is made of its
selector's parameters (``?x=120;y=340``), as any stock Zenoh client sends it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

from pydantic import ValidationError

from he3.errors import InvalidInput
from schemas.codec import Refused, decode, encode
from schemas.validation import one_line

if TYPE_CHECKING:
    from schemas.topics import Topic
    from schemas.wire import Header, Wire


class Query(Protocol):
    """The fields of a query that are read."""

    @property
    def payload(self) -> bytes | None: ...

    @property
    def parameters(self) -> Mapping[str, str]: ...


def read_request(topic: Topic, query: Query, mission: str) -> Any:
    """The request that the query makes; raises InvalidInput with one line."""
    payload = query.payload
    if payload is None:
        return request_from_selector(topic, query.parameters)
    try:
        return decode(topic, payload, mission)[1]
    except Refused as refused:
        raise InvalidInput(str(refused)) from None


def request_from_selector(topic: Topic, parameters: Mapping[str, str]) -> Any:
    """The request that selector parameters make; raises InvalidInput with one line for unknown or bad ones."""
    try:
        # Parameters are text: numbers are read from them, everything else is checked as on the wire.
        return topic.payload.model_validate_strings(dict(parameters))
    except ValidationError as error:
        raise InvalidInput(f"{topic.name}: {one_line(error)}") from None


def encode_reply(query: Query, header: Header, reply: Wire) -> bytes:
    """The reply in the form of the query: a message for a message, the plain body for selector parameters."""
    return reply.model_dump_json().encode() if query.payload is None else encode(header, reply)

"""Queries as inputs of a host: an incoming query, and the end of a query that the node sent."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.runtime.inputs import CheckedQueryArrived, QueryArrived, QueryUnanswered, ReplyArrived
from services.runtime.transport.request import Query, request_from_selector
from services.runtime.transport.session import Outcome, Replied

if TYPE_CHECKING:
    from schemas.topics import Topic


def query_input(topic: Topic, query: Query, token: int) -> QueryArrived | CheckedQueryArrived:
    """The query as an input, with its selector parameters read; the host decodes a query that carries a message.

    Raises InvalidInput with one line for bad parameters.
    """
    payload = query.payload
    if payload is None:
        return CheckedQueryArrived(topic, request_from_selector(topic, query.parameters), token)
    return QueryArrived(topic, payload, token)


def outcome_input(query: str, outcome: Outcome) -> ReplyArrived | QueryUnanswered:
    """The end of the node's query of that name as an input."""
    if isinstance(outcome, Replied):
        return ReplyArrived(query, outcome.payload)
    return QueryUnanswered(query, outcome.why, outcome.detail)

"""Changes of clock and pace that the link's drivers answer themselves, admitted and written down as the node's are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from he3.errors import InvalidInput
from services.runtime.actions import ReplyError
from services.runtime.transport.inputs import query_input
from services.runtime.transport.request import read_request

if TYPE_CHECKING:
    from schemas.topics import Topic
    from services.runtime.context import ProcessContext
    from services.runtime.transport.session import IncomingQuery


def read_change(context: ProcessContext, topic: Topic, query: IncomingQuery) -> Any:
    """The request of that query; raises InvalidInput with one line, counted, unless its sender may make the change."""
    try:
        given = query_input(topic, query, 0)
    except InvalidInput as error:
        context.refused(topic, error)
        raise
    kept, actions = context.scheduler.host.admit(given, context.clock.latest)
    for action in actions:
        context.perform(action)
    if kept is None:
        raise InvalidInput(next(action.why for action in actions if isinstance(action, ReplyError)))
    try:
        return read_request(topic, query, context.mission)
    except InvalidInput as error:
        context.refused(topic, error)
        raise

"""The two Zenoh routers that the link's process embeds, one a side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.runtime.transport.opening import open_router
from services.runtime.transport.session import Session

if TYPE_CHECKING:
    from schemas.topics import Side
    from services.runtime.context import ProcessContext


def router_on(context: ProcessContext, side: Side, endpoint: str) -> Session:
    """The router of that side, listening; raises PeerUnreachable when it cannot, with the reason."""
    return Session(open_router(side, endpoint, context.mission, context.options.identity), context.mission)

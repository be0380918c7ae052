"""The two Zenoh routers that the link's process embeds, one a side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.runtime.transport.opening import RouterGuard, open_router
from services.runtime.transport.session import Session
from services.runtime.trust.access_control import access_control, names_of

if TYPE_CHECKING:
    from schemas.topics import Side
    from services.runtime.context import ProcessContext
    from services.runtime.trust.identity import Identity


def router_on(context: ProcessContext, side: Side, endpoint: str) -> Session:
    """The router of that side, listening; raises PeerUnreachable when it cannot, with the reason."""
    identity = context.options.identity
    guard = None if identity is None else guard_of(side, context.mission, identity)
    return Session(open_router(side, endpoint, guard), context.mission)


def guard_of(side: Side, mission: str, identity: Identity) -> RouterGuard:
    """Lets in those that the identity's roster names, and gives each role the rights of the topic table."""
    return RouterGuard(identity, access_control(side, mission, names_of(identity.roster)))

"""Which process holds which role. The link judges it, as every process of a side reaches its router.

The first process that claims a role has it. It loses the role when its liveliness token disappears, which is at once
if the process is killed. A process that hangs, or whose machine has lost its power, keeps its token for a minute; so it
also loses the role when it has not renewed its claim for `SILENT_S` and another process asks for it.

A claim counts only with the token of the same process. In a mission with keys, the routers let a process have tokens of
its own role alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

from he3.errors import InvalidInput
from schemas.claims import RoleClaim, RoleHolder
from schemas.codec import decode, encode
from schemas.topics import HOLDERS, Side
from schemas.wire import Header
from services.runtime.refusals import refusal_of
from services.runtime.role_claim import CLAIMS
from services.runtime.transport.request import read_request

if TYPE_CHECKING:
    from services.runtime.context import ProcessContext
    from services.runtime.transport.session import IncomingQuery

SILENT_S: Final = 10.0
"""A holder that has not renewed its claim for this long [s of wall time] gives way to another process."""
MAX_TOKENS: Final = 1_000
"""Tokens that are remembered; a mission has one a process."""


@dataclass(slots=True)
class _Holder:
    process: str
    renewed_s: float
    renewals: int = 0


class RoleHolders:
    """The holders of the roles of a mission, without I/O."""

    def __init__(self) -> None:
        self._alive: set[tuple[Side, str]] = set()
        self._holders: dict[str, _Holder] = {}

    def seen(self, side: Side, process: str, alive: bool) -> None:
        """Note that a process's liveliness token on that side has appeared or disappeared."""
        if not alive:
            self._alive.discard((side, process))
        elif len(self._alive) < MAX_TOKENS:
            self._alive.add((side, process))

    def claim(self, side: Side, claim: RoleClaim, now_s: float) -> RoleHolder:
        """Who holds the role after that claim. now_s: wall time, monotonic.

        Raises InvalidInput for a process that is named for another role.
        """
        if not claim.process.startswith(f"{claim.name}."):
            raise InvalidInput(f"expected the name of a {claim.name} process, got '{claim.process}'")
        if (side, claim.process) not in self._alive:
            return RoleHolder(process=None, renewals=0)
        holder = self._holders.get(claim.name)
        if holder is not None and holder.process == claim.process:
            holder.renewed_s, holder.renewals = now_s, holder.renewals + 1
        elif holder is None or (side, holder.process) not in self._alive or now_s - holder.renewed_s > SILENT_S:
            holder = self._holders[claim.name] = _Holder(claim.process, now_s)
        return RoleHolder(process=holder.process, renewals=holder.renewals)


Reached = Callable[[str, int], None]
"""Called with the role of a process that holds it, and the latest mission time [ns] at which the process has acted."""


def judge_claims(context: ProcessContext, reached: Reached = lambda name, at: None) -> None:
    """Answer the claims of both sides from now on, in the main loop."""
    holders = RoleHolders()
    for side in context.sessions:
        _judge_side(context, holders, side, reached)


def _judge_side(context: ProcessContext, holders: RoleHolders, side: Side, reached: Reached) -> None:
    inbox, session = context.inbox, context.sessions[side]
    session.watch_alive(side, lambda name, alive: inbox.put(partial(holders.seen, side, name, alive)), HOLDERS)
    judge = partial(_judge, context, holders, side, reached)
    session.serve(CLAIMS[side], context.backlog.answering(inbox, CLAIMS[side], judge))


def _judge(context: ProcessContext, holders: RoleHolders, side: Side, reached: Reached, query: IncomingQuery) -> None:
    topic = CLAIMS[side]
    try:
        claim, payload = read_request(topic, query, context.mission), query.payload  # the reply drops the query
        answer = holders.claim(side, claim, time.monotonic())
    except InvalidInput as error:
        query.refuse(refusal_of(error))
        context.refused(topic, InvalidInput(f"{topic.name}: {error}"))
        return
    header = Header(
        mission=context.mission,
        source=context.name,
        incarnation=context.scheduler.host.incarnation,
        sequence=0,
        made_at=context.clock.latest,
    )
    query.reply(encode(header, answer))
    if payload is not None and answer.process == claim.process:
        reached(claim.name, decode(topic, payload, context.mission)[0].made_at)

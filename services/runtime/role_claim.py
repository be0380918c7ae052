"""The role of a process in its mission: one process holds it, and the link judges which.

Two processes of one role would both act: two grounds both plan, two rovers both drive. So a process claims its role
before it receives anything, and says each second that it still holds it. A second process of that role is refused while
the first one works; after a kill the role is free at once.
"""

from __future__ import annotations

import os
import platform
import re
import secrets
import time
from functools import partial
from typing import TYPE_CHECKING, Final

from he3.errors import InvalidInput
from schemas.claims import RoleClaim, RoleHolder
from schemas.codec import Refused, decode_reply, encode
from schemas.topics import EARTH_CLAIM, HOLDERS, MOON_CLAIM, Side, Topic
from schemas.wire import Header
from services.runtime.node import NoReply
from services.runtime.transport.session import NotReplied, Outcome, Session

if TYPE_CHECKING:
    from collections.abc import Callable

    from services.mission.mission_time import MissionTime
    from services.runtime.inbox import Inbox

CLAIMS: Final = {Side.MOON: MOON_CLAIM, Side.EARTH: EARTH_CLAIM}
ASKS_AGAIN_S: Final = 0.1
"""Wall time between two claims of a process that does not hold its role yet."""
RENEWS_EVERY_S: Final = 1.0
ANSWERS_WITHIN_S: Final = 1.0
REPORTS_AFTER_S: Final = 2.0
"""A link that does not answer is reported after this time."""


class RoleRefused(InvalidInput):
    """Another process has the role. A start too many is bad input, which no service manager tries again.

    Tried again and again, it would take the role while its holder is started anew, and without the holder's journal.
    """


class ClaimedRole:
    """The claim of this process, on its side."""

    def __init__(
        self, name: str, mission: str, side: Side, session: Session, inbox: Inbox, latest: Callable[[], MissionTime]
    ) -> None:
        """latest: the latest mission time at which this process has acted, 0 before any."""
        machine = re.sub(r"[^A-Za-z0-9-]", "-", platform.node())[:24]
        self.process = f"{name}.{os.getpid()}.{secrets.token_hex(4)}.{machine or 'machine'}"
        """Identifies this start of the process."""
        self._name = name
        self._mission = mission
        self._side = side
        self._session = session
        self._inbox = inbox
        self._latest = latest
        self._claimed_s = 0.0
        self._held = False
        self._other: RoleHolder | None = None

    @property
    def _topic(self) -> Topic:
        return CLAIMS[self._side]

    def take(self, report: Callable[[str], None]) -> bool:
        """Claim the role until this process holds it; False if the process was stopped first.

        report: called with one line if the link does not answer. Raises He3Error while another process holds it.
        """
        self._session.declare_alive(self.process, self._side, HOLDERS)
        began_s, reported = time.monotonic(), False
        while not self._inbox.stopped.is_set():
            self._claim()
            self._inbox.take(ANSWERS_WITHIN_S)
            if self._held:
                return True
            if not reported and time.monotonic() - began_s > REPORTS_AFTER_S:
                reported = True
                report(self._waiting())
            self._inbox.stopped.wait(ASKS_AGAIN_S)
        return False

    def keep(self, monotonic_s: float) -> None:
        """Renew the claim if that is due. The answer comes by the inbox, which raises RoleRefused if it is lost."""
        if monotonic_s - self._claimed_s >= RENEWS_EVERY_S:
            self._claim()

    def _claim(self) -> None:
        self._claimed_s = time.monotonic()
        header = Header(mission=self._mission, source=self._name, incarnation=0, sequence=0, made_at=self._latest())
        payload = encode(header, RoleClaim(name=self._name, process=self.process))
        self._session.query(
            self._topic, payload, ANSWERS_WITHIN_S, lambda outcome: self._inbox.put(partial(self._answered, outcome))
        )

    def _answered(self, outcome: Outcome) -> None:
        if isinstance(outcome, NotReplied):
            if outcome.why is NoReply.REFUSED:
                raise RoleRefused(f"cannot take part as {self._name}: {outcome.detail}")
            return  # no link yet, or none any more: it asks again
        try:
            _, holder = decode_reply(self._topic, outcome.payload, self._mission)
        except Refused:
            return
        if holder.process is None:
            return
        if holder.process == self.process:
            self._held = True
        elif self._held:
            raise RoleRefused(f"another process has taken part as {self._name} since: {_shown(holder.process)}")
        elif self._other is None or self._other.process != holder.process:
            self._other = holder
        elif holder.renewals > self._other.renewals:
            raise RoleRefused(
                f"expected to be the only {self._name} of mission '{self._mission}', "
                f"got another one that takes part: {_shown(holder.process)}"
            )

    def _waiting(self) -> str:
        if self._other is None:
            return f"waiting for the link on {self._topic.key(self._mission)}"
        return f"waiting for the role of {_shown(str(self._other.process))}, which seems to hang or to be gone"


def _shown(process: str) -> str:
    """A process by its identification: 'process 812 on moonbase'."""
    parts = process.split(".")
    return f"process {parts[1]} on {parts[3]}" if len(parts) == 4 else f"process {process}"

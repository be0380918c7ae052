"""The gate of a process with keys: it signs what the process sends, and admits what is rightly signed.

A process asks it once about each thing that arrives, before the journal keeps it. What is refused changes nothing.
"""

from __future__ import annotations

import secrets
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from he3.errors import He3Error
from schemas.codec import NotPermitted, body_of, encode
from schemas.commands import Telecommand
from schemas.people import NAMING
from schemas.signing import Part
from schemas.topics import COMMAND, ISSUE_COMMAND, Topic
from services.runtime.trust.roster import read_roster

if TYPE_CHECKING:
    from schemas.wire import Header, Wire
    from services.runtime.trust.identity import Identity
    from services.runtime.trust.roster import Roster
    from services.runtime.trust.signing import Signer, Verifier

MAX_SEEN: Final = 10_000
"""Requests of one signer that are remembered, so that none counts twice; older ones than these are refused."""
LOOK_AGAIN_S: Final = 1.0
"""Wall time between two looks whether the roster's file has changed."""


class Requests:
    """The requests of one signer that have come; of the oldest only the time is remembered."""

    def __init__(self) -> None:
        self._made_at: OrderedDict[str, int] = OrderedDict()
        self._forgotten_until = -1

    def is_new(self, signature: str, made_at: int) -> bool:
        """Whether the request has not come before; it has from now on. made_at: mission time, as signed [ns]."""
        if signature in self._made_at or made_at <= self._forgotten_until:
            return False
        self._made_at[signature] = made_at
        if len(self._made_at) > MAX_SEEN:
            _, forgotten = self._made_at.popitem(last=False)
            self._forgotten_until = max(self._forgotten_until, forgotten)
        return True


@dataclass(slots=True)
class Gate:
    """Signs and verifies the messages of one process."""

    signer: Signer
    verifier: Verifier
    start: str = field(default_factory=lambda: secrets.token_hex(8))
    """Names this start of the process. What it remembers ends with it, and requests to an earlier one do not count."""
    _requests: dict[str, Requests] = field(default_factory=dict)

    def encode(self, part: Part, topic: Topic, header: Header, body: Wire) -> bytes:
        """The message, signed if its topic is one whose messages are; a status that can be queried names the start."""
        if not topic.signed:
            return encode(header, body)
        if part is Part.MESSAGE and topic.kept:
            header = header.model_copy(update={"start": self.start})
        return encode(header, body, partial(self.signer.signed, part, topic.name))

    def admit(self, part: Part, topic: Topic, header: Header, payload: bytes, now: int) -> str:
        """The common name of the signer; raises Refused unless a role that may send this has signed it."""
        access = topic.access
        roles = {Part.MESSAGE: access.publish, Part.QUERY: access.query, Part.REPLY: access.answer}[part]
        who = self.verifier.verify(part, topic.name, header, body_of(payload), roles, now)
        if part is Part.QUERY:
            self._require_first(topic, header)
        return who.common_name

    def admit_person(self, topic: Topic, header: Header, body: Any) -> None:
        """Raise Refused for a body that names another person than the signer of the message."""
        if isinstance(body, NAMING) and body.by not in (None, header.signer):
            raise NotPermitted(
                f"{topic.name} of {header.signer}: expected its signer's own name, got '{str(body.by)[:80]}'"
            )

    def admit_command(self, topic: Topic, header: Header, body: Any, now: int) -> None:
        """Raise Refused unless a person has consented to the command in that message, if it is one."""
        if topic not in (COMMAND, ISSUE_COMMAND) or not isinstance(body, Telecommand):
            return
        who = self.verifier.verify_command(body, now)
        if topic is ISSUE_COMMAND and who.common_name != header.signer:
            raise NotPermitted(f"command {body.command_id} of {who.common_name}: brought by {header.signer}")

    def _require_first(self, topic: Topic, header: Header) -> None:
        """Raise Refused for a request that has come before, to this start of the process or to an earlier one.

        The queries of processes name no start: their answers change nothing, and a restarted process repeats its own.
        """
        what = f"{topic.name} of {header.signer}"
        assert header.signer is not None, "it was verified"
        assert header.signature is not None, "it was verified"
        if header.expires_at is None:
            raise NotPermitted(f"{what}: expected a request with an expiry, got one without")
        if topic.sources is None and header.start != self.start:
            raise NotPermitted(
                f"{what}: expected a request to this start of the process, got one to another: replayed, or late"
            )
        if not self._requests.setdefault(header.signer, Requests()).is_new(header.signature, header.made_at):
            raise NotPermitted(f"{what}: this very request has come before: replayed")


class RosterFile:
    """The newest roster of an identity's folder; call it. An older one than was seen before does not count."""

    def __init__(self, identity: Identity, monotonic_s: Callable[[], float], report: Callable[[str], None]) -> None:
        """report: called with one line when the file has become unreadable, or older; the roster before goes on."""
        self._identity = identity
        self._monotonic_s = monotonic_s
        self._report = report
        self._roster = identity.roster
        self._looked_at_s = monotonic_s()
        self._changed_at: tuple[int, int, int] | None = None

    def __call__(self) -> Roster:
        now_s = self._monotonic_s()
        if now_s - self._looked_at_s >= LOOK_AGAIN_S:
            self._looked_at_s = now_s
            self._look()
        return self._roster

    def _look(self) -> None:
        path = self._identity.roster_path
        try:
            found = path.stat()
            # Also of its mode and owner, which are what an administrator mends in a roster that was refused.
            changed_at = found.st_ctime_ns, found.st_mtime_ns, found.st_ino
            if changed_at == self._changed_at:
                return
            self._changed_at = changed_at
            roster = read_roster(path, self._identity.authority)
        except (OSError, He3Error) as error:
            self._report(f"{path}: the roster that was read before goes on: {error}")
            return
        newest = self._roster.document.revision
        if roster.document.revision < newest:
            self._report(f"{path}: expected revision {newest} or newer, got {roster.document.revision}: it is not used")
            return
        self._roster = roster


def default_instance(identity: Identity) -> str:
    """The run of the mission where none is named: its authority's, so keys of another mission never fit.

    Runs with the same keys share it. Name each run (`--instance`), so that what was signed in one is refused in others.
    """
    return f"keys-{identity.roster.document.authority[:16]}"

"""What a process writes into its audit log: who commanded and changed what, and what was refused."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from he3.errors import He3Error
from schemas.authority import AuthorityChange
from schemas.commands import Telecommand
from schemas.people import NAMING
from schemas.wire import printable, values_set
from services.runtime.trust.audit import MAX_WHAT, AuditKind

if TYPE_CHECKING:
    from schemas.topics import Topic
    from schemas.wire import Header, Wire
    from services.mission.mission_time import MissionTime
    from services.runtime.trust.audit import AuditLog

MAX_SENDERS: Final = 256
"""Senders whose refusals are counted apart; a flood of invented names shares the rest."""
MAX_COMMANDS: Final = 10_000
OTHERS: Final = "others"


class RefusalCounter:
    """Counts refusals by sender, and says which to report: the first, the tenth, the hundredth, and so on."""

    def __init__(self, each_until: int = 1) -> None:
        """each_until: of each sender, so many are reported one by one."""
        self._each_until = each_until
        self._counts: dict[str, int] = {}

    def count(self, sender: str) -> tuple[int, bool]:
        """How many there were of that sender with this one, and whether to report it."""
        known = sender if sender in self._counts or len(self._counts) < MAX_SENDERS else OTHERS
        number = self._counts[known] = self._counts.get(known, 0) + 1
        return number, number <= self._each_until or number == 10 ** (len(str(number)) - 1)


class AuditTrail:
    """Writes into an audit log. One that cannot be written is reported, and the mission goes on.

    It is tried again with each further line. The first that the system takes again says how many are missing.
    """

    def __init__(self, log: AuditLog, report: Callable[[str], None]) -> None:
        self._log = log
        self._report = report
        self._missed = 0
        self._commands: OrderedDict[str, None] = OrderedDict()

    def changed(self, topic: Topic, header: Header | None, body: Any, verified: bool, now: MissionTime) -> None:
        """Write down a command, or a change of the link, the clock or an area of interest; a repetition is left out."""
        fields: dict[str, Any] = {"at": now, "topic": topic.name, "by": named_in(header, body), "verified": verified}
        if isinstance(body, Telecommand):
            if body.command_id in self._commands:
                return
            self._commands[body.command_id] = None
            if len(self._commands) > MAX_COMMANDS:
                self._commands.popitem(last=False)
            what = f"{body.kind.value} {body.command_id}"
            self._add(AuditKind.COMMAND, what=what, order=_short(body.order.model_dump_json()), **fields)
        else:
            kind = AuditKind.AUTHORITY if isinstance(body, AuthorityChange) else AuditKind.CHANGE
            self._add(kind, what=_values(body), **fields)

    def refused(
        self, topic: Topic, by: str, why: str, number: int, now: MissionTime, *, verified: bool = False
    ) -> None:
        """Write down a refusal. by: whom the message names; verified: whether that is proven; number: of theirs."""
        self._add(
            AuditKind.REFUSAL, at=now, topic=topic.name, by=by, verified=verified, why=why, number_of_sender=number
        )

    def _add(self, kind: AuditKind, **fields: Any) -> None:
        try:
            self._log.add(kind, missed=self._missed or None, **fields)
        except He3Error as error:
            if not self._missed:
                self._report(f"{error}; the mission goes on without its audit log, which is tried again with each line")
            self._missed += 1
            return
        if self._missed:
            self._report(f"{self._log.path}: the audit log goes on; {self._missed} lines before it are missing")
            self._missed = 0


def named_in(header: Header | None, body: Any) -> str:
    """Whom a message names as who wants what it says."""
    if isinstance(body, Telecommand) and body.by:
        return body.authorization.signer if body.authorization is not None else str(body.issued_by)
    if isinstance(body, NAMING) and body.by:
        return str(body.by)
    if header is None:
        return ""
    return header.signer or header.source


def _values(change: Wire) -> str:
    """Each value that the change sets, as JSON: one that is the default of its field counts like any other.

    Without them the preset `nominal`, which is made of defaults alone, would be `{"conditions":{}}`.
    """
    values = {name: value for name, value in values_set(change).items() if name != "by"}
    return _short(json.dumps(values, ensure_ascii=False, separators=(",", ":")))


def _short(text: str) -> str:
    """The text, if a line of the log has room for it; else its beginning, with length and SHA-256 of the whole."""
    if len(json.dumps(printable(text))) <= MAX_WHAT:
        return text
    digest = hashlib.sha256(text.encode()).hexdigest()
    return f"{text[:400]}... ({len(text)} characters, SHA-256 {digest})"

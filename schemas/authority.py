"""Command authority: one person at a time commands the rover. It is taken explicitly, and taken over by name."""

from __future__ import annotations

from enum import StrEnum

from schemas.wire import MissionTimeNs, PersonName, Wire


class AuthorityAction(StrEnum):
    TAKE = "take"
    RELEASE = "release"


class AuthorityChange(Wire):
    """A request to take or to release command authority."""

    action: AuthorityAction
    by: PersonName
    """The person who asks; in a mission with keys, the signer of the request."""
    over_from: PersonName | None = None
    """The holder from whom it is taken over (`take` only). Naming them shows that it is meant."""


class AuthorityState(Wire):
    """Who holds command authority."""

    holder: PersonName | None = None
    """None: no one; the sender of the next command becomes the holder."""
    since: MissionTimeNs | None = None
    explicit: bool = False
    """Whether it was taken with `take`; if not, the holder is the sender of the last command."""

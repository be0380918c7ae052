"""Command authority: one person at a time commands the rover. It is taken explicitly, and taken over by name."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from schemas.wire import MissionTimeNs, Text, Wire

PersonName = Annotated[Text, Field(min_length=1, max_length=100)]
"""Who commands: the common name of an identity, or a user and a machine, which nothing proves."""


class AuthorityAction(StrEnum):
    TAKE = "take"
    RELEASE = "release"


class AuthorityChange(Wire):
    """A request to take or to release command authority."""

    action: AuthorityAction
    by: PersonName
    """Who asks; in a mission with keys, who has signed the request."""
    over_from: PersonName | None = None
    """The holder from whom it is taken over (`take` only). Naming them shows that it is meant."""


class AuthorityState(Wire):
    """Who holds command authority."""

    holder: PersonName | None = None
    """None: nobody, and the next one who commands."""
    since: MissionTimeNs | None = None
    explicit: bool = False
    """Whether it was taken; else its holder was the last who commanded."""

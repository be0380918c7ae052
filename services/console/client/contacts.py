"""Contacts between Earth and Moon that are to come, by the link's schedule."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.link.contact import Contact

if TYPE_CHECKING:
    from schemas.link import LinkStatus
    from services.mission.mission_time import MissionTime

MAX_AHEAD = 40
"""Most contacts to come that are listed."""

ContactSpan = tuple["MissionTime", "MissionTime | None"]
"""Begin and end of a contact; the end is None if none is known."""


def contacts_ahead(link: LinkStatus, start: MissionTime, now: MissionTime) -> list[ContactSpan]:
    """The present contact and the next ones, in order; start: of the mission. Empty in a black-out without an end."""
    contact = Contact.of(link.conditions, start, link.contact_forced)
    found: list[ContactSpan] = []
    at = now
    while len(found) < MAX_AHEAD and (span := contact.span_from(at)) is not None:
        found.append((span.opens, span.closes))
        if span.closes is None:
            break
        at = span.closes
    return found

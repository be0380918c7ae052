"""The topics between the time manager and the processes that take part, on each side."""

from __future__ import annotations

from schemas import topics
from schemas.topics import Side, Topic, addressed, counted

JOIN = {Side.MOON: topics.MOON_JOIN, Side.EARTH: topics.EARTH_JOIN}
GRANT = {Side.MOON: topics.MOON_GRANT, Side.EARTH: topics.EARTH_GRANT}
DONE = {Side.MOON: counted(topics.MOON_DONE), Side.EARTH: counted(topics.EARTH_DONE)}
BUSY = {Side.MOON: counted(topics.MOON_BUSY), Side.EARTH: counted(topics.EARTH_BUSY)}
POKE = {Side.MOON: counted(topics.MOON_POKE), Side.EARTH: counted(topics.EARTH_POKE)}

TO_TIME_MANAGER = (DONE, BUSY, POKE)
"""Topics that a participant publishes to the time manager, by side."""


def grant_to(name: str, side: Side) -> Topic:
    """The topic of the grants to that process."""
    return counted(addressed(GRANT[side], name))

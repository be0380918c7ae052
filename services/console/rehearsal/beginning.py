"""Where the rehearsals of a live mission begin."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.console.rehearsal.flight import Start

if TYPE_CHECKING:
    from services.console.client.mission_client import MissionClient


def start_of(mission: MissionClient) -> Start:
    """The mission as its ground knows it now, its link, and the commands under way; the mission does not change."""
    under_way = tuple(status.command for status in mission.commands() if status.end is None)
    return Start(mission.fork(), mission.link(), under_way)

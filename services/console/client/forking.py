"""A copy of the live mission, for rehearsals."""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.commands import NoParameters
from schemas.topics import FORK

if TYPE_CHECKING:
    from schemas.fork import MissionFork
    from services.runtime.transport.client import Client


class Forks:
    """The part of `MissionClient` that copies the mission."""

    _session: Client

    def fork(self) -> MissionFork:
        """The mission as the ground knows it now; the mission does not change."""
        copied: MissionFork = self._session.query(FORK, NoParameters())
        return copied

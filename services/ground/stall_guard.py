"""Ends a stalled mission, with the samples it has and with the reason."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from schemas.commands import NoParameters
from schemas.link import LinkStatus
from schemas.topics import LINK_SHOW
from services.runtime.node import Effect, SendQuery

if TYPE_CHECKING:
    from schemas.telemetry import RoverState
    from services.ground.director import Director
    from services.ground.silence import SilenceWatch
    from services.ground.stall_watch import StallWatch
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState

STALL_QUERY = "link-of-a-stalled-mission"


class StallGuard:
    """Asks the link before it ends the mission: its conditions, which an operator may have changed, may explain it."""

    def __init__(self, watch: StallWatch, director: Director, silence: SilenceWatch) -> None:
        self._watch = watch
        self._director = director
        self._silence = silence
        self._rover: RoverState | None = None
        self._asked = False

    def progress(self, now: MissionTime) -> None:
        """Something has changed."""
        self._watch.progress(now)

    def state(self, state: RoverState, held: bool, now: MissionTime) -> None:
        """Note the rover's state; held: whether a command of the operator holds it still."""
        self._rover = state
        self._watch.state(state, held, now)

    def tick(self, now: MissionTime) -> Iterable[Effect]:
        """A query to the link when the mission has stood still for too long; to be called once a status period."""
        if self._director.computing or self._director.ended:
            self._watch.progress(now)
        elif self._watch.tick(now) and not self._asked:
            self._asked = True
            yield SendQuery(LINK_SHOW, NoParameters(), STALL_QUERY)

    def link_answered(self, link: LinkStatus | None, now: MissionTime) -> Iterable[Effect]:
        """End the mission, unless the link's conditions explain the stall; None: the link did not answer."""
        self._asked = False
        if link is not None:
            self._watch.link(link, now)
        if self._watch.stalled(now) and not self._director.computing:
            progress = self._director.progress()
            silent_s = self._silence.lasts_s(now)
            yield from self._director.give_up(
                self._watch.why(now, self._rover, silent_s, progress.plan_revision, progress.detail)
            )

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {"watch": self._watch.checkpoint(), "rover": self._rover, "asked": self._asked}

    def restore(self, state: SavedState) -> None:
        """Restore the guard from this state."""
        self._watch.restore(state["watch"])
        self._rover, self._asked = state["rover"], state["asked"]

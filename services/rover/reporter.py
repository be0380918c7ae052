"""What the rover tells the ground: events and telecommands' stages, with where and when it was."""

from __future__ import annotations

from typing import Final

from he3.frames import Place
from schemas.commands import CommandReport
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import COMMAND_REPORT, EVENT
from services.rover.activities import Activity
from services.rover.plan_queue import PlanQueue
from services.rover.vehicle import Vehicle
from services.runtime.node import Effect, MissionTime, Send

MAX_DETAIL: Final = 500  # characters, as the message admits


class Reporter:
    """Appends to the effects what is to be told."""

    def __init__(self, vehicle: Vehicle, plan_queue: PlanQueue, out: list[Effect]) -> None:
        self._vehicle = vehicle
        self._plan_queue = plan_queue
        self._out = out

    def report(self, report: CommandReport) -> None:
        """Tells of a telecommand's stage."""
        self._out.append(Send(COMMAND_REPORT, report))

    def tell_of_job(
        self, kind: EventKind, job: Activity, now: MissionTime, detail: str = "", obstacle_m: Place | None = None
    ) -> None:
        """Tells of an event in a round, with the samples of it that are measured; in an errand, of round 0."""
        self.tell(
            kind,
            now,
            detail,
            round_=job.round,
            revision=job.revision,
            obstacle_m=obstacle_m,
            samples_done=tuple(job.measured),
        )

    def tell(
        self,
        kind: EventKind,
        now: MissionTime,
        detail: str = "",
        *,
        round_: int | None = None,
        revision: int | None = None,
        sample_id: str | None = None,
        obstacle_m: Place | None = None,
        samples_done: tuple[str, ...] = (),
    ) -> None:
        """Tells of an event; where nothing else is said, in the last round begun, under the last plan accepted."""
        x, y = self._vehicle.place_m(now)
        event = RoverEvent(
            kind=kind,
            at=now,
            x_m=x,
            y_m=y,
            round=self._plan_queue.round if round_ is None else round_,
            plan_revision=self._plan_queue.revision if revision is None else revision,
            sample_id=sample_id,
            driven_m=self._vehicle.driven_m(now),
            obstacle_m=obstacle_m,
            samples_done=samples_done,
            detail=detail[:MAX_DETAIL],
        )
        self._out.append(Send(EVENT, event))

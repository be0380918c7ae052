"""The rover's reports to the ground: events and the stages of telecommands, with place, time and odometer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import COMMAND_REPORT, EVENT
from services.runtime.node import Effect, Send

if TYPE_CHECKING:
    from he3.frames import Place
    from schemas.commands import CommandReport
    from services.mission.mission_time import MissionTime
    from services.rover.activities import Activity
    from services.rover.plan_queue import PlanQueue
    from services.rover.vehicle import Vehicle

MAX_DETAIL: Final = 500  # characters; the limit of the message's field


class Reporter:
    """Appends reports to the effects of the event being handled."""

    def __init__(self, vehicle: Vehicle, plan_queue: PlanQueue, effects: list[Effect]) -> None:
        self._vehicle = vehicle
        self._plan_queue = plan_queue
        self._effects = effects

    def report_command(self, report: CommandReport) -> None:
        """Reports a telecommand's stage."""
        self._effects.append(Send(COMMAND_REPORT, report))

    def report_activity(
        self, kind: EventKind, activity: Activity, now: MissionTime, detail: str = "", obstacle_m: Place | None = None
    ) -> None:
        """Reports an event of an activity, with the samples that it has measured. A commanded drive is round 0."""
        self.report_event(
            kind,
            now,
            detail,
            round_=activity.round,
            revision=activity.revision,
            obstacle_m=obstacle_m,
            samples_done=tuple(activity.measured),
        )

    def report_event(
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
        """Reports an event. Round and revision default to the last round begun and the last plan accepted."""
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
        self._effects.append(Send(EVENT, event))

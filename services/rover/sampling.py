"""Sampling: at one place, drill bite by bite, analyse the cuttings, and ask the instrument for the value."""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.measurement import MeasurementReply, MeasurementRequest
from schemas.telemetry import EventKind, SampleReport
from schemas.topics import MEASURE, SAMPLE
from services.mission.mission_time import MissionTime, seconds
from services.rover.states import State, Trigger
from services.runtime.node import Effect, Send

if TYPE_CHECKING:
    from services.mission.scenario import RoverConfig
    from services.rover.drill import Borehole
    from services.rover.energy_guard import EnergyGuard
    from services.rover.instruments import Instruments
    from services.rover.operating_state import OperatingState
    from services.rover.plan_queue import PlanQueue
    from services.rover.reporter import Reporter
    from services.rover.schedule import Schedule
    from services.rover.vehicle import Vehicle


class Sampling:
    """Works on the borehole of the current activity."""

    def __init__(
        self,
        config: RoverConfig,
        *,
        vehicle: Vehicle,
        operating: OperatingState,
        energy: EnergyGuard,
        plan_queue: PlanQueue,
        schedule: Schedule,
        instruments: Instruments,
        reporter: Reporter,
        effects: list[Effect],
    ) -> None:
        self._config = config
        self._vehicle = vehicle
        self._operating = operating
        self._energy = energy
        self._plan_queue = plan_queue
        self._schedule = schedule
        self._instruments = instruments
        self._reporter = reporter
        self._effects = effects

    def advance(self, borehole: Borehole, now: MissionTime) -> MissionTime | None:
        """Begins the next step at the borehole; returns when a bite or an analysis ends, None if the rover waits."""
        config = self._config
        if borehole.bites_left_m:
            return self._begin(Trigger.DRILL, config.drill_w, borehole.bites_left_m[0] * config.drill_s_per_m, now)
        if not borehole.analysed:
            return self._begin(Trigger.DEPTH_REACHED, config.analysis_w, config.analysis_s, now)
        self._operating.enter(Trigger.ANALYSIS_DONE, now)
        (x, y), sample = self._vehicle.standing_m, borehole.sample
        request = MeasurementRequest(sample_id=sample.sample_id, x_m=x, y_m=y, depth_m=sample.depth_m)
        self._instruments.ask(MEASURE, request)
        return None

    def _begin(self, trigger: Trigger, load_w: float, duration_s: float, now: MissionTime) -> MissionTime | None:
        if not self._energy.affords(load_w, duration_s, now):
            return None
        self._operating.enter(trigger, now, load_w)
        return now + seconds(duration_s)

    def step_ended(self, borehole: Borehole) -> None:
        """Handles the end of a bite or of the analysis."""
        if self._operating.state is State.DRILLING:
            self._vehicle.drilled_m += borehole.bites_left_m.pop(0)
        elif self._operating.state is State.ANALYSING:
            borehole.analysed = True

    def value_received(self, query: str, reply: MeasurementReply, now: MissionTime) -> bool:
        """Reports the sample and finishes the leg; False if the reply is not to the pending query, or is wrong."""
        activity = self._schedule.current
        if not self._instruments.expects(query) or activity is None or activity.borehole is None:
            return False
        sample = activity.borehole.sample
        if reply.sample_id != sample.sample_id:
            self._instruments.failed(MEASURE, now, f"{sample.sample_id} asked for, {reply.sample_id} answered")
            return False
        self._instruments.answered(MEASURE)
        x, y = self._vehicle.standing_m
        self._plan_queue.measured.add(sample.sample_id)
        activity.measured.append(sample.sample_id)
        report = SampleReport(
            sample_id=sample.sample_id,
            round=activity.round,
            plan_revision=activity.revision,
            x_m=x,
            y_m=y,
            depth_m=sample.depth_m,
            helium3_ppb=reply.helium3_ppb,
            noise_std_ppb=reply.noise_std_ppb,
            measured_at=now,
            driven_m=self._vehicle.driven_m(now),
        )
        self._effects.append(Send(SAMPLE, report))
        self._schedule.finish_leg(activity, now)
        return True

    def refused(self, now: MissionTime, why: str) -> bool:
        """Skips the sample that the instrument refuses to measure; False if no sample is being measured."""
        activity = self._schedule.current
        if activity is None or activity.borehole is None:
            return False
        self._instruments.answered(MEASURE)
        sample_id = activity.borehole.sample.sample_id
        self._reporter.report_event(EventKind.SAMPLE_SKIPPED, now, why, revision=activity.revision, sample_id=sample_id)
        self._schedule.finish_leg(activity, now)
        return True

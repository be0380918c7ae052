"""The rover's executive: chooses and begins each step, and executes telecommands between two steps.

A step is a scan, a drive over one path section, a bite of the drill, an analysis or a measurement. Between steps the
rover is at a safe point: there the waiting telecommands are executed, and then the next step is chosen. The parts below
do not depend on the executive: each returns the outcome of its step, and the executive decides how to proceed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from schemas.telemetry import EventKind, RoverMode, RoverState
from schemas.topics import MEASURE, Topic
from services.rover.command_handlers import CommandHandlers, Controls
from services.rover.command_registry import CommandRegistry
from services.rover.drill import Borehole
from services.rover.driving import Driving
from services.rover.energy import full_battery
from services.rover.energy_guard import EnergyGuard
from services.rover.instruments import Instruments
from services.rover.keep_outs import KeepOuts
from services.rover.operating_state import OperatingState
from services.rover.plan_queue import PlanQueue
from services.rover.reporter import Reporter
from services.rover.sampling import Sampling
from services.rover.schedule import Schedule
from services.rover.states import ENDED_BY_PLAN, State, Trigger
from services.rover.vehicle import Vehicle
from services.rover.watchdog import Watchdog
from services.runtime.node import Effect, Finish, Level, LogRecord, NoReply, SetTimer

if TYPE_CHECKING:
    from he3.frames import Place, SiteGrid
    from schemas.commands import Telecommand
    from schemas.measurement import MeasurementReply, TerrainReply
    from schemas.plans import MissionPlan
    from schemas.wire import Header
    from services.mission.mission_time import MissionTime
    from services.mission.scenario import RoverConfig
    from services.rover.activities import Activity
    from services.runtime.node import SavedState, Stateful

STEP: Final = "step"
"""Timer: the end of the drive, the bite or the analysis."""


class Executive:
    """Decides what the rover does next. Each method takes the time and appends its effects to `effects`."""

    def __init__(
        self,
        config: RoverConfig,
        site: SiteGrid,
        start_m: Place,
        start: MissionTime,
        keep_outs: Mapping[str, Sequence[Place]] | None = None,
    ) -> None:
        """keep_outs: corners [m] of the areas closed from the beginning, by their ids."""
        self.effects: list[Effect] = []
        effects = self.effects
        self._vehicle = Vehicle(start_m, full_battery(config, start))
        self._plan_queue = PlanQueue()
        self._reporter = Reporter(self._vehicle, self._plan_queue, effects)
        self._operating = OperatingState(self._vehicle, self._reporter, effects)
        self._energy = EnergyGuard(config, self._vehicle, self._operating, self._reporter, effects)
        self._watchdog = Watchdog(config.watchdog_s, self._operating, effects)
        self._instruments = Instruments(config.instrument_retry_s, self._reporter, effects)
        areas = KeepOuts(config.footprint_radius_m, keep_outs or {})
        registry = CommandRegistry()
        self._schedule = Schedule(
            site=site,
            vehicle=self._vehicle,
            keep_outs=areas,
            plan_queue=self._plan_queue,
            commands=registry,
            reporter=self._reporter,
            effects=effects,
        )
        controls = Controls(site, self._vehicle, areas, self._operating, self._schedule)
        self._commands = CommandHandlers(controls, registry, self._reporter, effects)
        self._driving = Driving(
            config,
            site,
            vehicle=self._vehicle,
            keep_outs=areas,
            operating=self._operating,
            energy=self._energy,
            schedule=self._schedule,
            instruments=self._instruments,
            reporter=self._reporter,
        )
        self._sampling = Sampling(
            config,
            vehicle=self._vehicle,
            operating=self._operating,
            energy=self._energy,
            plan_queue=self._plan_queue,
            schedule=self._schedule,
            instruments=self._instruments,
            reporter=self._reporter,
            effects=effects,
        )
        self._bite_m = config.bite_m
        self._stateful: dict[str, Stateful] = {
            "vehicle": self._vehicle,
            "plan_queue": self._plan_queue,
            "operating": self._operating,
            "instruments": self._instruments,
            "keep_outs": areas,
            "registry": registry,
            "schedule": self._schedule,
            "driving": self._driving,
        }
        """The parts that have a state."""

    # --- what it reports ------------------------------------------------------------------------------------------

    @property
    def mode(self) -> RoverMode:
        """The mode that is reported."""
        return self._operating.mode

    def report_state(self, now: MissionTime, queue_depth: int) -> RoverState:
        """The report of the rover's state; queue_depth counts messages not yet acknowledged by the ground."""
        return self._vehicle.report_state(
            now,
            mode=self.mode,
            round_=self._plan_queue.round,
            plan_revision=self._plan_queue.revision,
            rounds_on_board=len(self._plan_queue.on_board),
            samples_done=len(self._plan_queue.measured),
            queue_depth=queue_depth,
        )

    # --- what comes from the ground -------------------------------------------------------------------------------

    def plan_received(self, plan: MissionPlan, now: MissionTime) -> None:
        """Accepts the plan or rejects it; an idle rover begins it."""
        if not self._schedule.accept_plan(plan, now):
            return
        if self._operating.hold in ENDED_BY_PLAN:
            self._operating.release(now, f"plan {plan.revision}")
        if self._operating.standing:
            self._proceed(now)

    def command_received(self, command: Telecommand, header: Header, now: MissionTime) -> None:
        """Accepts the telecommand or rejects it; it is executed now, or at the next safe point."""
        self._commands.receive(command, header, now)
        if self._commands.waiting and self._operating.interruptible:
            self._proceed(now)

    def ground_heard(self, now: MissionTime) -> None:
        """Note a message from the ground, of any kind."""
        self._watchdog.restart(now)

    def watchdog_expired(self, now: MissionTime) -> None:
        """Handle the watchdog's timer: the ground has been silent for too long."""
        self._watchdog.expired(now)

    # --- safe points ----------------------------------------------------------------------------------------------

    def _proceed(self, now: MissionTime) -> None:
        """At a safe point: executes the waiting telecommands, then begins the next step unless the rover is held."""
        self._instruments.withdraw()
        self._commands.execute_waiting(now)
        if self._operating.hold is None:
            self._next_step(now)

    def _next_step(self, now: MissionTime) -> None:
        while not self._schedule.empty:
            activity = self._schedule.current
            if activity is None:
                self._schedule.begin_round(now)
            elif activity.borehole is not None:
                self._await_step(self._sampling.advance(activity.borehole, now))
                return
            elif self._driving.advance(activity, now):
                return
            else:
                self._leg_driven(activity, now)
        self._park(now)

    def _leg_driven(self, activity: Activity, now: MissionTime) -> None:
        sample = activity.current_leg.sample
        if sample is not None:
            activity.borehole = Borehole.begun(sample, self._bite_m)
        else:
            self._schedule.finish_leg(activity, now)

    def _await_step(self, ends_at: MissionTime | None) -> None:
        if ends_at is not None:
            self.effects.append(SetTimer(STEP, ends_at))

    def _park(self, now: MissionTime) -> None:
        worked = self._schedule.take_begun()
        if self._operating.unoccupied and not worked:
            return
        self._operating.enter(Trigger.QUEUE_EMPTY, now)
        self._watchdog.restart(now)
        if not self._plan_queue.completes():
            self._reporter.report_event(EventKind.PARKED, now)
            return
        self._reporter.report_event(EventKind.MISSION_COMPLETED, now)
        done = f"{self._plan_queue.round} rounds and {len(self._plan_queue.measured)} samples are done"
        self.effects.append(Finish(True, done))

    # --- how steps end --------------------------------------------------------------------------------------------

    def step_ended(self, now: MissionTime) -> None:
        """Handles the end of a drive, a bite or an analysis."""
        activity, state = self._schedule.current, self._operating.state
        if state is State.DRIVING:
            self._vehicle.arrive(now)
        elif state in (State.DRILLING, State.ANALYSING) and activity is not None and activity.borehole is not None:
            self._sampling.step_ended(activity.borehole)
        else:
            self.effects.append(LogRecord(Level.WARNING, "step ended that is not under way", {"state": state.value}))
            return
        self._proceed(now)

    def terrain_received(self, query: str, terrain: TerrainReply, now: MissionTime) -> None:
        """Handles the terrain ahead: the rover drives, or stops in front of closed terrain."""
        self._await_step(self._driving.terrain_received(query, terrain, now))

    def value_received(self, query: str, reply: MeasurementReply, now: MissionTime) -> None:
        """Handles the sample's value: it is reported, and the rover proceeds."""
        if self._sampling.value_received(query, reply, now):
            self._proceed(now)

    def query_failed(self, topic: Topic, query: str, why: NoReply, detail: str, now: MissionTime) -> None:
        """Handles a failed query: a silent instrument is asked again later; a sample that it refuses is skipped."""
        if not self._instruments.expects(query):
            return
        if topic == MEASURE and why is NoReply.REFUSED and self._sampling.refused(now, detail):
            self._proceed(now)
            return
        self._instruments.failed(topic, now, f"{why.value}: {detail}" if detail else why.value)

    def retry(self, now: MissionTime) -> None:
        """Asks the silent instrument again."""
        if self._instruments.waiting:
            self._proceed(now)

    def charged(self, now: MissionTime) -> None:
        """Handles the end of charging: the rover continues where it stopped."""
        if self._energy.charged(now):
            self._proceed(now)

    # --- checkpoints ----------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """The state of each part, by its name."""
        return {name: part.checkpoint() for name, part in self._stateful.items()}

    def restore(self, state: SavedState) -> None:
        """Restore the executive from this state."""
        for name, part in self._stateful.items():
            part.restore(state[name])

"""The rover's executive: takes one step after the other, and at each safe point what was commanded.

A step is a look, a piece of way, a bite, an analysis or a question to the instrument. Between steps the rover is at a
safe point: there telecommands are carried out, energy is counted, and the next step is chosen. What it turns to is
the table's in ``phases``; this is what it does then.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

from he3.frames import Place, SiteGrid
from schemas.commands import CommandStage
from schemas.measurement import MeasurementReply, MeasurementRequest, TerrainReply, TerrainRequest
from schemas.plans import MissionPlan
from schemas.telemetry import EventKind, RoverMode, RoverState, SampleReport
from schemas.topics import MEASURE, SAMPLE, TERRAIN, Topic
from services.mission.scenario import RoverConfig
from services.rover.activities import Activity
from services.rover.command_registry import CommandRegistry
from services.rover.drill import Hole
from services.rover.energy import full_battery
from services.rover.geometry import Area
from services.rover.instruments import Instruments
from services.rover.plan_queue import PlanQueue
from services.rover.reporter import Reporter
from services.rover.states import (
    ENDED_BY_PLAN,
    HOLD_TRIGGERS,
    INTERRUPTIBLE,
    MODES,
    STANDING,
    Hold,
    Phase,
    Trigger,
    after,
)
from services.rover.traverse import Look, Piece, corridor, drive, forbidden
from services.rover.vehicle import Vehicle
from services.runtime.node import Effect, Finish, Level, LogRecord, MissionTime, NoReply, Send, SetTimer, seconds

STEP: Final = "step"
CHARGED: Final = "charged"
WATCHDOG: Final = "watchdog"

_ROUNDING_WH: Final = 1e-6  # the battery is charged to a level at a whole nanosecond


@dataclass(frozen=True, slots=True)
class _Ahead:
    """A piece that waits for its look to be answered."""

    piece: Piece
    look: Look


class Executive:
    """What the rover is doing and why. Each method takes the time, and leaves its effects in ``out``."""

    def __init__(self, config: RoverConfig, site: SiteGrid, start_m: Place, start: MissionTime) -> None:
        self.config = config
        self.site = site
        self.vehicle = Vehicle(start_m, full_battery(config, start))
        self.commands = CommandRegistry()
        self.areas: dict[str, Area] = {}
        self.phase = Phase.IDLE
        self.hold: Hold | None = None
        self.job: Activity | None = None
        self.out: list[Effect] = []
        self.at_safe_point: Callable[[MissionTime], None] = lambda now: None
        """Carries out what was commanded; whoever takes the telecommands puts it here."""
        self._corridor = corridor(config, site)
        self._plan_queue = PlanQueue()
        self.reporter = Reporter(self.vehicle, self._plan_queue, self.out)
        self._instruments = Instruments(config.instrument_retry_s)
        self._ahead: _Ahead | None = None
        self._busy = False

    # --- what it tells ------------------------------------------------------------------------------------------

    @property
    def mode(self) -> RoverMode:
        """The mode as it is reported."""
        return MODES[self.phase]

    def state(self, now: MissionTime, queue_depth: int) -> RoverState:
        """The rover's state as it is reported."""
        return self.vehicle.state(
            now,
            mode=self.mode,
            round_=self._plan_queue.round,
            plan_revision=self._plan_queue.revision,
            rounds_on_board=len(self._plan_queue.on_board),
            samples_done=len(self._plan_queue.measured),
            queue_depth=queue_depth,
        )

    # --- plans --------------------------------------------------------------------------------------------------

    def take_plan(self, plan: MissionPlan, now: MissionTime) -> None:
        """Accepts the plan in place of all rounds that have not begun, or rejects it and changes nothing."""
        plan_queue = self._plan_queue
        if plan == plan_queue.plan:
            self.out.append(LogRecord(Level.DEBUG, "plan received again", {"revision": plan.revision}))
            return
        place = (self.job.ends_m if self.job else None) or self.vehicle.standing_m
        margin = self.config.footprint_radius_m
        why = plan_queue.take(plan, self.job, place, site=self.site, areas=self.areas, margin_m=margin)
        if why is not None:
            self.reporter.tell(EventKind.PLAN_REJECTED, now, why, round_=plan.rounds[0].round, revision=plan.revision)
            return
        first, last = plan_queue.on_board[0].round, plan_queue.on_board[-1].round
        self.reporter.tell(EventKind.PLAN_ACCEPTED, now, f"rounds {first} to {last}", round_=first)
        if self.hold in ENDED_BY_PLAN:
            self.release(now, f"plan {plan.revision}")
        if self.phase in STANDING:
            self.proceed(now)

    # --- going on -----------------------------------------------------------------------------------------------

    @property
    def interruptible(self) -> bool:
        """Whether the rover need not finish a step before it turns to something else."""
        return self.phase in INTERRUPTIBLE

    def proceed(self, now: MissionTime) -> None:
        """At a safe point: carries out what was commanded, then takes the next step unless something holds it."""
        self.out += self._instruments.withdraw()
        self.at_safe_point(now)
        if self.hold is None:
            self._next_step(now)

    def _next_step(self, now: MissionTime) -> None:
        while True:
            if self.job is None:
                if not self._plan_queue.on_board:
                    self._park(now)
                    return
                self._begin_round(now)
            elif self.job.hole is not None:
                self._work_on(self.job.hole, now)
                return
            elif self._next_piece(self.job, now):
                return

    def _next_piece(self, job: Activity, now: MissionTime) -> bool:
        """Looks along the next piece of the leg, if there is one; else turns to what is at the leg's end."""
        leg = job.legs[job.leg]
        piece = self._corridor.cut(self.vehicle.standing_m, leg.way_m, job.vertex)
        if piece.length_m > 0:
            self._look(job, piece, now)
            return True
        job.vertex += piece.vertices
        if job.vertex < len(leg.way_m):
            return False
        if leg.sample is not None:
            job.hole = Hole.begun(leg.sample, self.config.bite_m)
        else:
            self._next_leg(job, now)
        return False

    def _next_leg(self, job: Activity, now: MissionTime) -> None:
        job.hole, job.vertex = None, 0
        job.leg += 1
        if job.leg == len(job.legs):
            self.job = None
            if job.command_id is not None:
                self.reporter.report(
                    self.commands.passed(self.commands.find(job.command_id), CommandStage.COMPLETED, now)
                )
            else:
                self.reporter.tell_of_job(EventKind.ROUND_COMPLETED, job, now)

    def _begin_round(self, now: MissionTime) -> None:
        job = self._plan_queue.next_round()
        self.start(job)
        self.reporter.tell_of_job(EventKind.ROUND_STARTED, job, now)

    def start(self, job: Activity) -> None:
        """Makes the job what the rover is about; it may leave the closed areas that it stands in."""
        here, margin = self.vehicle.standing_m, self.config.footprint_radius_m
        job.leaving = {name for name, area in self.areas.items() if area.is_near(here, here, margin)}
        self.job, self._busy = job, True

    def abandon(self, now: MissionTime, why: str) -> None:
        """Gives up what the rover is about, and the rounds on board: they begin where it now will not be."""
        job, self.job = self.job, None
        dropped = self._plan_queue.abort(job)
        if job is not None and job.round:
            self.reporter.tell_of_job(EventKind.ROUND_ABORTED, job, now, why)
        elif dropped:  # no round tells of it, so the plan must
            self.reporter.tell(EventKind.PLAN_REJECTED, now, f"the rover will not be where its rounds begin: {why}")
        if job is not None and job.command_id is not None:
            self.reporter.report(
                self.commands.passed(self.commands.find(job.command_id), CommandStage.FAILED, now, why)
            )

    def _park(self, now: MissionTime) -> None:
        if self.phase in (Phase.IDLE, Phase.PARKED) and not self._busy:
            return
        self._enter(Trigger.NOTHING_LEFT, now)
        self._busy = False
        self.watch(now)
        if not self._plan_queue.completes():
            self.reporter.tell(EventKind.PARKED, now)
            return
        self.reporter.tell(EventKind.MISSION_COMPLETED, now)
        done = f"{self._plan_queue.round} rounds and {len(self._plan_queue.measured)} samples are done"
        self.out.append(Finish(True, done))

    def _enter(self, trigger: Trigger, now: MissionTime, load_w: float = 0.0) -> None:
        self.phase = after(self.phase, trigger)
        self.vehicle.work(load_w, now)

    # --- holds --------------------------------------------------------------------------------------------------

    def hold_for(self, hold: Hold, now: MissionTime, why: str) -> None:
        """Stands still for that reason from now on; the job is kept."""
        safe_before = self.hold is not None and self.hold is not Hold.PAUSE
        if self.hold is Hold.ENERGY:
            self.out.append(SetTimer(CHARGED, None))
        self.hold = hold
        self._enter(HOLD_TRIGGERS[hold], now)
        if hold is Hold.PAUSE:
            if safe_before:
                self.reporter.tell(EventKind.SAFE_MODE_LEFT, now, why)
            self.reporter.tell(EventKind.PAUSED, now, why)
        else:
            self.reporter.tell(EventKind.SAFE_MODE_ENTERED, now, f"{hold.value}: {why}" if why else hold.value)

    def release(self, now: MissionTime, why: str) -> None:
        """Ends what holds the rover; the next step is taken by ``proceed``."""
        if self.hold is None:
            return
        if self.hold is Hold.ENERGY:
            self.out.append(SetTimer(CHARGED, None))
        kind = EventKind.RESUMED if self.hold is Hold.PAUSE else EventKind.SAFE_MODE_LEFT
        self.hold = None
        self.reporter.tell(kind, now, why)

    def _can_afford(self, load_w: float, duration_s: float, now: MissionTime) -> bool:
        """Whether the step leaves the reserve untouched; if not, the rover holds to charge."""
        battery, config = self.vehicle.battery, self.config
        need = battery.need_wh(load_w, duration_s)
        floor = config.reserve * config.capacity_wh
        charge = battery.charge_at(now)
        if charge - need >= floor - _ROUNDING_WH:
            return True
        level = max(config.resume_charge * config.capacity_wh, floor + need)
        self.vehicle.rest(now)
        ready = self.vehicle.battery.reaches(level, now)
        why = f"{charge:.1f} Wh left, the next step takes {need:.1f} Wh, {floor:.1f} Wh are in reserve"
        self.reporter.tell(EventKind.LOW_ENERGY, now, why)
        if level > config.capacity_wh or ready is None:
            self.hold_for(Hold.SPENT, now, why)
        else:
            self.hold_for(Hold.ENERGY, now, f"until {level:.1f} Wh")
            self.out.append(SetTimer(CHARGED, ready))
        return False

    def charged(self, now: MissionTime) -> None:
        """The battery holds enough again: goes on where it stopped."""
        if self.hold is Hold.ENERGY:
            self.reporter.tell(EventKind.CHARGED, now, f"{self.vehicle.battery.charge_at(now):.1f} Wh")
            self.release(now, "charged")
            self.proceed(now)

    def watch(self, now: MissionTime) -> None:
        """Waits for a word from the ground, if the rover has nothing else to do."""
        if self.config.watchdog_s is not None and self.phase in (Phase.IDLE, Phase.PARKED):
            self.out.append(SetTimer(WATCHDOG, now + seconds(self.config.watchdog_s)))

    def unheard(self, now: MissionTime) -> None:
        """Nothing has been heard of the ground for too long."""
        if self.phase in (Phase.IDLE, Phase.PARKED):
            self.hold_for(Hold.SILENCE, now, f"for {self.config.watchdog_s:g} s")

    # --- driving ------------------------------------------------------------------------------------------------

    def _look(self, job: Activity, piece: Piece, now: MissionTime) -> None:
        if self.areas:
            closed = self._closed(job, piece)
            if closed is not None:
                name, place = closed
                self._blocked(job, now, f"the way enters keep-out {name}", place)
                return
        look = self._corridor.look(piece)
        self._ahead = _Ahead(piece, look)
        self._enter(Trigger.LOOK, now)
        self._put(TERRAIN, TerrainRequest(points_m=look.points_m))

    def _closed(self, job: Activity, piece: Piece) -> tuple[str, Place] | None:
        """The closed area that the piece enters, and a place of the piece that is too near to it; None if clear."""
        margin, here = self.config.footprint_radius_m, piece.points_m[0]
        still_in = (name for name in job.leaving if name in self.areas)
        job.leaving = {name for name in still_in if self.areas[name].is_near(here, here, margin)}
        for name, area in self.areas.items():
            if name not in job.leaving:
                place = area.first_near(piece.points_m, margin)
                if place is not None:
                    return name, place
        return None

    def seen(self, query: str, seen: TerrainReply, now: MissionTime) -> None:
        """The terrain ahead is known: drives, or stops before what it may not cross."""
        job, ahead = self.job, self._ahead
        if not self._instruments.expects(query) or ahead is None or job is None:
            return
        if len(seen.traversable) != len(ahead.look.points_m):
            self._unclear(
                TERRAIN, now, f"{len(ahead.look.points_m)} places asked for, {len(seen.traversable)} answered"
            )
            return
        self._instruments.answered(TERRAIN)
        obstacles = forbidden(ahead.look, seen, self.config, self.site.resolution_m, self.vehicle.standing_m)
        if obstacles:
            x, y = nearest = min(obstacles, key=partial(math.dist, self.vehicle.standing_m))
            self._blocked(job, now, f"closed terrain ahead, nearest at ({x:.2f}, {y:.2f})", nearest)
            return
        under_way = drive(ahead.piece, ahead.look, seen, self.config, now)
        if not self._can_afford(under_way.load_w, under_way.duration_s, now):
            return
        job.vertex += ahead.piece.vertices
        self._ahead = None
        self.phase = after(self.phase, Trigger.WAY_CLEAR)
        self.vehicle.set_off(under_way, now)
        self.out.append(SetTimer(STEP, now + seconds(under_way.duration_s)))

    def _blocked(self, job: Activity, now: MissionTime, why: str, obstacle_m: Place) -> None:
        self._ahead = None
        self.reporter.tell_of_job(EventKind.BLOCKED, job, now, why, obstacle_m)
        self.abandon(now, why)
        self.hold_for(Hold.TERRAIN, now, why)

    # --- drilling and analysing ---------------------------------------------------------------------------------

    def _work_on(self, hole: Hole, now: MissionTime) -> None:
        config = self.config
        if hole.bites_left_m:
            self._work(Trigger.DRILL, config.drill_w, hole.bites_left_m[0] * config.drill_s_per_m, now)
        elif not hole.analysed:
            self._work(Trigger.HOLE_DONE, config.analysis_w, config.analysis_s, now)
        else:
            self._enter(Trigger.ANALYSED, now)
            x, y = self.vehicle.standing_m
            sample = hole.sample
            self._put(MEASURE, MeasurementRequest(sample_id=sample.sample_id, x_m=x, y_m=y, depth_m=sample.depth_m))

    def _work(self, trigger: Trigger, load_w: float, duration_s: float, now: MissionTime) -> None:
        if self._can_afford(load_w, duration_s, now):
            self._enter(trigger, now, load_w)
            self.out.append(SetTimer(STEP, now + seconds(duration_s)))

    def step_over(self, now: MissionTime) -> None:
        """The piece, the bite or the analysis under way is done."""
        hole = self.job.hole if self.job else None
        if self.phase is Phase.DRIVING:
            self.vehicle.arrive(now)
        elif self.phase is Phase.DRILLING and hole is not None:
            self.vehicle.drilled_m += hole.bites_left_m.pop(0)
        elif self.phase is Phase.ANALYSING and hole is not None:
            hole.analysed = True
        else:
            self.out.append(LogRecord(Level.WARNING, "step ended that is not under way", {"phase": self.phase.value}))
            return
        self.proceed(now)

    def measured(self, query: str, reply: MeasurementReply, now: MissionTime) -> None:
        """The sample's number is known: reports it, and goes on."""
        job = self.job
        if not self._instruments.expects(query) or job is None or job.hole is None:
            return
        sample = job.hole.sample
        if reply.sample_id != sample.sample_id:
            self._unclear(MEASURE, now, f"{sample.sample_id} asked for, {reply.sample_id} answered")
            return
        self._instruments.answered(MEASURE)
        x, y = self.vehicle.standing_m
        self._plan_queue.measured.add(sample.sample_id)
        job.measured.append(sample.sample_id)
        report = SampleReport(
            sample_id=sample.sample_id,
            round=job.round,
            plan_revision=job.revision,
            x_m=x,
            y_m=y,
            depth_m=sample.depth_m,
            helium3_ppb=reply.helium3_ppb,
            noise_std_ppb=reply.noise_std_ppb,
            measured_at=now,
            driven_m=self.vehicle.driven_m(now),
        )
        self.out.append(Send(SAMPLE, report))
        self._next_leg(job, now)
        self.proceed(now)

    # --- instruments --------------------------------------------------------------------------------------------

    def _put(self, topic: Topic, request: TerrainRequest | MeasurementRequest) -> None:
        self.out.append(self._instruments.ask(topic, request))

    def unanswered(self, topic: Topic, query: str, why: NoReply, detail: str, now: MissionTime) -> None:
        """An instrument does not answer: asks again later; a sample that it refuses is given up."""
        if not self._instruments.expects(query):
            return
        job = self.job
        if topic == MEASURE and why is NoReply.REFUSED and job is not None and job.hole is not None:
            self._instruments.answered(MEASURE)
            self.reporter.tell(
                EventKind.SAMPLE_SKIPPED, now, detail, revision=job.revision, sample_id=job.hole.sample.sample_id
            )
            self._next_leg(job, now)
            self.proceed(now)
            return
        self._unclear(topic, now, f"{why.value}: {detail}" if detail else why.value)

    def _unclear(self, topic: Topic, now: MissionTime, why: str) -> None:
        first, wait = self._instruments.failed(topic, now)
        if first:
            self.reporter.tell(EventKind.INSTRUMENT_SILENT, now, f"{topic.name}: {why}")
        self.out.append(wait)

    def retry(self, now: MissionTime) -> None:
        """Time to ask the silent instrument again."""
        if self._instruments.waiting:
            self.proceed(now)

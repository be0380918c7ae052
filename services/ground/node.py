"""The ground station as a node: telemetry in, plans and telecommands out, the live map for operators."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from he3.driving import DrivenGround
from he3.errors import He3Error, InvalidInput
from he3.posterior.grid import expect_map_fits
from schemas.authority import AuthorityChange
from schemas.commands import CommandReport, NoParameters, Telecommand
from schemas.ground import InterestChange
from schemas.link import LinkStatus
from schemas.mission_log import AlarmMark
from schemas.plans import MissionPlan, PlanDecision
from schemas.telemetry import RoverEvent, RoverState, SampleReport
from schemas.topics import (
    COMMAND_REPORT,
    DECIDE_PLAN,
    EVENT,
    FORK,
    INTERESTS,
    ISSUE_COMMAND,
    LIST_COMMANDS,
    LIST_INTERESTS,
    PREVIEW_COMMAND,
    SAMPLE,
    SET_ALARM,
    SET_AUTHORITY,
    SET_INTEREST,
    SHOW_AUTHORITY,
    SHOW_LOG,
    SHOW_PLAN,
    STATE,
    Side,
)
from services.ground.authority import CommandAuthority
from services.ground.belief import Belief
from services.ground.budget import Budget
from services.ground.closed_ground import enclosure, within_reach
from services.ground.command_history import CommandHistory
from services.ground.director import REPLAN_TIMER, Director
from services.ground.driving_costs import DrivingCosts
from services.ground.execution import ExecutionMonitor
from services.ground.forking import Forking
from services.ground.goal import MissionGoal
from services.ground.interests import InterestAreas
from services.ground.map.publisher import MapPublisher
from services.ground.map.region_account import region_account
from services.ground.map.service import MAP_TOPICS, answer
from services.ground.operations_log import OperationsLog
from services.ground.plan_review import PlanReviewer
from services.ground.planning import RoundPlanning
from services.ground.previews import CommandPreviews
from services.ground.refits import RefitSchedule
from services.ground.round_log import RoundLog
from services.ground.samples import SampleIntake
from services.ground.scoring import Scorer
from services.ground.silence import SilenceWatch
from services.ground.stall_guard import STALL_QUERY, StallGuard
from services.ground.stall_watch import StallWatch
from services.ground.state_types import STATE_TYPES
from services.ground.status import StatusReporter
from services.ground.telecommands import LOOK_QUERY, LOOK_TIMER, LOST_TIMER, TelecommandHandler
from services.ground.terrain import (
    GroundTerrain,
    interest_area_objection,
    interest_objection,
    interest_weights,
    keep_out_objection,
)
from services.mission.covariates import trend_of
from services.mission.mission_time import MissionTime, seconds
from services.mission.regions import load_region
from services.runtime.node import (
    Cause,
    Computed,
    Effect,
    Event,
    Interface,
    Level,
    LogRecord,
    QueryFailed,
    QueryReceived,
    Received,
    RefuseQuery,
    ReplyReceived,
    Send,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
)

if TYPE_CHECKING:
    from he3.frames import SiteGrid
    from he3.reference import Region
    from schemas.ground import GroundStatus
    from services.ground.map.publisher import MapUse
    from services.ground.map.snapshot import MapSnapshot
    from services.ground.planners.interface import Planner
    from services.mission.scenario import Scenario
    from services.runtime.node import SavedState, Stateful

NAME = "ground"
STATUS_TIMER = "status"


class GroundNode:
    """Gives every event to the part of the ground station that it concerns."""

    def __init__(
        self,
        terrain: GroundTerrain,
        director: Director,
        interests: InterestAreas,
        telecommands: TelecommandHandler,
        previews: CommandPreviews,
        reviewer: PlanReviewer,
        forking: Forking,
        authority: CommandAuthority,
        operations: OperationsLog,
        publisher: MapPublisher,
        goal: MissionGoal,
        status: StatusReporter,
        silence: SilenceWatch,
        stall: StallGuard,
        status_period_s: float,
        note: str = "",
    ) -> None:
        """status_period_s: how often the status is sent when nothing changes [s]. note: a warning at the beginning."""
        self._terrain = terrain
        self._director = director
        self._interests = interests
        self._telecommands = telecommands
        self._previews = previews
        self._reviewer = reviewer
        self._forking = forking
        self._authority = authority
        self._operations = operations
        self._publisher = publisher
        self._goal = goal
        self._status = status
        self._silence = silence
        self._stall = stall
        self._status_period = seconds(status_period_s)
        self._note = note
        self._begun = False
        self._stateful: dict[str, Stateful] = {
            "director": director,
            "telecommands": telecommands,
            "authority": authority,
            "operations": operations,
            "publisher": publisher,
            "status": status,
            "silence": silence,
            "stall": stall,
        }
        """The parts that have a state, apart from the director's own."""

    @property
    def interface(self) -> Interface:
        return Interface(
            name=NAME,
            sides=(Side.EARTH,),
            subscribes=(SAMPLE, EVENT, STATE, COMMAND_REPORT),
            serves=(
                ISSUE_COMMAND,
                PREVIEW_COMMAND,
                LIST_COMMANDS,
                SET_INTEREST,
                LIST_INTERESTS,
                SET_AUTHORITY,
                SHOW_AUTHORITY,
                DECIDE_PLAN,
                SHOW_PLAN,
                FORK,
                SET_ALARM,
                SHOW_LOG,
                *MAP_TOPICS,
            ),
        )

    @property
    def snapshot(self) -> MapSnapshot | None:
        """The present live map."""
        return self._publisher.snapshot

    @property
    def status(self) -> GroundStatus:
        """The status, as operators would receive it now."""
        return self._status.status

    def handle(self, event: Event, now: MissionTime) -> Iterable[Effect]:
        match event:
            case QueryReceived(topic, request, token) if topic in MAP_TOPICS:
                try:
                    shown = self._publisher.present(now, self._director.plan_ends)
                    return [SendReply(token, answer(topic, request, shown))]
                except He3Error as error:
                    return [RefuseQuery(token, str(error))]
            case QueryReceived(topic, _, token) if topic is LIST_COMMANDS:
                return [SendReply(token, self._telecommands.listed())]
            case QueryReceived(topic, Telecommand() as command, token) if topic is PREVIEW_COMMAND:
                return [SendReply(token, self._previews.of(command, self._status.rover, now))]
            case QueryReceived(topic, _, token) if topic is SHOW_LOG:
                return [SendReply(token, self._operations.listed())]
            case QueryReceived(topic, _, token) if topic is FORK and self._director.ended:
                how = self._status.status.phase.value
                return [RefuseQuery(token, f"rehearsal: the mission has ended, {how}: nothing of it lies ahead")]
            case QueryReceived(topic, _, token) if topic is FORK:
                return [SendReply(token, self._forking.fork(self.checkpoint(), self._status.rover, now))]
        effects = list(self._changed_by(event, now))
        effects += self._telecommands.recall(now)
        effects += [
            self._operations.planned(effect.body, now)
            for effect in effects
            if isinstance(effect, Send) and isinstance(effect.body, MissionPlan)
        ]
        effects += [self._operations.goal(text, now) for text in self._goal.news()]
        changed = self._publisher.publish(now, self._director.ended, self._director.plan_ends)
        return [*effects, *changed, *self._status.send(anyway=event == TimerFired(STATUS_TIMER))]

    def _changed_by(self, event: Event, now: MissionTime) -> Iterable[Effect]:
        match event:
            case Started():
                yield from self._start(now)
            case Received():
                yield from self._receive(event, now)
            case Computed(job, result, error):
                self._stall.progress(now)
                yield from self._director.computed(job, result, error, now)
            case QueryReceived(topic, Telecommand() as command, token) if topic is ISSUE_COMMAND:
                self._stall.progress(now)
                yield from self._telecommands.issue(command, token, now)
            case QueryReceived(topic, InterestChange() as change, token) if topic is SET_INTEREST:
                yield from self._set_interest(change, token, now)
            case QueryReceived(topic, NoParameters(), token) if topic is LIST_INTERESTS:
                yield SendReply(token, self._interests.listed())
            case QueryReceived(topic, AuthorityChange() as change, token) if topic is SET_AUTHORITY:
                yield from self._change_authority(change, token, now)
            case QueryReceived(topic, _, token) if topic is SHOW_AUTHORITY:
                yield SendReply(token, self._authority.state)
            case QueryReceived(topic, PlanDecision() as decision, token) if topic is DECIDE_PLAN:
                self._stall.progress(now)
                yield from self._decide(decision, token, now)
            case QueryReceived(topic, AlarmMark() as mark, token) if topic is SET_ALARM:
                yield from self._operations.mark(mark, token, now)
            case QueryReceived(topic, _, token) if topic is SHOW_PLAN:
                yield SendReply(token, self._reviewer.shown())
            case TimerFired(timer) if timer == STATUS_TIMER:
                yield SetTimer(STATUS_TIMER, now + self._status_period)
                yield from self._silence.check(now)
                yield from self._stall.tick(now)
            case TimerFired(timer) if timer == REPLAN_TIMER:
                yield from self._director.go_on(now)
            case TimerFired(timer) if timer == LOOK_TIMER:
                yield from self._telecommands.look()
            case TimerFired(timer) if timer.startswith(LOST_TIMER):
                yield from self._telecommands.overdue(timer.removeprefix(LOST_TIMER), now)
            case ReplyReceived(_, query, LinkStatus() as link) if query == LOOK_QUERY:
                yield from self._telecommands.seen_on_link(link, now)
            case QueryFailed(_, query) if query == LOOK_QUERY:
                yield from self._telecommands.look_failed(now)
            case ReplyReceived(_, query, LinkStatus() as link) if query == STALL_QUERY:
                yield from self._stall.link_answered(link, now)
            case QueryFailed(_, query) if query == STALL_QUERY:
                yield from self._stall.link_answered(None, now)
            case _:
                yield _nothing_to_do(event)

    def _start(self, now: MissionTime) -> Iterable[Effect]:
        self._telecommands.restarted()
        yield SetTimer(STATUS_TIMER, now + self._status_period)
        if not self._begun:
            self._begun = True
            if self._note:
                yield LogRecord(Level.WARNING, self._note)
            if (listed := self._interests.listed()).areas:
                yield Send(INTERESTS, listed)
            yield from self._director.go_on(now)

    def _receive(self, event: Received, now: MissionTime) -> Iterable[Effect]:
        match event.body:
            case SampleReport() as report:
                self._heard(now)
                yield from self._director.sample(report, now)
            case RoverEvent() as happened:
                self._heard(now)
                self._operations.happened(happened, now)
                yield from self._director.event(happened, now)
            case RoverState() as state:
                yield from self._locate(state, event.header.made_at, now)
            case CommandReport() as report:
                self._heard(now)
                yield from self._telecommands.reported(report, now)
            case _:
                yield _nothing_to_do(event)

    def _heard(self, now: MissionTime) -> None:
        """Handle a message from the rover."""
        self._silence.heard(now)
        self._stall.progress(now)

    def _locate(self, state: RoverState, made_at: MissionTime, now: MissionTime) -> Iterable[Effect]:
        newer = self._status.is_newer(made_at)
        if newer:  # one that comes again, or late, does not show that the rover is still there
            self._silence.heard(now)
        if not self._terrain.grid.has((state.x_m, state.y_m)):
            text = f"state: expected a place in the region, got ({state.x_m:g}, {state.y_m:g})"
            return [LogRecord(Level.WARNING, text, cause=Cause(f"{STATE.name}: outside the region", "rover"))]
        self._status.heard(state, made_at)
        self._operations.reported(state, made_at, now)
        if newer:
            self._stall.state(state, self._telecommands.holds_rover, now)
        return self._director.state(state, made_at, now)

    def _set_interest(self, change: InterestChange, token: int, now: MissionTime) -> Iterable[Effect]:
        why = self._interests.objection(change, self._terrain.traversable)
        if why is not None:
            yield RefuseQuery(token, why)
            return
        self._stall.progress(now)
        before = self._interests.listed()
        effects = self._director.set_interest(change, now)
        listed = self._interests.listed()
        yield SendReply(token, listed)
        if listed != before:
            yield Send(INTERESTS, listed)
            yield self._operations.interest(change, now)
        yield from effects

    def _change_authority(self, change: AuthorityChange, token: int, now: MissionTime) -> Iterable[Effect]:
        before = self._authority.state
        yield from self._authority.answer(change, token, now)
        if self._authority.state != before:
            yield self._operations.authority(change, now)

    def _decide(self, decision: PlanDecision, token: int, now: MissionTime) -> Iterable[Effect]:
        effects = list(self._reviewer.decide(decision, token, now))
        if not any(isinstance(effect, RefuseQuery) for effect in effects):
            yield self._operations.decision(decision, now)
        yield from effects

    # --- checkpoints ------------------------------------------------------------------------------------------------

    @property
    def state_types(self) -> tuple[type, ...]:
        """The types in the state, beside plain values."""
        return STATE_TYPES

    @property
    def functions(self) -> dict[str, Callable[..., Any]]:
        """The functions that are computed elsewhere, by name."""
        return self._director.functions

    def checkpoint(self) -> SavedState:
        """The state of each part by its name, and the node's own."""
        return {**{name: part.checkpoint() for name, part in self._stateful.items()}, "begun": self._begun}

    def restore(self, state: SavedState) -> None:
        """Restore the ground station from this state."""
        for name, part in self._stateful.items():
            part.restore(state[name])
        self._begun = state["begun"]


def _nothing_to_do(event: Event) -> LogRecord:
    return LogRecord(Level.WARNING, f"ground: nothing to do upon {type(event).__name__}")


def build_node(
    scenario: Scenario,
    region: Region | None = None,
    planner: Planner | None = None,
    make_belief: Callable[..., Belief] = Belief,
    map_use: MapUse = "always",
) -> GroundNode:
    """The ground station of that scenario; region and planner are read and chosen from it unless they are given.

    make_belief: makes the belief, from the arguments of `Belief`. map_use: for what the map is computed.

    Belief and director receive only what is known from orbit; the reference field goes to the scorer alone.
    Raises InvalidInput for a scenario that does not fit its region.
    """
    if region is None:
        region = load_region(scenario.region, scenario.field.field_seed)
    grid, ground = region.grid, scenario.ground
    _check_places(scenario, grid)
    terrain = terrain_of(scenario, region)
    trend = trend_of(scenario, region)
    expect_map_fits(grid, ground.kernel, scenario.samples)
    likeliest = ground.hyperparameters == "ml"
    noise = scenario.field.noise_std_ppb
    belief = make_belief(grid, ground.kernel, noise, trend, likeliest=likeliest, followed=map_use == "always")
    interests = InterestAreas(grid, ground.interests)
    round_log = RoundLog()
    samples = SampleIntake(belief, round_log)
    # A goal is certified by the alternatives, so they are to know every sample.
    refits = RefitSchedule(belief, round_log, scenario.seed, scenario.samples if ground.goal is None else 0)
    driven_ground = DrivenGround(grid, region.slope_deg, region.elevation_m, scenario.rover.driving)
    costs = DrivingCosts(ground.cost, driven_ground, terrain.traversable)
    goal = MissionGoal(scenario, grid, belief)
    planning = RoundPlanning(
        scenario, grid, belief, terrain, round_log, interests, planner, costs.terrain, goal.for_planners
    )
    mean_slope = float(region.slope_deg[terrain.traversable].mean())
    open_area = float(terrain.traversable.sum()) * grid.resolution_m**2
    budget = Budget(scenario, open_area, mean_slope, costs.unit, costs.level_metres_a_metre)
    execution = ExecutionMonitor(terrain, round_log, samples, scenario.start_m)
    director = Director(
        scenario, belief, terrain, round_log, execution, refits, planning, budget, costs, interests, goal
    )
    scorer = None
    if ground.score:
        scorer = Scorer(region.he3_ppb, region.known, within_reach(terrain, scenario.start_m))
    lat, lon = region.origin_lat_deg, region.origin_lon_deg
    origin = None if lat is None or lon is None else (lat, lon)
    publisher = MapPublisher(
        belief,
        terrain,
        samples,
        round_log,
        refits,
        interests,
        scorer,
        origin,
        scenario.start_ns,
        region_account(scenario, region),
        map_use,
    )
    silence = SilenceWatch(ground.rover_timeout_s)
    round_trip_s = scenario.link.up.one_way_light_time_s + scenario.link.down.one_way_light_time_s
    authority = CommandAuthority()
    history = CommandHistory(grid, round_trip_s)
    note = "; ".join(filter(None, (enclosure(terrain, scenario.start_m), goal.note)))
    return GroundNode(
        terrain=terrain,
        director=director,
        interests=interests,
        telecommands=TelecommandHandler(scenario, NAME, history, director, authority),
        previews=CommandPreviews(history, terrain, round_log, execution, budget, costs),
        reviewer=PlanReviewer(planning, budget, costs, director, authority, goal),
        forking=Forking(scenario, terrain, round_log, execution, planning, STATE_TYPES),
        authority=authority,
        operations=OperationsLog(round_log, budget, scenario.link.up.one_way_light_time_s),
        publisher=publisher,
        goal=goal,
        status=StatusReporter(scenario, belief, director, publisher, silence, note, costs.unit, goal),
        silence=silence,
        stall=StallGuard(StallWatch(scenario), director, silence),
        status_period_s=ground.status_period_s,
        note=note,
    )


def terrain_of(scenario: Scenario, region: Region) -> GroundTerrain:
    """The region's terrain less keep-outs and what is too steep; raises InvalidInput unless there is open ground."""
    ground = scenario.ground
    open_cells = region.traversable & (region.slope_deg <= slope_limit_deg(scenario))
    terrain = GroundTerrain(region.grid, open_cells, scenario.rover.footprint_radius_m, ground.keep_outs)
    if not terrain.traversable.any():
        raise InvalidInput(f"scenario '{scenario.name}': expected open ground, got none: every cell is closed")
    weights = interest_weights(region.grid, [(area.polygon_m, area.weight) for area in ground.interest])
    if (why := interest_objection(weights, terrain.traversable)) is not None:
        raise InvalidInput(f"scenario '{scenario.name}': ground.interest: {why}")
    return terrain


def slope_limit_deg(scenario: Scenario) -> float:
    """The steepest slope [deg] that planners use, which the rover enters."""
    limit, ours = scenario.rover.slope_limit_deg, scenario.ground.max_slope_deg
    return limit if ours is None else min(limit, ours)


def _check_places(scenario: Scenario, grid: SiteGrid) -> None:
    """Raises InvalidInput, in one line that names the key, for a start or an area that is not on this site."""
    ground = scenario.ground
    if not grid.contains(np.array([scenario.start_m]))[0]:
        raise InvalidInput(
            f"scenario '{scenario.name}': start_m: expected a place within 0..{grid.width_m:g} m east and "
            f"0..{grid.height_m:g} m north, got ({scenario.start_m[0]:g}, {scenario.start_m[1]:g})"
        )
    keep_outs = {f"keep_outs_m.{i}": keep_out_objection(grid, each) for i, each in enumerate(ground.keep_outs_m)}
    interests = {
        f"interest.{i}": interest_area_objection(grid, each.polygon_m) for i, each in enumerate(ground.interest)
    }
    objections = keep_outs | interests
    for key, why in objections.items():
        if why is not None:
            raise InvalidInput(f"scenario '{scenario.name}': ground.{key}: {why}")

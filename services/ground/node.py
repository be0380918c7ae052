"""The ground station as a node: telemetry in, plans and telecommands out, the live map for whoever asks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from he3.errors import He3Error, InvalidInput
from he3.frames import SiteGrid
from he3.reference import Region
from he3.trend import OrbitalTrend
from schemas.commands import ENDS, CommandKind, CommandList, CommandReport, CommandStage, CommandStatus, Telecommand
from schemas.ground import (
    GroundStatus,
    InterestArea,
    InterestChange,
    InterestList,
    KernelParameters,
    MissionPhase,
)
from schemas.link import LinkChange, LinkStatus
from schemas.maps import MapScore
from schemas.telemetry import RoverEvent, RoverState, SampleReport
from schemas.topics import (
    COMMAND,
    COMMAND_REPORT,
    COMMAND_STATUS,
    EVENT,
    GROUND_STATUS,
    ISSUE_COMMAND,
    LINK_SET,
    LIST_COMMANDS,
    SAMPLE,
    SET_INTEREST,
    STATE,
    Side,
)
from schemas.wire import Header
from services.ground.belief import Belief
from services.ground.budget import Budget
from services.ground.director import REPLAN_TIMER, Director
from services.ground.map.service import MAP_TOPICS, answer
from services.ground.map.snapshot import MapSnapshot
from services.ground.planners.interface import Planner
from services.ground.scoring import Scorer
from services.ground.telecommands import LOOK_AGAIN_S, CommandBook
from services.ground.terrain import GroundTerrain, closes_nothing, holds_nothing, interest_weights, worth_nothing
from services.mission.regions import load_region
from services.mission.scenario import Scenario
from services.runtime.node import (
    SECOND,
    Computed,
    Effect,
    Event,
    Interface,
    Level,
    LogRecord,
    MissionTime,
    PublishSnapshot,
    QueryFailed,
    QueryReceived,
    Received,
    RefuseQuery,
    ReplyReceived,
    Send,
    SendQuery,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
    seconds,
)

STATUS_TIMER = "status"
LOOK, LOOK_TIMER = "commands-on-the-link", "look"
LOST_TIMER = "lost:"
MAX_INTERESTS = 100
_AWAY = frozenset({CommandKind.GO_TO, CommandKind.RETURN_TO_START})


class GroundNode:
    """Belief, director, commands and live map, wired to the topics."""

    def __init__(
        self,
        scenario: Scenario,
        director: Director,
        scorer: Scorer | None = None,
        origin_deg: tuple[float, float] | None = None,
    ) -> None:
        """origin_deg: latitude and longitude of the site's south-west corner, where they are known."""
        self._origin_deg = origin_deg
        self._scenario = scenario
        self._director = director
        self._scorer = scorer
        light = scenario.link.up.one_way_light_time_s + scenario.link.down.one_way_light_time_s
        self._commands = CommandBook(director.grid, light)
        self._keep_outs = scenario.ground.keep_outs
        self._samples: list[SampleReport] = []
        self._rover: RoverState | None = None
        self._rover_made_at: MissionTime | None = None
        self._heard_at: MissionTime | None = None
        self._silent = False
        self._begun = False
        self._shown_at_the_end = False
        self._map: tuple[object, object] | None = None
        self._revision = 0
        self._map_time: MissionTime = scenario.start_ns
        self._mean_std_ppb = 0.0
        self._score: MapScore | None = None
        self._history: tuple[MapScore, ...] = ()
        self._fitted = 0
        self._snapshot: MapSnapshot | None = None
        self._published: GroundStatus | None = None

    @property
    def interface(self) -> Interface:
        return Interface(
            name="ground",
            sides=(Side.EARTH,),
            subscribes=(SAMPLE, EVENT, STATE, COMMAND_REPORT),
            serves=(ISSUE_COMMAND, LIST_COMMANDS, SET_INTEREST, *MAP_TOPICS),
        )

    @property
    def snapshot(self) -> MapSnapshot | None:
        """The live map as it is now."""
        return self._snapshot

    def handle(self, event: Event, now: MissionTime) -> Iterable[Effect]:
        match event:
            case QueryReceived(topic, request, token) if topic in MAP_TOPICS:
                try:
                    return [SendReply(token, answer(topic, request, self._snapshot))]
                except He3Error as error:
                    return [RefuseQuery(token, str(error))]
            case QueryReceived(topic, _, token) if topic is LIST_COMMANDS:
                return [SendReply(token, CommandList(commands=self._commands.listed()))]
        effects = list(self._changed_by(event, now))
        return [*effects, *self._shown(now), *self._told(now, anyway=event == TimerFired(STATUS_TIMER))]

    def _changed_by(self, event: Event, now: MissionTime) -> Iterable[Effect]:
        match event:
            case Started():
                self._commands.restarted()
                yield SetTimer(STATUS_TIMER, now + seconds(self._scenario.ground.status_period_s))
                if not self._begun:
                    self._begun = True
                    yield from self._director.begin(now)
            case Received(_, header, SampleReport() as report):
                self._hear(now)
                yield from self._take(report, now)
            case Received(_, header, RoverEvent() as happened):
                self._hear(now)
                yield from self._director.event(happened, now)
            case Received(_, header, RoverState() as state):
                self._hear(now)
                yield from self._locate(state, header, now)
            case Received(_, _, CommandReport() as report):
                self._hear(now)
                yield from self._command_passed(report, now)
            case Computed(job, result, error):
                yield from self._director.computed(job, result, error, now)
            case QueryReceived(topic, Telecommand() as command, token) if topic is ISSUE_COMMAND:
                yield from self._issue(command, token, now)
            case QueryReceived(topic, InterestChange() as change, token) if topic is SET_INTEREST:
                yield from self._set_interest(change, token, now)
            case TimerFired(timer) if timer == STATUS_TIMER:
                yield SetTimer(STATUS_TIMER, now + seconds(self._scenario.ground.status_period_s))
                yield from self._listen_for_silence(now)
            case TimerFired(timer) if timer == REPLAN_TIMER:
                yield from self._director.begin(now)
            case TimerFired(timer) if timer == LOOK_TIMER:
                yield from self._look_for_commands()
            case ReplyReceived(_, query, LinkStatus() as link) if query == LOOK:
                left, again = self._commands.seen_on_link(link, self.interface.name, now)
                for departed in left:
                    yield from self._publish(departed)
                if self._commands.leaving():
                    yield SetTimer(LOOK_TIMER, again)
            case QueryFailed(_, query) if query == LOOK:
                yield SetTimer(LOOK_TIMER, now + seconds(LOOK_AGAIN_S))
            case TimerFired(timer) if timer.startswith(LOST_TIMER):
                status = self._commands.give_up(timer.removeprefix(LOST_TIMER), now)
                yield from self._publish(status)
            case _:
                yield LogRecord(Level.WARNING, f"ground: nothing to do upon {type(event).__name__}")

    # --- telemetry --------------------------------------------------------------------------------------------------

    def _hear(self, now: MissionTime) -> None:
        self._heard_at = now
        self._silent = False

    def _take(self, report: SampleReport, now: MissionTime) -> Iterable[Effect]:
        before = len(self._director.belief)
        effects = self._director.sample(report, now)
        if len(self._director.belief) > before:
            self._samples.append(report)
        return effects

    def _locate(self, state: RoverState, header: Header, now: MissionTime) -> Iterable[Effect]:
        if not self._director.grid.contains(np.array([(state.x_m, state.y_m)]))[0]:
            return [
                LogRecord(Level.WARNING, f"state: expected a place in the region, got ({state.x_m:g}, {state.y_m:g})")
            ]
        if self._rover_made_at is None or header.made_at >= self._rover_made_at:
            self._rover, self._rover_made_at = state, header.made_at
        return self._director.state(state, header.made_at, now)

    def _listen_for_silence(self, now: MissionTime) -> Iterable[Effect]:
        timeout = seconds(self._scenario.ground.rover_timeout_s)
        if self._heard_at is not None and now - self._heard_at > timeout and not self._silent:
            self._silent = True
            yield LogRecord(Level.WARNING, f"nothing heard of the rover for {(now - self._heard_at) / SECOND:.0f} s")

    # --- commands ---------------------------------------------------------------------------------------------------

    def _issue(self, command: Telecommand, token: int, now: MissionTime) -> Iterable[Effect]:
        try:
            status, new = self._commands.issue(command, now)
        except InvalidInput as error:
            yield RefuseQuery(token, str(error))
            return
        yield SendReply(token, status)
        if not new:
            return
        yield Send(COMMAND, command)
        yield from self._look_for_commands()
        overdue = self._commands.overdue_at(command)
        if overdue is not None:
            yield SetTimer(LOST_TIMER + command.command_id, overdue)
        yield from self._publish(status)
        yield from self._keep_out(command, now)

    def _set_interest(self, change: InterestChange, token: int, now: MissionTime) -> Iterable[Effect]:
        director = self._director
        if change.polygon_m is not None and not director.grid.contains(np.array(change.polygon_m)).all():
            yield RefuseQuery(
                token,
                f"interest: expected corners within 0..{director.grid.width_m:g} m east and "
                f"0..{director.grid.height_m:g} m north, got one outside",
            )
            return
        if change.polygon_m is not None and (why := holds_nothing(director.grid, change.polygon_m)) is not None:
            yield RefuseQuery(token, f"interest: polygon_m: {why}")
            return
        effects: list[Effect] = []
        if change.area_id is not None:
            if change.area_id not in director.interests and len(director.interests) >= MAX_INTERESTS:
                yield RefuseQuery(token, f"interest: expected at most {MAX_INTERESTS} areas, got one more")
                return
            changed = dict(director.interests)
            if change.polygon_m is None:
                changed.pop(change.area_id, None)
            else:
                changed[change.area_id] = (change.polygon_m, change.weight)
            weights = interest_weights(director.grid, list(changed.values()))
            if (why := worth_nothing(weights, director.terrain.traversable)) is not None:
                yield RefuseQuery(token, f"interest: weight: {why}")
                return
            effects = director.set_interest(change.area_id, change.polygon_m, change.weight, now)
        areas = (
            InterestArea(area_id=name, polygon_m=tuple(polygon), weight=weight)
            for name, (polygon, weight) in director.interests.items()
        )
        yield SendReply(token, InterestList(areas=tuple(areas)))
        yield from effects

    def _keep_out(self, command: Telecommand, now: MissionTime) -> Iterable[Effect]:
        """Closes at once what the command closes; what it opens is open when the rover has carried it out."""
        if command.kind is CommandKind.SET_KEEP_OUT and command.area_id is not None:
            at_first = self._keep_outs.get(command.area_id)
            polygons = self._commands.closed_by(command.area_id, () if at_first is None else (at_first,))
            yield from self._director.keep_out(command.area_id, polygons, now)

    def _command_passed(self, report: CommandReport, now: MissionTime) -> Iterable[Effect]:
        status = self._commands.report(report)
        if status is None:
            return
        yield from self._publish(status)
        if report.stage is CommandStage.RECEIVED and all(
            passed.stage is not CommandStage.RADIATED for passed in status.stages
        ):
            yield SendQuery(LINK_SET, LinkChange(), LOOK)  # it left between two looks
        command = status.command
        if report.stage in ENDS:
            yield from self._keep_out(command, now)
        if command.kind not in _AWAY:
            return
        if report.stage is CommandStage.STARTED and status.end is None:
            self._director.moving(command.command_id)
        elif report.stage is CommandStage.COMPLETED:
            target = command.target_m if command.target_m is not None else self._scenario.start_m
            self._director.moving(command.command_id)
            yield from self._director.moved(command.command_id, target, now)
        elif report.stage in ENDS:
            yield from self._director.moved(command.command_id, self._director.place_m, now)

    def _look_for_commands(self) -> Iterable[Effect]:
        """Ask the link whether the commands that went out have left the Earth; with no link nobody answers."""
        if self._commands.leaving():
            yield SendQuery(LINK_SET, LinkChange(), LOOK)

    def _publish(self, status: CommandStatus | None) -> Iterable[Effect]:
        if status is not None:
            yield Send(COMMAND_STATUS, status)

    # --- what operators see -----------------------------------------------------------------------------------------

    def _shown(self, now: MissionTime) -> Iterable[Effect]:
        """A new snapshot if map, track or plan have changed."""
        director = self._director
        current = director.belief.map
        traversable = director.terrain.traversable
        if self._map is None or self._map[0] is not current or self._map[1] is not traversable:
            self._map = (current, traversable)
            self._revision += 1
            self._map_time = now
            self._mean_std_ppb = float(current.std_ppb.mean(dtype=np.float64))
            if self._scorer is not None:
                self._score = self._scorer.score(
                    current.mean_ppb, current.std_ppb, self._revision, len(self._samples), now
                )
                if director.fitted > self._fitted:
                    self._history = (*self._history, self._score)
            self._fitted = director.fitted
        driven, planned = director.round_log.paths()
        before = self._snapshot
        if (
            before is not None
            and before.revision == self._revision
            and before.driven_path_m is driven
            and before.planned_path_m is planned
        ):
            if director.ended is not None and not self._shown_at_the_end:
                self._shown_at_the_end = True
                yield PublishSnapshot(before, awaited=True)
            return
        self._snapshot = MapSnapshot(
            grid=director.grid,
            mean_ppb=current.mean_ppb,
            std_ppb=current.std_ppb,
            traversable=traversable,
            samples=tuple(self._samples),
            driven_path_m=driven,
            planned_path_m=planned,
            plan_ends=director.plan_ends(now),
            revision=self._revision,
            mission_time_ns=self._map_time,
            score=self._score,
            score_history=self._history,
            process=director.belief.process,
            origin_deg=self._origin_deg,
        )
        # Reports are made from answers that are asked for as soon as the mission is said to be over.
        self._shown_at_the_end = director.ended is not None
        yield PublishSnapshot(self._snapshot, awaited=self._shown_at_the_end)

    def _told(self, now: MissionTime, anyway: bool) -> Iterable[Effect]:
        """The status, if it has changed or its time has come."""
        status = self._status(now)
        if anyway or status != self._published:
            self._published = status
            yield Send(GROUND_STATUS, status)

    def _status(self, now: MissionTime) -> GroundStatus:
        director = self._director
        hyperparameters = director.belief.hyperparameters
        return GroundStatus(
            phase=self._phase(),
            planner=self._scenario.ground.planner,
            round=director.round_log.completed,
            rounds=self._scenario.rounds,
            samples=len(director.belief),
            samples_total=self._scenario.samples,
            driven_m=director.driven_m,
            budget_m=self._scenario.ground.budget_m,
            plan_revision=director.revision,
            plans_in_work=int(director.in_work is not None),
            map_revision=self._revision,
            mean_std_ppb=self._mean_std_ppb,
            kernel=KernelParameters(
                name=hyperparameters.kernel.name,
                parameters=hyperparameters.kernel.parameters(),
                noise_std_ppb=hyperparameters.noise_std_ppb,
                mean_ppb=hyperparameters.mean_ppb,
                scale_ppb=hyperparameters.scale_ppb,
            ),
            score=self._score,
            rover=self._rover,
            rover_made_at=self._rover_made_at,
            detail=self._detail()[:500],
        )

    def _phase(self) -> MissionPhase:
        director = self._director
        if director.ended is not None:
            return MissionPhase.COMPLETED if director.ended.ok else MissionPhase.FAILED
        if self._heard_at is None:
            return MissionPhase.WAITING
        return MissionPhase.EXECUTING if director.round_log.open_rounds else MissionPhase.PLANNING

    def _detail(self) -> str:
        if self._silent and self._director.ended is None:
            return f"the rover is silent; {self._director.detail}" if self._director.detail else "the rover is silent"
        return self._director.detail


def build_node(scenario: Scenario, region: Region | None = None, planner: Planner | None = None) -> GroundNode:
    """The ground station of that scenario; region and planner are read and chosen from it unless they are given.

    Of the region, belief and director are given what is known from orbit; the reference field goes to the scorer alone.
    """
    if region is None:
        region = load_region(scenario.region, scenario.field.field_seed)
    ground = scenario.ground
    if not region.grid.contains(np.array([scenario.start_m]))[0]:
        raise InvalidInput(
            f"scenario '{scenario.name}': start_m: expected a place within 0..{region.grid.width_m:g} m east and "
            f"0..{region.grid.height_m:g} m north, got ({scenario.start_m[0]:g}, {scenario.start_m[1]:g})"
        )
    _check_areas(scenario, region.grid)
    steepest = scenario.rover.slope_limit_deg
    if ground.max_slope_deg is not None:
        steepest = min(steepest, ground.max_slope_deg)
    open_cells = region.traversable & (region.slope_deg <= steepest)
    terrain = GroundTerrain(region.grid, open_cells, scenario.rover.footprint_radius_m, ground.keep_outs)
    trend = OrbitalTrend(region.grid, region.orbital_ppb) if ground.prior == "orbital" else None
    belief = Belief(region.grid, ground.kernel, scenario.field.noise_std_ppb, trend)
    if not terrain.traversable.any():
        raise InvalidInput(f"scenario '{scenario.name}': expected open ground, got none: every cell is closed")
    weights = interest_weights(region.grid, [(area.polygon_m, area.weight) for area in ground.interest])
    if (why := worth_nothing(weights, terrain.traversable)) is not None:
        raise InvalidInput(f"scenario '{scenario.name}': ground.interest: {why}")
    mean_slope = float(region.slope_deg[terrain.traversable].mean())
    open_area = float(terrain.traversable.sum()) * region.grid.resolution_m**2
    director = Director(scenario, region.grid, belief, terrain, Budget(scenario, open_area, mean_slope), planner)
    lat, lon = region.origin_lat_deg, region.origin_lon_deg
    origin = None if lat is None or lon is None else (lat, lon)
    return GroundNode(scenario, director, Scorer(region.he3_ppb) if ground.score else None, origin)


def _check_areas(scenario: Scenario, grid: SiteGrid) -> None:
    """Raises InvalidInput, in one line that names the key, for an area that would have no effect on this site."""
    ground = scenario.ground
    objections = {
        f"keep_outs_m.{index}": closes_nothing(grid, polygon) for index, polygon in enumerate(ground.keep_outs_m)
    } | {f"interest.{index}": holds_nothing(grid, area.polygon_m) for index, area in enumerate(ground.interest)}
    for key, why in objections.items():
        if why is not None:
            raise InvalidInput(f"scenario '{scenario.name}': ground.{key}: {why}")

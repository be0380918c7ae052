"""A rover that executes every plan at once, and the ground station's mission with it, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from he3.errors import NoRoute
from he3.frames import SiteGrid
from he3.reference import Region
from schemas.codec import decode, encode
from schemas.commands import CommandKind, CommandStatus, NoParameters, Telecommand
from schemas.ground import GroundStatus
from schemas.plans import MissionPlan, PlannedSample, RoundPlan
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState, SampleReport
from schemas.topics import (
    COMMAND,
    EVENT,
    GROUND_STATUS,
    LIST_COMMANDS,
    PLAN,
    SAMPLE,
    Side,
    Topic,
)
from schemas.wire import Header, Wire
from services.ground.map.snapshot import MapSnapshot
from services.ground.node import GroundNode, build_node
from services.ground.planners.interface import PlannedRound, Planner, PlanningRequest
from services.ground.planners.traversability import OpenGround
from services.mission.mission_time import SECOND, seconds
from services.mission.scenario import Scenario
from services.runtime.drivers.simulation import Simulation
from services.runtime.node import (
    Effect,
    Event,
    Finish,
    Interface,
    Level,
    Received,
    Send,
    SetTimer,
    TimerFired,
)

GRID = SiteGrid(60, 60)
START = (5.0, 5.0)
IN_DEGREES = ((-30.76, 20.19), (-30.72, 20.19), (-30.72, 20.21))
IN_ONE_LINE = ((10.0, 10.0), (20.0, 20.0), (40.0, 40.0))
SPECK = ((10.1, 10.1), (10.3, 10.1), (10.3, 10.3))
ELSEWHERE = (
    r"expected an area of the site, which is 0\.\.60 m east and 0\.\.60 m north, "
    r"got one at -30\.76\.\.-30\.72 m east and 20\.19\.\.20\.21 m north"
)
GOOD_AREA = ((10.0, 10.0), (20.0, 10.0), (20.0, 20.0))


def region(closed: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None) -> Region:
    field = smooth_field()
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    open_cells = np.ones(GRID.shape, dtype=np.bool_) if closed is None else ~closed(x, y)
    return Region(
        name="test",
        title="a test",
        provenance="made for tests",
        grid=GRID,
        he3_ppb=field,
        orbital_ppb=np.full(GRID.shape, float(field.mean())),
        elevation_m=np.zeros(GRID.shape),
        slope_deg=np.zeros(GRID.shape),
        traversable=open_cells,
    )


def smooth_field() -> np.ndarray:
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    return 8.0 + 2.0 * np.sin(x / 9.0) * np.cos(y / 11.0) + 0.02 * x


def scenario(**changes: dict[str, object]) -> Scenario:
    base = Scenario(name="test", region="unused.npz", rounds=4, samples_per_round=3, start_m=START, seed=11)
    return base.changed(**changes) if changes else base


def straight(request: PlanningRequest) -> PlannedRound:
    """A planner: places at random in the open, straight from one to the next over open ground."""
    rng = np.random.default_rng(request.seed)
    ground = OpenGround(request.grid, request.traversable)
    cells = np.argwhere(request.traversable)
    for _ in range(1000):
        chosen = cells[rng.choice(len(cells), size=request.samples, replace=False)]
        places = (chosen[:, ::-1] + 0.5) * request.grid.resolution_m
        path = np.vstack((np.array([request.start_m]), places))
        if ground.segments_free(np.vstack((ground.footing(request.start_m), places[:-1])), places).all():
            break
    if float(np.hypot(*np.diff(path, axis=0).T).sum()) > request.budget_m:
        raise NoRoute(f"the budget of {request.budget_m:g} m does not reach")
    return PlannedRound(path, places, 1.0)


class Rover:
    """Executes every round that it is given, in order: an hour a round, half a light time away."""

    def __init__(self, field: np.ndarray, light_s: float = 1.0, round_s: float = 3600.0) -> None:
        self.interface = Interface("rover", (Side.EARTH,), subscribes=(PLAN, COMMAND))
        self.plans: list[tuple[int, MissionPlan]] = []
        self.commands: list[Telecommand] = []
        self.begun = 0
        self.on_board: list[RoundPlan] = []
        self.place = START
        self.driven = 0.0
        self.executing: RoundPlan | None = None
        self.revision = 0
        self.trouble: Callable[[RoundPlan], str | None] = lambda planned: None
        self.reject: Callable[[MissionPlan], str | None] = lambda plan: None
        self.obstacle_ahead_m = 3.0
        self.shuffle = False
        self.twice = False
        self.skip: set[str] = set()
        self.idle_s = 0.0
        self.idle_since: int | None = None
        self._field = field
        self._light_s = light_s
        self._round_s = round_s
        self._last = 0
        self._queue: list[tuple[int, Send]] = []
        self._arriving: list[tuple[int, Received]] = []

    def handle(self, event: Event, now: int) -> Iterable[Effect]:
        match event:
            case Received(_, _, Telecommand() as command):
                self.commands.append(command)
            case Received(_, _, MissionPlan()):
                self._arriving.append((now + seconds(self._light_s), event))
            case TimerFired("round"):
                yield from self._round_over(now)
        for due, message in [entry for entry in self._arriving if entry[0] <= now]:
            self._arriving.remove((due, message))
            yield from self._told(message.body, now)
        yield from self._downlinked(now)
        times = [at for at, _ in self._queue] + [at for at, _ in self._arriving]
        yield SetTimer("wake", min(times) if times else None)

    def _downlinked(self, now: int) -> Iterable[Effect]:
        due = [entry for entry in self._queue if entry[0] <= now]
        self._queue = [entry for entry in self._queue if entry[0] > now]
        if self.shuffle:
            due.reverse()
        for _, send in due:
            yield send
            if self.twice:
                yield send

    def _down(self, send: Send, now: int) -> None:
        self._queue.append((now + seconds(self._light_s), send))

    def _say(self, kind: EventKind, now: int, **more: object) -> None:
        fields: dict[str, object] = {
            "kind": kind, "at": now, "x_m": self.place[0], "y_m": self.place[1], "driven_m": self.driven,
            "plan_revision": self.revision, "round": self.begun,
        }  # fmt: skip
        self._down(Send(EVENT, RoverEvent(**{**fields, **more})), now)

    def _told(self, body: object, now: int) -> Iterable[Effect]:
        if not isinstance(body, MissionPlan):
            return []
        self.plans.append((now, body))
        why = self.reject(body)
        if why is None and body.revision <= self.revision:
            why = "stale"
        rounds = [planned for planned in body.rounds if planned.round > self.begun]
        end = self.executing.path_m[-1] if self.executing else self.place
        if why is None and not rounds:
            why = "all have begun"
        if why is None and np.hypot(rounds[0].path_m[0][0] - end[0], rounds[0].path_m[0][1] - end[1]) > 2.0:
            why = "it begins elsewhere"
        if why is not None:
            self._say(EventKind.PLAN_REJECTED, now, plan_revision=body.revision, detail=why)
            return []
        self.revision, self.on_board = body.revision, rounds
        self._last = rounds[-1].round if body.last else 0
        self._say(EventKind.PLAN_ACCEPTED, now)
        return self._next(now) if self.executing is None else []

    def _next(self, now: int) -> Iterable[Effect]:
        if not self.on_board:
            self.idle_since = now
            return []
        if self.idle_since is not None:
            self.idle_s += (now - self.idle_since) / SECOND
            self.idle_since = None
        self.executing = self.on_board.pop(0)
        self.begun = self.executing.round
        self._say(EventKind.ROUND_STARTED, now)
        return [SetTimer("round", now + seconds(self._round_s))]

    def _round_over(self, now: int) -> Iterable[Effect]:
        planned = self.executing
        assert planned is not None
        self.executing = None
        trouble = self.trouble(planned)
        done = planned.samples[:1] if trouble else planned.samples
        taken = [sample for sample in done if sample.sample_id not in self.skip]
        for sample in done:
            if sample.sample_id in self.skip:
                self._say(EventKind.SAMPLE_SKIPPED, now, sample_id=sample.sample_id, detail="no answer")
                continue
            self._measured(planned, sample, now)
        ids = tuple(sample.sample_id for sample in taken)
        if trouble:
            self.on_board = []
            ahead = (self.place[0] + self.obstacle_ahead_m, self.place[1])
            self._say(EventKind.BLOCKED, now, detail=trouble, obstacle_m=ahead, samples_done=ids)
            self._say(EventKind.ROUND_ABORTED, now, detail=trouble, samples_done=ids)
            return []
        self.place = planned.path_m[-1]
        self._say(EventKind.ROUND_COMPLETED, now, samples_done=ids)
        if planned.round == self._last:
            self._say(EventKind.MISSION_COMPLETED, now)
        return self._next(now)

    def _measured(self, planned: RoundPlan, sample: PlannedSample, now: int) -> None:
        self.driven += float(np.hypot(sample.x_m - self.place[0], sample.y_m - self.place[1]))
        self.place = (sample.x_m, sample.y_m)
        row, column = int(sample.y_m), int(sample.x_m)
        report = SampleReport(
            sample_id=sample.sample_id, round=planned.round, plan_revision=self.revision, x_m=sample.x_m,
            y_m=sample.y_m, depth_m=sample.depth_m, helium3_ppb=float(self._field[row, column]), noise_std_ppb=0.1,
            measured_at=now, driven_m=self.driven,
        )  # fmt: skip
        self._down(Send(SAMPLE, report), now)


class Mission:
    """Ground and rover, and the messages between them."""

    def __init__(self, plan: Scenario, site: Region | None = None, planner: Planner = straight, **rover: float) -> None:
        self.region = site or region()
        self.ground: GroundNode = build_node(plan, self.region, planner)
        self.rover = Rover(self.region.he3_ppb, **rover)
        self.simulation = Simulation([self.ground, self.rover], plan.name, plan.start_ns)
        self.statuses: list[GroundStatus] = []
        self._tellers = 0
        self.simulation.tap(self._listen)

    def _listen(self, topic: object, side: Side, payload: bytes, now: int) -> None:
        if topic is GROUND_STATUS:
            self.statuses.append(decode(GROUND_STATUS, payload, "test")[1])

    def run(self) -> Finish:
        limit = self.simulation.now + seconds(400 * 3600.0)
        self.simulation.run(until=limit, stop=lambda: "ground" in self.simulation.finished)
        return self.simulation.finished["ground"]

    @property
    def snapshot(self) -> MapSnapshot:
        shown = self.simulation.snapshots["ground"]
        assert isinstance(shown, MapSnapshot)
        return shown

    @property
    def status(self) -> GroundStatus:
        return self.statuses[-1]

    def warnings(self) -> list[str]:
        return [note.text for _, _, note in self.simulation.log_records if note.level is Level.WARNING]

    def tell_ground(self, topic: Topic, body: Wire, made_at: int | None = None) -> None:
        """Send the ground a message as from another start of the rover; it is handled at once."""
        made = self.simulation.now if made_at is None else made_at
        self._tellers += 1
        incarnation = 1 + self._tellers
        header = Header(mission="test", source="rover", incarnation=incarnation, sequence=0, made_at=made)
        self.simulation.inject(topic, Side.EARTH, encode(header, body))
        self.simulation.step()


def state(revision: int, place: tuple[float, float] = START, round_: int = 0, mode: str = "parked") -> RoverState:
    return RoverState(
        mode=RoverMode(mode), x_m=place[0], y_m=place[1], heading_deg=0.0, energy_wh=4000.0, capacity_wh=5000.0,
        driven_m=0.0, drilled_m=0.0, round=round_, plan_revision=revision, rounds_on_board=0, samples_done=0,
        queue_depth=0,
    )  # fmt: skip


def sample_report(**changes: object) -> SampleReport:
    fields: dict[str, object] = {
        "sample_id": "r01s1", "round": 1, "plan_revision": 1, "x_m": 10.0, "y_m": 10.0, "depth_m": 0.1,
        "helium3_ppb": 8.0, "noise_std_ppb": 0.1, "measured_at": scenario().start_ns, "driven_m": 5.0,
    }  # fmt: skip
    return SampleReport(**{**fields, **changes})


def command(kind: CommandKind = CommandKind.PAUSE, name: str = "c1", **more: object) -> Telecommand:
    return Telecommand(command_id=name, kind=kind, **more)


def listed(mission: Mission) -> Sequence[CommandStatus]:
    return mission.simulation.ask(LIST_COMMANDS, NoParameters()).commands


def stages(mission: Mission) -> list[str]:
    listed = mission.simulation.ask(LIST_COMMANDS, NoParameters())
    return [report.stage.value for report in listed.commands[0].stages]

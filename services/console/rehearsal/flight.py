"""One rehearsal: the rest of the mission from a copy of it, on one draw."""

from __future__ import annotations

import base64
import sys
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from he3.errors import He3Error, InvalidInput
from he3.hyperdraws import redrawn
from schemas.codec import decode, encode
from schemas.commands import CommandKind
from schemas.link import LinkChange
from schemas.telemetry import EventKind, RoverMode
from schemas.topics import COMMAND, EVENT, ISSUE_COMMAND, LINK_SET, PLAN, SAMPLE, STATE, Side, Topic
from schemas.wire import Header
from services.console.client.commands import without_id
from services.console.rehearsal.alternative import AS_PLANNED, HOLDING, Alternative
from services.console.rehearsal.drawn_field import DrawnField
from services.field.node import FieldNode
from services.ground.belief import Belief
from services.ground.fitting import draws, fit, fit_kernel, infer
from services.ground.node import NAME as GROUND
from services.ground.node import build_node as build_ground
from services.ground.planning import IGNORE_STD, run_planner
from services.link.node import build_node as build_link
from services.mission.mission_time import SECOND, MissionTime
from services.mission.scenario import Scenario
from services.rover.energy import Battery
from services.rover.geometry import Area
from services.rover.node import build_node as build_rover
from services.runtime.drivers.simulation import Simulation
from services.runtime.scheduler import InlineExecutor
from services.runtime.state_codec import StateCodec

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from he3.frames import Place
    from he3.gp import GaussianProcess
    from he3.hyperposterior import HyperparameterDraws
    from he3.reference import Region
    from schemas.commands import Telecommand
    from schemas.fork import MissionFork
    from schemas.link import LinkConditions, LinkStatus
    from schemas.plans import MissionPlan
    from services.ground.fitting import FitRequest
    from services.ground.planners.interface import PlanningRequest
    from services.rover.node import RoverNode
    from services.runtime.scheduler import Executor

LONGEST_S: Final = 200 * 86_400.0
"""Mission time after which a rehearsal ends without a result."""
TRACK_EVERY_S: Final = 300.0
MAP_CELLS: Final = 4096
"""Cells of a rehearsal's map, on which its mean standard deviation is that of all cells but for some thousandths."""
FINAL_CELLS: Final = 2048
"""The same where only the end of the mission needs the map: its mean is off by less than a thousandth [measured]."""
GUIDED_BY_ONE_KERNEL: Final = frozenset({"tour"})
"""Planners that read no alternatives to the one kernel."""
STATE_PERIOD_S: Final = 1200.0
"""Mission time between two reports when nothing changes, of rover and ground, where the link has no data rate."""
LOOK_AHEAD_M: Final = 80.0
"""How far the rover looks ahead, at least, where nothing can stop it on its way."""
REPORTS_IN_TIMEOUT: Final = 3
"""Reports at least in the time after which the ground takes the rover for silent."""
_SEED: Final = 0x7265  # separates the draws of rehearsals from all other uses of the mission's seed
_HOLDS: Final = HOLDING | {CommandKind.RESUME}
"""Commands that hold the rover or release it: the rover of a rehearsal is not held."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where rehearsals begin."""

    fork: MissionFork
    link: LinkStatus
    """Its conditions hold from now on."""
    commands: tuple[Telecommand, ...]
    """Those that have not ended: the rover receives them now."""


@dataclass(slots=True)
class Flight:
    """What one rehearsal came to."""

    draw: int
    completed: bool
    why: str
    """How it ended, in one line."""
    lasts_s: float
    """Mission time from the copy to the end."""
    driven_m: float
    """Metres driven in it."""
    samples: int
    """Samples in the map at its end."""
    mean_std_ppb: float
    charge_wh: float
    """Of the battery at its end."""
    lowest_wh: float
    """The lowest reported charge of the battery."""
    rounds_s: dict[int, float] = field(default_factory=dict)
    """Mission time from the copy to the end of each round, by its number."""
    track_m: list[tuple[float, float, float]] = field(default_factory=list)
    """The rover's way: seconds from the copy, x and y [m]."""
    charges_wh: list[tuple[float, float]] = field(default_factory=list)
    """The battery's charge: seconds from the copy, and Wh."""


def assumptions(start: Start) -> list[str]:
    """What a rehearsal takes for granted although it is not so yet, in one line each."""
    taken, fork = [], start.fork
    if fork.rover is not None and fork.rover.mode in (RoverMode.PAUSED, RoverMode.SAFE):
        taken.append(f"the rover is in the mode {fork.rover.mode.value}: it resumes now")
    if any(command.kind in HOLDING for command in start.commands):
        taken.append("a command on its way would hold the rover: it does not")
    if start.link.contact_forced is False:
        taken.append("the black-out that an operator set ends now")
    if scenario_of(fork).ground.approval == "operator":
        taken.append("every plan is approved at once")
    return taken


def fly(
    start: Start,
    region: Region,
    draw: int,
    executor: Executor | None = None,
    alternative: Alternative = AS_PLANNED,
) -> Flight:
    """The rest of the mission in virtual time. region: the scenario's; executor: of fits and plans, None: at once.

    Draws differ in measurements, hidden hazards and losses on the link; equal numbers give equal flights. Raises
    InvalidInput for a command of the alternative that the ground refuses.
    """
    fork, conditions = start.fork, start.link.conditions
    live = scenario_of(fork)
    seed = live.seed + 1_000_003 * (draw + 1)
    surprised = bool(live.field.hidden_hazards or fork.keep_outs_m or start.commands or alternative.commands)
    scenario = _simplified(live, conditions, alternative.planner, surprised)
    beliefs: list[Belief] = []
    planner, certified = scenario.ground.planner, scenario.ground.goal is not None  # a goal is certified by the map
    guided = planner in GUIDED_BY_ONE_KERNEL and planner in IGNORE_STD and not certified

    def make_belief(*arguments: Any, **options: Any) -> Belief:
        beliefs.append(Belief(*arguments, **options, most_cells=FINAL_CELLS if guided else MAP_CELLS))
        return beliefs[-1]

    ground = build_ground(scenario, region, make_belief=make_belief, map_use="asked")
    state: dict[str, Any] = StateCodec(ground.state_types).decode(base64.b64decode(fork.state_base64))
    state["authority"] = ground.checkpoint()["authority"]  # who may command the mission plays no part here
    ground.restore({**ground.checkpoint(), **state})
    place_m = scenario.start_m if fork.rover is None else (fork.rover.x_m, fork.rover.y_m)
    truth = FieldNode(region, scenario.field, seed, place_m)
    random = np.random.default_rng((live.seed, _SEED, draw))
    belief = _drawn(fork, state["director"]["belief"]["process"], beliefs[0].fit_request(sys.maxsize, ()), random)
    rover = _rover(scenario, region, fork, place_m)
    nodes = (
        DrawnField(truth, belief, scenario.field.noise_std_ppb, random),
        rover,
        build_link(scenario.model_copy(update={"seed": seed}), reports=False),  # no process reads them
        ground,
    )
    computing = executor or InlineExecutor()
    tasks = QuickTasks(computing) if guided else None
    if tasks is not None:
        computing = tasks
    simulation = Simulation(nodes, scenario.name, fork.at, computing, link=conditions)
    simulation.step()  # the nodes start
    if start.link.contact_forced:
        simulation.ask(LINK_SET, LinkChange(contact=True))
    flight = _Watch(simulation, rover, start, draw).run(alternative.commands)
    if tasks is not None and tasks.last is not None and tasks.last.prior is not None:
        beliefs[0].adopt(infer(tasks.last, tasks.last.prior))
    flight.samples = len(beliefs[0])
    flight.mean_std_ppb = float(beliefs[0].map.std_ppb.mean(dtype="f8"))
    return flight


def _drawn(
    fork: MissionFork, known: GaussianProcess, request: FitRequest | None, random: np.random.Generator
) -> GaussianProcess:
    """The same observations under hyperparameters drawn from their posterior. request: for a fit to all of them."""
    if not (_newest and _newest[0][0] is fork):
        _newest[:] = [(fork, None if request is None else draws(request))]
    posterior = _newest[0][1]
    if request is None or posterior is None:
        return redrawn(known, random)
    drawn = posterior.draw(random)
    return known.under(drawn if request.trend is None else replace(drawn, trend=request.trend))


_newest: list[tuple[MissionFork, HyperparameterDraws | None]] = []
"""The mission that was last rehearsed in this process, and its posterior, which is the same for each of its draws."""


def _simplified(live: Scenario, conditions: LinkConditions, planner: str | None, surprised: bool) -> Scenario:
    """The scenario of a rehearsal: no reference, no approval, and fewer reports where none is ahead of another.

    planner: from now on; None: as before. surprised: whether the rover may have to stop on its way, for what it sees
    there or for a command; else it looks at whole legs at once, of which it drives the same.
    """
    ground: dict[str, Any] = {"approval": "auto", "score": False, "planner": planner or live.ground.planner}
    rover: dict[str, Any] = {} if surprised else {"look_ahead_m": max(live.rover.look_ahead_m, LOOK_AHEAD_M)}
    if conditions.up.rate_bit_s is None and conditions.down.rate_bit_s is None:
        often_s = min(STATE_PERIOD_S, live.ground.rover_timeout_s / REPORTS_IN_TIMEOUT)
        ground["status_period_s"] = max(live.ground.status_period_s, often_s)
        rover["state_period_s"] = max(live.rover.state_period_s, often_s)
    return live.model_copy(
        update={
            "link": conditions,
            "ground": live.ground.model_copy(update=ground),
            "rover": live.rover.model_copy(update=rover),
        }
    )


class QuickTasks:
    """An executor whose fits and plans take less time: for `tour`, which nothing but the one kernel guides.

    Fits are of the one kernel alone, searched from the one before it. Plans keep the order of the plan before them.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self.last: FitRequest | None = None
        """The newest fit."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """The future result."""
        if function is fit:
            self.last = arguments[0]
            return self._executor.submit(fit_kernel, replace(arguments[0], nearby=True))
        if function is run_planner:
            planner, request, pending = arguments
            return self._executor.submit(function, planner, quick(request), pending)
        return self._executor.submit(function, *arguments)


def quick(request: PlanningRequest) -> PlanningRequest:
    """The request without a search for a shorter order of places, where they come in the order of the plan before.

    What the samples taken explain is computed in single precision.
    """
    if request.outlook_m is None:
        return request
    extra = {"kicks": 0.0, "rough": 1.0, **request.options.extra}
    return replace(request, options=replace(request.options, extra=extra))


def scenario_of(fork: MissionFork) -> Scenario:
    """The scenario of the copy; raises InvalidInput for a plug-in planner, whose program may not be here."""
    scenario = Scenario.model_validate_json(fork.scenario_json)
    if ":" in scenario.ground.planner:
        raise InvalidInput(f"rehearsal: expected a built-in planner, got the plug-in {scenario.ground.planner}")
    return scenario


def _rover(scenario: Scenario, region: Region, fork: MissionFork, place_m: Place) -> RoverNode:
    """The rover as the ground knows it: its place, battery and odometer, the last round begun, and keep-outs."""
    unlimited = scenario.link.up.rate_bit_s is None and scenario.link.down.rate_bit_s is None
    rover = build_rover(scenario, region.grid, reports_steps=not unlimited)
    if fork.rover is None:
        return rover
    known, config = fork.rover, scenario.rover
    state: dict[str, Any] = dict(rover.checkpoint())
    executive: dict[str, Any] = dict(state["executive"])
    executive["vehicle"] = {
        **executive["vehicle"],
        "battery": Battery(config.capacity_wh, config.solar_w - config.base_load_w, known.energy_wh, fork.at),
        "drilled_m": known.drilled_m,
        "track_m": [scenario.start_m, place_m],
        "place_m": place_m,
        "heading_deg": known.heading_deg,
        "driven_m": known.driven_m,
    }
    begun = known.round if fork.plan is None else fork.plan.rounds[0].round - 1
    executive["keep_outs"] = {"areas": {name: Area.of(corners) for name, corners in fork.keep_outs_m.items()}}
    executive["plan_queue"] = {**executive["plan_queue"], "round": begun, "measured": set(fork.measured)}
    rover.restore({**state, "executive": executive})
    return rover


class _Watch:
    """A simulation that is flown to its end, and what is seen of it."""

    def __init__(self, simulation: Simulation, rover: RoverNode, start: Start, draw: int) -> None:
        self._simulation, self._rover = simulation, rover
        self._commands, self._fork = start.commands, start.fork
        fork = start.fork
        driven_m = 0.0 if fork.rover is None else fork.rover.driven_m
        charge_wh = 0.0 if fork.rover is None else fork.rover.energy_wh
        self._driven_before_m = driven_m
        self._flight = Flight(draw, False, "", 0.0, driven_m, 0, 0.0, charge_wh, charge_wh or float("inf"))
        simulation.tap(self._listen, (STATE, EVENT, SAMPLE))

    def run(self, commands: Sequence[Telecommand]) -> Flight:
        """Fly it to its end. commands: issued at its beginning."""
        simulation, fork = self._simulation, self._fork
        if fork.plan is not None:
            self._bring(PLAN, fork.plan, 0)
        on_the_way = (command for command in self._commands if command.kind not in _HOLDS)
        for number, command in enumerate(on_the_way):
            self._bring(COMMAND, command, number)
        for command in commands:
            try:
                simulation.ask(ISSUE_COMMAND, command)
            except He3Error as refusal:
                raise InvalidInput(f"rehearsal: {without_id(str(refusal), command)}") from None
        simulation.run(until=fork.at + round(LONGEST_S * SECOND), stop=lambda: GROUND in simulation.finished)
        flight, end = self._flight, simulation.finished.get(GROUND)
        flight.completed = end is not None and end.ok
        flight.why = f"not over after {LONGEST_S / 86_400:.0f} days" if end is None else end.why
        flight.lasts_s = (simulation.now - fork.at) / SECOND
        flight.driven_m = max(0.0, flight.driven_m - self._driven_before_m)
        return flight

    def _bring(self, topic: Topic, body: MissionPlan | Telecommand, sequence: int) -> None:
        """Let the rover receive this message now, as from an earlier start of the ground."""
        name, at = self._simulation.host(GROUND).mission, self._simulation.now
        header = Header(mission=name, source=GROUND, incarnation=0, sequence=sequence, made_at=at)
        self._simulation.inject(topic, Side.MOON, encode(header, body))
        self._simulation.step()

    def _listen(self, topic: Topic, side: Side, payload: bytes, now: MissionTime) -> None:
        """Look at the rover whenever it reports anything."""
        if side is not Side.MOON:
            return
        flight, since_s = self._flight, (now - self._fork.at) / SECOND
        if topic is EVENT:
            body = decode(topic, payload, self._simulation.host(GROUND).mission)[1]
            if body.kind is EventKind.ROUND_COMPLETED:
                flight.rounds_s.setdefault(body.round, since_s)
        state = self._rover.state(now)
        flight.driven_m, flight.charge_wh = state.driven_m, state.energy_wh
        flight.lowest_wh = min(flight.lowest_wh, state.energy_wh)
        if not flight.track_m or since_s - flight.track_m[-1][0] >= TRACK_EVERY_S:
            flight.track_m.append((since_s, state.x_m, state.y_m))
            flight.charges_wh.append((since_s, state.energy_wh))

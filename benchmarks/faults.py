"""Random faults: whole short missions with the real nodes, link and journals, killed and cut off at any instant.

Each run draws a fault schedule from its seed: processes killed and started again (also between writing their journal
and acting on it, also with a torn last record), black-outs, loss, duplicates, reordering, corruption, a rate that
collapses, a light time that grows, an operator who pauses, aborts, sends away, closes areas. A run counts as

    lost       a sample that the rover measured is not in the map, or the mission ended with too few
    doubled    a sample was measured, reported or put into the map more than once
    stuck      the mission was not over within a bound of mission time
    unequal    the map is not that of a ground that saw the same samples without faults, or a restart from the journals
               does not give it back to the byte

Every failure prints the seed that reproduces it and the smallest schedule that still fails.
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import kept
from benchmarks.fault_schedules import (
    LINK_FAULTS,
    SERVICES,
    Fault,
    FaultKind,
    Schedule,
    link_change,
    random_schedule,
    shrunk,
    telecommand,
)
from benchmarks.tasks import Tasks, progress
from he3.errors import He3Error, InvalidInput
from he3.frames import SiteGrid
from he3.reference import Region
from schemas.codec import decode
from schemas.commands import CommandKind, NoParameters, Telecommand
from schemas.link import LinkChange, LinkConditions
from schemas.topics import ISSUE_COMMAND, LINK_SET, SAMPLE, TRACK, Side, Topic
from schemas.wire import Wire
from services.field.node import build_node as build_field
from services.ground.belief import Belief
from services.ground.map.overview import hyperparameters_from
from services.ground.node import build_node as build_ground
from services.ground.observation import Observation
from services.ground.planner_process import PlannerProcess
from services.link.node import build_node as build_link
from services.mission.in_process import InProcessMission
from services.mission.mission_time import SECOND, MissionTime
from services.mission.regions import load_region
from services.mission.scenario import Scenario, checked_scenario
from services.rover.node import build_node as build_rover
from services.runtime.journal import identity_of
from services.runtime.node import Node
from services.runtime.scheduler import Executor, InlineExecutor

CELLS = 120
LIGHT_TIME_S = 1.282
SLACK_S = 72 * 3600.0
"""Mission time that a run may take beyond the fault-free one and its faults."""
TORN = b"\x05\x40\x00\x00\x00\x00\x00\x00\x00torn"
MAP_TOLERANCE_PPB = 2e-3
"""Tolerance [ppb] between a float32 map updated sample by sample and a map built at once."""

Row = dict[str, Any]


@dataclass
class Outcome:
    """The outcome of one run."""

    seed: int
    schedule: Schedule
    lost: bool = False
    doubled: bool = False
    stuck: bool = False
    unequal: bool = False
    why: list[str] = field(default_factory=list)
    smallest: Schedule = ()
    """The smallest schedule that still fails, if the mission failed."""

    @property
    def failed(self) -> bool:
        return self.lost or self.doubled or self.stuck or self.unequal


def run(
    runs: int = 100,
    seed: int = 0,
    jobs: int = 2,
    engine: str = "local",
    store: Path | None = None,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
    fly_seed: Callable[[int], Outcome] | None = None,
) -> Row:
    """The counts of failures in that many missions, seeds from `seed` on; printed, and written as JSON.

    engine, store: as `he3 campaign run` takes them; with a store, a run that was ended continues. Raises He3Error after
    them all if one has failed. fly_seed: flies the mission of a seed; `fly_and_shrink` unless it is given.
    """
    if runs < 1 or jobs < 1:
        raise InvalidInput(f"expected one run and one job at least, got {runs} and {jobs}")
    began = time.monotonic()
    failures: list[Outcome] = []
    count = 0
    with Tasks(jobs, engine, store) as pool:
        for count, (_, outcome) in enumerate(
            pool.results(fly_seed or fly_and_shrink, range(seed, seed + runs)), start=1
        ):
            if outcome.failed:
                failures.append(outcome)
                say(_described(outcome))
            if count % 50 == 0 or count == runs:
                elapsed = time.monotonic() - began
                progress(
                    f"{count}/{runs} missions, {len(failures)} failed, {elapsed:.0f} s, {elapsed / count:.2f} s each"
                )
        row = {
            "runs": count,
            "lost": sum(outcome.lost for outcome in failures),
            "doubled": sum(outcome.doubled for outcome in failures),
            "stuck": sum(outcome.stuck for outcome in failures),
            "unequal": sum(outcome.unequal for outcome in failures),
            "failed_seeds": sorted(outcome.seed for outcome in failures),
            "wall_time_s": time.monotonic() - began,
        }
        if pool.stopped is not None:
            row["stopped_by"] = pool.stopped.name
            say(f"stopped by {pool.stopped.name} after {count} of {runs} missions")
        say("  ".join(f"{name} {row[name]}" for name in ("runs", "lost", "doubled", "stuck", "unequal")))
        kept.write_whole(json, row)
    if failures:
        raise He3Error(f"{len(failures)} of {runs} missions failed, seeds {row['failed_seeds']}")
    return row


def _described(outcome: Outcome) -> str:
    faults = "".join(f"\n    {fault}" for fault in outcome.smallest)
    return f"seed {outcome.seed} FAILED: {'; '.join(outcome.why)}\n  smallest schedule that fails:{faults}"


# --- one run ----------------------------------------------------------------------------------------------------


def fly(seed: int) -> Outcome:
    """The outcome of the mission with that seed."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0xFA17]))
    return fly_schedule(seed, random_schedule(rng, horizon_s=9 * 3600.0, extent_m=small_region().grid.width_m))


def fly_and_shrink(seed: int) -> Outcome:
    """The outcome of the mission with that seed; if it failed, with the smallest schedule that still fails."""
    outcome = fly(seed)
    if outcome.failed:
        outcome.smallest = shrunk(outcome.schedule, lambda schedule: fly_schedule(seed, schedule).failed)
    return outcome


def fly_schedule(seed: int, schedule: Schedule) -> Outcome:
    """The outcome of the mission with that seed under that schedule."""
    return fly_world(World(seed, _executor()), schedule)


def fly_world(world: World, schedule: Schedule, patience_s: float = SLACK_S) -> Outcome:
    """The outcome of that world's mission under that schedule; stuck if it exceeds the time limit."""
    outcome = Outcome(world.scenario.seed, schedule)
    try:
        world.suffer(schedule)
        bound_s = world.mission.mission_time_s + patience_s
        world.mission.run(world.revive, until_s=bound_s)
    except He3Error as error:
        outcome.stuck = True
        outcome.why.append(str(error))
        return outcome
    world.judge(outcome)
    return outcome


def scenario_of(seed: int, planner: str | None = None) -> Scenario:
    """A short mission: three to five rounds; length, planner (unless it is given) and pipeline drawn from the seed."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5CE]))
    drawn = str(rng.choice(["rrt", "rrtstar", "tour"], p=[0.4, 0.4, 0.2]))  # tours take longest to plan
    return checked_scenario(
        {
            "name": "faults",
            "region": "t1",
            "seed": seed,
            "rounds": int(rng.integers(3, 6)),
            "samples_per_round": int(rng.integers(2, 4)),
            # Some meet boulders that no map shows, some have to charge on the way.
            "field": {"hidden_hazards": int(rng.choice([0, 0, 3])), "hazard_radius_m": 2.0},
            "rover": {
                "state_period_s": 600.0,
                "look_ahead_m": 10.0,
                "solar_w": float(rng.choice([450.0, 450.0, 200.0])),
                "capacity_wh": float(rng.choice([5000.0, 600.0])),
            },
            "ground": {
                "planner": planner or drawn,
                "kernel": "matern52",
                "pipeline": int(rng.integers(0, 3)),
                "planning_s": 30.0,
                "status_period_s": 3600.0,
            },
            "link": {"up": {"one_way_light_time_s": LIGHT_TIME_S}, "down": {"one_way_light_time_s": LIGHT_TIME_S}},
        },
        f"faults {seed}",
    )


@cache
def small_region() -> Region:
    """A corner of the embedded T1, so that a run costs about a second."""
    whole = load_region("t1")
    cut = (slice(0, CELLS), slice(0, CELLS))
    return Region(
        name="t1-corner",
        title=f"{whole.title}, corner",
        provenance=whole.provenance,
        grid=SiteGrid(CELLS, CELLS, whole.grid.resolution_m),
        he3_ppb=whole.he3_ppb[cut],
        orbital_ppb=whole.orbital_ppb[cut],
        elevation_m=whole.elevation_m[cut],
        slope_deg=whole.slope_deg[cut],
        traversable=whole.traversable[cut],
    )


@cache
def _executor() -> Executor:
    return _Planners()


class _Planners:
    """An executor that starts a process only for functions that use OMPL's global state."""

    def __init__(self) -> None:
        self._process = PlannerProcess(parallel=1)
        self._here = InlineExecutor()

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        if arguments and arguments[0] in ("rrt", "rrtstar"):
            return self._process.submit(function, *arguments)
        return self._here.submit(function, *arguments)


class World:
    """One mission, its processes, and the samples that the rover reported."""

    def __init__(self, seed: int, executor: Executor, planner: str | None = None) -> None:
        self.scenario = scenario_of(seed, planner)
        nodes = [self._built(name) for name in ("field", "rover", "link", "ground")]
        self.mission = InProcessMission(self.scenario, executor=executor, nodes=nodes)
        self.simulation = self.mission.simulation
        self.simulation.keep_journals(("rover", "ground"), identity_of(self.scenario))
        self.reported: dict[str, set[tuple[int, int, float]]] = {}
        self.simulation.tap(self._listen)

    def _built(self, name: str) -> Node:
        region = small_region()
        if name == "field":
            return build_field(self.scenario, region)
        if name == "rover":
            return build_rover(self.scenario, region.grid)
        return build_link(self.scenario) if name == "link" else build_ground(self.scenario, region)

    def _listen(self, topic: Topic, side: Side, payload: bytes, _now: MissionTime) -> None:
        if topic is SAMPLE and side is Side.MOON:
            header, body = decode(topic, payload, self.scenario.name)
            told = (header.incarnation, header.sequence, body.helium3_ppb)
            self.reported.setdefault(body.sample_id, set()).add(told)

    # --- faults -------------------------------------------------------------------------------------------------

    def suffer(self, schedule: Schedule) -> None:
        """Run the mission through every fault; then start all processes, reset the link and resume the rover."""
        moments: list[tuple[float, int, bool, Fault]] = []
        for number, fault in enumerate(schedule):
            moments += [(fault.at_s, number, True, fault), (fault.at_s + fault.lasts_s, number, False, fault)]
        for at_s, _, begins, fault in sorted(moments, key=lambda moment: moment[:3]):
            if self.mission.end is not None:
                break
            self._run_until(at_s)
            self._apply(fault, begins)
        self.revive()
        if not self._set_link(healed := LinkChange(conditions=LinkConditions(), contact_as_scheduled=True)):
            self.revive()
            self._set_link(healed)
        self._command(Telecommand(command_id="the-last-resume", kind=CommandKind.RESUME))

    def revive(self) -> None:
        """Start every process that is down: one that is to crash at its next effect may do so late."""
        for name in SERVICES:
            self._start(name, torn=False)

    def _run_until(self, at_s: float) -> None:
        until = self.scenario.start_ns + round(at_s * SECOND)
        self.simulation.run(until=until, stop=lambda: self.mission.end is not None)

    def _apply(self, fault: Fault, begins: bool) -> None:
        match fault.kind:
            case FaultKind.KILL if begins:
                self.simulation.kill(fault.who)
            case FaultKind.CRASH if begins:
                self.simulation.crash_next(fault.who)
            case FaultKind.KILL | FaultKind.CRASH:
                self._start(fault.who, fault.torn)
            case FaultKind.COMMAND:
                self._command(telecommand(fault, begins, f"{fault.who}-{begins:d}-{self.simulation.now}"))
            case kind if kind in LINK_FAULTS:
                self._set_link(link_change(fault, begins, LIGHT_TIME_S))

    def _start(self, name: str, torn: bool) -> None:
        if not self.simulation.alive(name):
            self.simulation.restart(self._built(name), TORN if torn else b"")

    def _set_link(self, change: LinkChange) -> bool:
        """Change the link; returns whether it answered."""
        return self._asked("link", LINK_SET, change)

    def _command(self, command: Telecommand | None) -> None:
        if command is None or not self.simulation.alive("ground"):
            return
        may_refuse = command.kind is CommandKind.GO_TO  # the way may lead over ground that is known as closed
        if not self._asked("ground", ISSUE_COMMAND, command, may_refuse):
            # The command may have gone out or not: because of its id it is executed once.
            self._start("ground", torn=False)
            self._asked("ground", ISSUE_COMMAND, command, may_refuse)

    def _asked(self, name: str, topic: Topic, request: Wire, may_refuse: bool = False) -> bool:
        """Whether that process answered; it may be down, or go down on the query.

        may_refuse: whether a refusal is an answer. Raises He3Error for one where it is not.
        """
        if not self.simulation.alive(name):
            return False
        try:
            self.simulation.ask(topic, request)
        except He3Error:
            if not self.simulation.alive(name):
                return False
            if not may_refuse:
                raise
        return True

    # --- judgement ----------------------------------------------------------------------------------------------

    def judge(self, outcome: Outcome) -> None:
        """Check the finished mission, and fill in the outcome."""
        track = self.simulation.ask(TRACK, NoParameters())
        times = Counter(sample.sample_id for sample in track.samples)
        twice = sorted(name for name, count in times.items() if count > 1)
        told_twice = sorted(name for name, told in self.reported.items() if len(told) > 1)
        if twice or told_twice:
            outcome.doubled = True
            outcome.why.append(f"in the map twice: {twice}, measured or reported twice: {told_twice}")
        missing = sorted(self.reported.keys() - times.keys())
        if missing or len(times) != self.scenario.samples:
            outcome.lost = True
            outcome.why.append(
                f"{len(times)} of {self.scenario.samples} samples in the map, missing {missing}: {self.mission.why()}"
            )
        self._compare_maps(outcome)

    def _compare_maps(self, outcome: Outcome) -> None:
        shown: Any = self.simulation.snapshots["ground"]
        replayed = self.simulation.replayed_snapshot(self._built("ground"))
        for name in ("mean_ppb", "std_ppb"):
            if getattr(replayed, name).tobytes() != getattr(shown, name).tobytes():
                outcome.unequal = True
                outcome.why.append(f"{name}: a restart from the journals gives other bytes")
        status = self.mission.status
        if status is None or status.kernel is None:
            return
        fitted = hyperparameters_from(status.kernel)
        belief = Belief(shown.grid, fitted.kernel.name, fitted.noise_std_ppb, likeliest=True)
        observations = {
            sample.sample_id: Observation((1, 1, number), (sample.x_m, sample.y_m), sample.helium3_ppb)
            for number, sample in enumerate(shown.samples)
        }
        belief.begin_with(observations, fitted)
        faultless = belief.map
        for name, there, here in (
            ("mean", faultless.mean_ppb, shown.mean_ppb),
            ("std", faultless.std_ppb, shown.std_ppb),
        ):
            worst = float(np.abs(there - here).max())
            if not worst <= MAP_TOLERANCE_PPB:
                outcome.unequal = True
                outcome.why.append(f"{name}: differs by {worst:.2g} ppb from the map without faults")


if __name__ == "__main__":
    sys.exit(0 if run(runs=int(sys.argv[1]) if len(sys.argv) > 1 else 100) else 1)

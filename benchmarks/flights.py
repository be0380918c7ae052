"""Runs the missions of planner comparisons on several cores."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import kept
from benchmarks.missions import FOOTPRINT_RADIUS_M, ROUNDS, Mission, Row, run_mission
from benchmarks.tasks import Tasks, progress
from he3.errors import He3Error, InvalidInput
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from he3.reference import Region
from services.ground.planner_process import PlannerProcess
from services.ground.planners import PLANNERS
from services.ground.planners.interface import PlannedRound, Planner, PlanningRequest
from services.ground.terrain import GroundTerrain
from services.mission.embedded_regions import EMBEDDED
from services.mission.regions import load_region


@dataclass(frozen=True, slots=True)
class Flight:
    """One mission to run."""

    region: str
    planner: str
    kernel: str
    seed: int
    budget_m: float = inf
    prior: str | None = None
    orbital_gain: float = 1.0
    orbital_offset_ppb: float = 0.0
    """The orbital map that the ground is given is this gain times the true one, plus this offset."""
    label: str = ""
    """Name of the row in tables; the planner's name if empty."""
    variation: int | None = None
    """Seed of another variation of an embedded region; its own if None. A region from a file has no other."""
    rounds: int = ROUNDS
    likeliest: bool = True
    """Hyperparameters of maximum likelihood, as the paper has them; else all that the samples leave possible."""
    noise_std_ppb: float = DEFAULT_NOISE_STD_PPB
    start_m: tuple[float, float] | None = None
    """Where the rover stands at first [m]; ``start_of`` the region if None."""

    @property
    def name(self) -> str:
        return self.label or self.planner


@dataclass(frozen=True, slots=True)
class Conditions:
    """What all missions of a comparison share; made of a benchmark's flags by `conditions`."""

    noise_std_ppb: float
    start_m: tuple[float, float] | None
    budget_m: float

    def on(self, flight: Flight) -> Flight:
        """The flight under these conditions; a smaller budget of its own stays."""
        budget_m = min(self.budget_m, flight.budget_m)
        return replace(flight, noise_std_ppb=self.noise_std_ppb, start_m=self.start_m, budget_m=budget_m)


def conditions(noise: float, start: Sequence[float], budget: float | None) -> Conditions:
    """The conditions of these flags: noise [ppb], start X,Y [m] or nothing, budget [m] or None.

    Raises InvalidInput for numbers that do not fit.
    """
    if not (isfinite(noise) and noise >= 0):
        raise InvalidInput(f"expected a noise of 0 or more, got {noise:g}")
    if len(start) not in (0, 2) or not all(map(isfinite, start)):
        raise InvalidInput(f"expected a start X,Y [m], got {','.join(map(str, start))}")
    if budget is not None and not budget > 0:
        raise InvalidInput(f"expected a positive budget [m], got {budget:g}")
    return Conditions(noise, (start[0], start[1]) if start else None, inf if budget is None else budget)


def expect_open(region: Region, start_m: tuple[float, float] | None) -> None:
    """Raise InvalidInput for a start [m] off the region or on ground that the rover may not enter."""
    if start_m is None:
        return
    grid = region.grid
    ground = GroundTerrain(grid, region.traversable, FOOTPRINT_RADIUS_M).for_legs()
    if not ground.is_open(np.array([start_m]))[0]:
        raise InvalidInput(f"{region.name}: expected a start on open ground within 0..{grid.width_m:g} m east and "
                           f"0..{grid.height_m:g} m north, got {start_m[0]:g},{start_m[1]:g}")  # fmt: skip


def flown(flights: Sequence[Flight], pool: Tasks) -> tuple[dict[Flight, Mission], list[str]]:
    """The missions that were completed, in the order of the flights, and a line for each that failed.

    A line of progress is printed for each. A mission that fails does not stop the others. After a signal, only the
    missions that were completed before it are returned.
    """
    completed: dict[Flight, Mission] = {}
    failures: list[str] = []
    began = time.monotonic()
    for count, (flight, outcome) in enumerate(pool.outcomes(fly, flights), start=1):
        head = f"  {count:>3}/{len(flights)}  {flight.region:<4} {flight.name:<22} seed {flight.seed:<3} "
        if isinstance(outcome, He3Error):
            failures.append(f"{flight.name} on {flight.region}, seed {flight.seed}: {outcome}")
            progress(f"{head} failed: {outcome}")
            continue
        completed[flight] = outcome
        row = outcome.row
        progress(
            f"{head} rmse {row['rmse_ppb']:.4f} ppb  {row['path_length_m']:7.0f} m  {row['samples']} samples  "
            f"{row['wall_time_s']:.1f} s   ({time.monotonic() - began:.0f} s)"
        )
    return {flight: completed[flight] for flight in flights if flight in completed}, failures


def expect_none(failures: Sequence[str]) -> None:
    """Raise He3Error if a flight failed: to be called when the others are printed and written."""
    if failures:
        raise He3Error(f"{len(failures)} of the missions failed, the first: {failures[0]}")


def fly(flight: Flight) -> Mission:
    """The mission of that flight, with the label and the orbital map's errors in its row."""
    region = region_named(flight.region, flight.variation)
    orbital = flight.orbital_gain * region.orbital_ppb + flight.orbital_offset_ppb
    mission = run_mission(
        region,
        planner_for(flight.planner),
        flight.kernel,
        flight.seed,
        rounds=flight.rounds,
        budget_m=flight.budget_m,
        prior=flight.prior,
        likeliest=flight.likeliest,
        noise_std_ppb=flight.noise_std_ppb,
        start_m=flight.start_m,
        orbital_ppb=orbital if flight.prior == "orbital" else None,
    )
    mission.row.update(region=region.name, planner=flight.planner, label=flight.name)
    return mission


def planner_for(name: str) -> str | Planner:
    """The planner of that name; a plug-in has a fresh process for each plan, so that its request alone counts."""
    return name if name in PLANNERS else partial(_planned, name)


@cache
def region_named(name: str, variation: int | None = None) -> Region:
    """An embedded region, in one of its variations if asked for, or the region of a file, which has one only."""
    return load_region(name, variation if name in EMBEDDED else None)


@cache
def _process() -> PlannerProcess:
    return PlannerProcess(parallel=1)


def _planned(name: str, request: PlanningRequest) -> PlannedRound:
    return _process().plan(name, request).result()


def mean_and_std(rows: Sequence[Row], key: str) -> tuple[float, float]:
    """Mean and sample standard deviation of one figure over rows; the latter 0 for a single row."""
    values = np.array([row[key] for row in rows], dtype=np.float64)
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0


OVER_SEEDS = "±: standard deviation over the seeds"


def mean_over_seeds(rows: Sequence[Row], key: str, digits: int, std_width: int) -> str:
    """Mean of one figure over rows, 8 wide, and its sample standard deviation, so wide; of a single row none."""
    mean, std = mean_and_std(rows, key)
    spread = f" ± {std:{std_width}.{digits}f}" if len(rows) > 1 else ""
    return f"{mean:8.{digits}f}{spread:<{std_width + 3}}"


def written(
    rows: Sequence[Row], json: Path | None, say: Callable[[str], None], pool: Tasks | None = None, **more: Any
) -> None:
    """Write ``{"rows": [...]}`` to that file, if one is given; say so if a signal left some rows out."""
    stopped = None if pool is None else pool.stopped
    if stopped is not None:
        say(f"stopped by {stopped.name}: {len(rows)} rows so far")
        more["stopped_by"] = stopped.name
    if json is not None:
        kept.write_whole(json, {"rows": list(rows), **more})
        say(f"written {json}")

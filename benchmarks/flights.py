"""Many missions of many kinds on several cores: what the comparisons of planners have in common."""

from __future__ import annotations

import json as json_format
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cache, partial
from math import inf
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.missions import Mission, Row, run_mission
from he3.errors import He3Error, InvalidInput
from he3.reference import Region
from services.ground.planner_process import PlannerProcess
from services.ground.planners.interface import PlannedRound, PlanningRequest
from services.mission.regions import load_region

OWN_PROCESS = ("rrt", "rrtstar", "informative")
"""Planners on OMPL: each plan in a fresh process, as in a mission, so that a plan depends on its request alone. So is
each of anybody's own (``module:function``)."""


@dataclass(frozen=True, slots=True)
class Flight:
    """One mission to fly."""

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
    """What the row is called in tables; the planner's name if empty."""
    variation: int | None = None
    """Seed of another variation of an embedded region; its own if None. A region from a file has no other."""

    @property
    def name(self) -> str:
        return self.label or self.planner


def flown(
    flights: Sequence[Flight], jobs: int, say: Callable[[str], None], began: float | None = None
) -> tuple[dict[Flight, Mission], list[str]]:
    """The missions that landed, by flight and in the flights' order, and a line for each that failed.

    A line is said for each as it ends: what one of them does wrong is no reason to lose the others.
    """
    landed: dict[Flight, Mission] = {}
    failures: list[str] = []
    started = time.monotonic() if began is None else began
    for count, (flight, outcome) in enumerate(_outcomes(flights, jobs), start=1):
        head = f"  {count:>3}/{len(flights)}  {flight.region:<4} {flight.name:<22} seed {flight.seed:<3} "
        if isinstance(outcome, He3Error):
            failures.append(f"{flight.name} on {flight.region}, seed {flight.seed}: {outcome}")
            say(f"{head} failed: {outcome}")
            continue
        landed[flight] = outcome
        row = outcome.row
        say(
            f"{head} rmse {row['rmse_ppb']:.4f} ppb  {row['path_length_m']:7.0f} m  {row['samples']} samples  "
            f"{row['wall_time_s']:.1f} s   ({time.monotonic() - started:.0f} s)"
        )
    return {flight: landed[flight] for flight in flights if flight in landed}, failures


def expect_none(failures: Sequence[str]) -> None:
    """Raise He3Error if a flight failed: to be called when the others are printed and written."""
    if failures:
        raise He3Error(f"{len(failures)} of the missions failed, the first: {failures[0]}")


def _outcomes(flights: Sequence[Flight], jobs: int) -> Iterator[tuple[Flight, Mission | He3Error]]:
    if jobs < 1:
        raise InvalidInput(f"expected one job at least, got {jobs}")
    if jobs == 1 or len(flights) < 2:
        for flight in flights:
            yield flight, _outcome(flight)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(_outcome, flight): flight for flight in flights}
        for future in as_completed(waiting):
            yield waiting[future], future.result()


def _outcome(flight: Flight) -> Mission | He3Error:
    try:
        return fly(flight)
    except He3Error as error:
        return error


def fly(flight: Flight) -> Mission:
    """The mission of that flight, with the label and the orbital map's errors in its row."""
    region = region_named(flight.region, flight.variation)
    planner: Any = flight.planner
    if flight.planner in OWN_PROCESS or ":" in flight.planner:
        planner = partial(_planned, flight.planner)
    orbital = flight.orbital_gain * region.orbital_ppb + flight.orbital_offset_ppb
    mission = run_mission(
        region,
        planner,
        flight.kernel,
        flight.seed,
        budget_m=flight.budget_m,
        prior=flight.prior,
        orbital_ppb=orbital if flight.prior == "orbital" else None,
    )
    mission.row.update(region=region.name, planner=flight.planner, label=flight.name)
    return mission


@cache
def region_named(name: str, variation: int | None = None) -> Region:
    """An embedded region, in one of its variations if asked for, or anybody's from a file."""
    return load_region(name, variation)


@cache
def _process() -> PlannerProcess:
    return PlannerProcess(parallel=1)


def _planned(name: str, request: PlanningRequest) -> PlannedRound:
    return _process().plan(name, request).result()


def mean_and_std(rows: Sequence[Row], key: str) -> tuple[float, float]:
    """Mean and sample standard deviation of one figure over rows; the latter 0 for a single row."""
    values = np.array([row[key] for row in rows], dtype=np.float64)
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0


def written(rows: Sequence[Row], json: Path | None, say: Callable[[str], None], **more: Any) -> None:
    """Write ``{"rows": [...]}`` if asked to."""
    if json is not None:
        json.parent.mkdir(parents=True, exist_ok=True)
        json.write_text(json_format.dumps({"rows": list(rows), **more}, indent=2) + "\n")
        say(f"written {json}")

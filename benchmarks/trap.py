"""Missions that begin on uniform ground: whether the map becomes certain of what it has not seen, and stops exploring.

Six fields of 500 m are plateaus at 3 to 10 ppb: uniform ground as far as the rover sees, and another level beyond. From
drawn starts, missions of few samples are flown with the hyperparameters' uncertainty counted (`bayes`, the default) and
with those of maximum likelihood taken for certain (`ml`, as published). A mission is trapped when its map is no better
than the field's mean: an RMSE above the field's own standard deviation. With --region FILE, missions fly there, too:
from the south-west corner, and from the nearest place from which most ground can be reached, if that is another.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.calibration import NOMINAL
from benchmarks.flights import mean_and_std, planner_for, region_named, written
from benchmarks.missions import Row, corner_of, run_mission, start_of
from benchmarks.tasks import Tasks, progress
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.reference import Region
from he3.terrain import reachable
from services.ground.planners import planner_named

GRID = SiteGrid(50, 50, 10.0)
LOW_PPB, HIGH_PPB = 3.0, 10.0
HYPERPARAMETERS = ("bayes", "ml")
_START = 11  # tells the seeds of starts from all others


def _two(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.where(x + 0.6 * y < 420.0, LOW_PPB, HIGH_PPB)


def _island(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.where(np.hypot(x - 330.0, y - 300.0) < 120.0, HIGH_PPB, LOW_PPB)


def _lake(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.where(np.hypot((x - 220.0) / 1.6, y - 240.0) < 110.0, LOW_PPB, HIGH_PPB)


def _terraces(x: FloatArray, y: FloatArray) -> FloatArray:
    return LOW_PPB + 3.5 * np.floor((x + y) / 334.0).clip(0, 2)


def _quarters(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.where((x < 250.0) == (y < 250.0), LOW_PPB, HIGH_PPB)


def _valley(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.where(np.abs(y - 0.5 * x - 120.0) < 80.0, LOW_PPB, HIGH_PPB)


PLATEAUS: dict[str, Callable[[FloatArray, FloatArray], FloatArray]] = {
    "two": _two,
    "island": _island,
    "lake": _lake,
    "terraces": _terraces,
    "quarters": _quarters,
    "valley": _valley,
}


@cache
def plateau(name: str) -> Region:
    """The field of plateaus of that name: 500 m of level, open ground."""
    field = PLATEAUS[name](*np.meshgrid(GRID.x_m, GRID.y_m))
    level = np.zeros(GRID.shape)
    return Region(
        name=name, title=f"plateaus: {name}", provenance="made by the benchmark", grid=GRID, he3_ppb=field,
        orbital_ppb=field.copy(), elevation_m=level, slope_deg=level.copy(),
        traversable=np.ones(GRID.shape, dtype=np.bool_),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Trial:
    """One mission: on a field of plateaus from a drawn start, or on a region of a file from that place."""

    field: str
    planner: str
    hyperparameters: str
    start: int
    rounds: int
    kernel: str
    start_m: tuple[float, float] | None = None


def run(
    starts: int = 20,
    rounds: int = 8,
    fields: Sequence[str] = tuple(PLATEAUS),
    planners: Sequence[str] = ("tour",),
    kernel: str = "smooth+rough",
    hyperparameters: Sequence[str] = HYPERPARAMETERS,
    region: Path | None = None,
    jobs: int = 2,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row a mission; the table printed, rows written to `json`.

    fields: of plateaus; rounds: of 5 samples; hyperparameters: of bayes and ml; region: a region, flown once from each
    of its starts with each planner. Raises InvalidInput for names that are not known.
    """
    for given, known in ((fields, PLATEAUS), (hyperparameters, HYPERPARAMETERS)):
        if unknown := [name for name in given if name not in known]:
            raise InvalidInput(f"expected names among {', '.join(known)}; got {', '.join(unknown)}")
    if starts < 1 or rounds < 1 or not planners or not hyperparameters or not (fields or region):
        raise InvalidInput(f"expected one start, round, planner and field at least, got {starts} and {rounds}")
    for planner in planners:
        planner_named(planner)
    trials = [
        Trial(field, planner, how, start, rounds, kernel)
        for field in fields for planner in planners for how in hyperparameters for start in range(1, starts + 1)
    ]  # fmt: skip
    if region is not None:
        begun_at = dict.fromkeys((corner_of(region_named(str(region))), start_of(region_named(str(region)))))
        trials += [
            Trial(str(region), planner, how, 0, rounds, kernel, start_m)
            for start_m in begun_at for planner in planners for how in hyperparameters
        ]  # fmt: skip
    found: dict[Trial, Row] = {}
    began = time.monotonic()
    with Tasks(jobs) as pool:
        for trial, row in pool.results(fly, trials):
            found[trial] = row
            progress(f"  {len(found):>3}/{len(trials)} missions   ({time.monotonic() - began:.0f} s)")
        rows = [found[trial] for trial in trials if trial in found]
        for line in table(rows):
            say(line)
        written(rows, json, say, pool)
    return rows


def fly(trial: Trial) -> Row:
    """The row of that mission."""
    region = plateau(trial.field) if trial.field in PLATEAUS else region_named(trial.field)
    start = trial.start_m or _drawn_start(trial.start)
    mission = run_mission(
        region, planner_for(trial.planner), trial.kernel, trial.start, rounds=trial.rounds, start_m=start,
        likeliest=trial.hyperparameters == "ml",
    )  # fmt: skip
    open_cells = mission.traversable
    return {
        **mission.row,
        "region": region.name if trial.start_m is None else f"{region.name} {start[0]:g},{start[1]:g}",
        "planner": trial.planner,
        "hyperparameters": trial.hyperparameters,
        "start": trial.start,
        "field_std_ppb": float(region.of_known(region.he3_ppb).std()),
        "map_std_ppb": float(region.of_known(mission.std_ppb).mean(dtype=np.float64)),
        "reached_share": float(reachable(open_cells, region.grid, start).sum() / open_cells.sum()),
        "ended": mission.ended,
    }


def _drawn_start(number: int) -> tuple[float, float]:
    x, y = np.random.default_rng((_START, number)).uniform(25.0, 475.0, 2)
    return float(x), float(y)


def table(rows: Sequence[Row]) -> list[str]:
    """Lines of the comparison: means and least values for each field, planner and kind of hyperparameters."""
    head = (
        f"{'field':<14} {'planner':<12} {'hyper':<6} {'missions':>8} {'trapped':>8} {'RMSE/std':>9} {'std ppb':>8} "
        f"{'68.3 %':>7} {'least':>6} {'95.4 %':>7} {'least':>6}"
    )
    lines = [head, "-" * len(head)]
    keys = dict.fromkeys((row["region"], row["planner"], row["hyperparameters"]) for row in rows)
    kinds = dict.fromkeys((row["planner"], row["hyperparameters"]) for row in rows if row["region"] in PLATEAUS)
    groups = [(f"{key[0]:<14} {key[1]:<12} {key[2]:<6}", [row for row in rows if _key(row) == key]) for key in keys]
    groups += [
        (f"{'all plateaus':<14} {kind[0]:<12} {kind[1]:<6}",
         [row for row in rows if row["region"] in PLATEAUS and _key(row)[1:] == kind])
        for kind in kinds
    ]  # fmt: skip
    for name, group in groups:
        trapped = sum(row["rmse_ppb"] >= row["field_std_ppb"] for row in group)
        ratio = float(np.mean([row["rmse_ppb"] / row["field_std_ppb"] for row in group]))
        one, two = (mean_and_std(group, key)[0] for key in ("coverage_68", "coverage_95"))
        least = [min(row[key] for row in group) for key in ("coverage_68", "coverage_95")]
        lines.append(
            f"{name} {len(group):>8} {trapped:>8} {ratio:9.3f} {mean_and_std(group, 'map_std_ppb')[0]:8.3f} "
            f"{one:7.1%} {least[0]:6.1%} {two:7.1%} {least[1]:6.1%}"
        )
    lines.append(f"trapped: RMSE not below the field's std; coverage: nominal {NOMINAL[0]:.1%} and {NOMINAL[1]:.1%}")
    lines += [
        f"{row['region']}, {row['planner']}, {row['hyperparameters']}: {row['reached_share']:.1%} of the open ground "
        f"can be reached from the start; {row['samples']} samples"
        for row in rows
        if row["reached_share"] < 0.5
    ]
    return lines


def _key(row: Row) -> tuple[str, str, str]:
    return row["region"], row["planner"], row["hyperparameters"]

"""Planning times: one plan of each planner, the overhead of the planner process, and a whole mission.

    plan_s           one plan with 0, 75 or 145 samples known, in this process (median over seeds)
    process_plan_s   the same through the planner process: request there, a fork, answer back
    mission_plan_s   planning in a whole mission of 30 rounds of 5 samples, all rounds together
    mission_wall_s   that mission: planning, measuring, the map after each sample, a refit each round
    rmse_ppb, path_length_m   how the mission went, for orientation; ``he3 bench paper`` compares planners

A row for each planner. Before them, the basic operations: leg checks a second, one at a time as OMPL asks for them
and many at once, and the planner process with a task that does nothing.
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import operator
import statistics
import time
from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import kept
from benchmarks.missions import FOOTPRINT_RADIUS_M, START_M, run_mission
from he3.errors import InvalidInput
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import kernel_from
from he3.reference import Region
from services.ground.planner_process import PlannerProcess
from services.ground.planners import PLANNERS, planner_named
from services.ground.planners.interface import PlanningRequest
from services.ground.planners.traversability import OpenGround
from services.ground.terrain import GroundTerrain
from services.mission.regions import load_region

KNOWN = (0, 75, 145)
SAMPLES, TOTAL = 5, 150
LEGS = 20_000

Row = dict[str, Any]


def run(
    region: str = "t1",
    planners: Sequence[str] = tuple(PLANNERS),
    kernel: str = "matern52",
    repeats: int = 5,
    missions: bool = True,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> Row:
    """All figures, as printed and as written to ``json``: ``{"foundations": {...}, "rows": [...]}``.

    Raises InvalidInput for an unknown region, planner or kernel, or for less than one repeat.
    """
    if repeats < 1:
        raise InvalidInput(f"expected one repeat or more, got {repeats}")
    for name in planners:
        planner_named(name)
    field = load_region(region)
    with PlannerProcess(parallel=1) as process:
        begun = time.perf_counter()
        process.submit(operator.add, 1, 2).result()
        started_s = time.perf_counter() - begun
        foundations = {**_leg_checks(field), "process_start_s": started_s, "process_task_s": _empty_task(process)}
        say(
            f"leg checks: {foundations['legs_one_by_one_per_s']:,.0f}/s one by one, "
            f"{foundations['legs_at_once_per_s']:,.0f}/s at once; "
            f"planner process: first answer after {started_s:.2f} s, then {_ms(foundations['process_task_s'])} a task"
        )
        header = "".join(f"{f'plan, {n} known':>18}{'in process':>12}" for n in KNOWN)
        say(f"{'planner':<12}{header}{'30 plans':>10}{'mission':>10}{'RMSE ppb':>10}{'driven m':>10}")
        rows = [_row(name, field, kernel, repeats, missions, process, say) for name in planners]
    document: Row = {"foundations": foundations, "rows": rows}
    kept.write_whole(json, document)
    return document


def _row(
    name: str, region: Region, kernel: str, repeats: int, missions: bool, process: PlannerProcess,
    say: Callable[[str], None],
) -> Row:  # fmt: skip
    planner = planner_named(name)
    row: Row = {"planner": name, "region": region.name, "kernel": kernel, "known": list(KNOWN)}
    here: list[float] = []
    there: list[float] = []
    for known in KNOWN:
        requests = [request_with(region, kernel, known, seed) for seed in range(repeats)]
        planner(requests[0])  # imports and the like
        here.append(_median(lambda asked: planner(asked), requests))
        there.append(_median(lambda asked: process.plan(name, asked).result(), requests))
    row |= {"plan_s": here, "process_plan_s": there}
    line = "".join(f"{_ms(a):>18}{_ms(b):>12}" for a, b in zip(here, there, strict=True))
    if missions:
        flown = run_mission(region, name, kernel, seed=0).row
        row |= {"mission_plan_s": flown["plan_time_s"], "mission_wall_s": flown["wall_time_s"]}
        row |= {key: flown[key] for key in ("rmse_ppb", "path_length_m", "samples")}
        line += f"{flown['plan_time_s']:>8.2f} s{flown['wall_time_s']:>8.2f} s"
        line += f"{flown['rmse_ppb']:>10.4f}{flown['path_length_m']:>10.0f}"
    say(f"{name:<12}{line}")
    return row


def request_with(region: Region, kernel: str, known: int, seed: int) -> PlanningRequest:
    """A planning request with that many samples at random places."""
    rng = np.random.default_rng([seed, known])
    terrain = GroundTerrain(region.grid, region.traversable, FOOTPRINT_RADIUS_M)
    cells = np.argwhere(terrain.for_legs().connected_to(START_M))
    places = (cells[rng.integers(len(cells), size=known + 1)][:, ::-1] + 0.5) * region.grid.resolution_m
    hyperparameters = Hyperparameters(kernel_from(kernel), mean_ppb=7.0, scale_ppb=1.5)
    belief = GaussianProcess(hyperparameters).condition_on_places(places[:known])
    std = belief.predict(region.grid.points())[1].astype(np.float32).reshape(region.grid.shape)
    start = START_M if known == 0 else (float(places[known, 0]), float(places[known, 1]))
    return PlanningRequest(
        grid=region.grid,
        traversable=terrain.traversable,
        start_m=start,
        observed_m=places[:known],
        std_ppb=std,
        hyperparameters=hyperparameters,
        samples=SAMPLES,
        samples_left=TOTAL - known,
        budget_m=inf,
        seed=seed,
        margin_m=terrain.margin_m,
    )


def _leg_checks(region: Region) -> dict[str, float]:
    ground = OpenGround(region.grid, region.traversable)
    rng = np.random.default_rng(0)
    extent = np.array([region.grid.width_m, region.grid.height_m])
    begin = rng.uniform(0.0, 1.0, (LEGS, 2)) * extent
    end = np.clip(begin + rng.normal(0.0, 7.0, begin.shape), 0.0, extent)
    check, legs = ground.segment_check(), np.hstack((begin, end)).tolist()
    clock = time.perf_counter()
    for leg in legs:
        check(*leg)
    alone = time.perf_counter() - clock
    clock = time.perf_counter()
    ground.segments_free(begin, end)
    return {"legs_one_by_one_per_s": LEGS / alone, "legs_at_once_per_s": LEGS / (time.perf_counter() - clock)}


def _empty_task(process: PlannerProcess) -> float:
    return _median(lambda _: process.submit(operator.add, 1, 2).result(), range(20))


def _median(call: Callable[[Any], Any], arguments: Sequence[Any]) -> float:
    times = []
    for argument in arguments:
        clock = time.perf_counter()
        call(argument)
        times.append(time.perf_counter() - clock)
    return statistics.median(times)


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms"


if __name__ == "__main__":
    run()

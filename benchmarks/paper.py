"""The paper's table and figures: planners on regions over seeds, beside what was published.

The yardstick is `rrtstar` with the paper's protocol and kernel. Our planners are compared with it on the same fields,
noise, start and number of samples, and scored on all cells:

    rrt, rrtstar          the paper's protocol and the kernel that it states, squared exponential; no limit on metres
    rrtstar-matern52      the same with Matern 5/2, which made the published figures and is the harder to beat
    rrtstar-own-kernel    the same with the kernel of our planners: what a better belief alone is worth
    informative           utility I^alpha / c over every path of a tree
    tour                  one design and one route for all that is left
    tour-fifth            the same, held to a fifth of the yardstick's metres
    tour-orbital          the same, with the coarse orbital map as prior mean, which changes the question
    tour-orbital-biased   the same, with an orbital map off by a gain of 1.3 and an offset of 1 ppb
    floor                 no mission: the best design found offline with the field's true covariance known
    floor-fifth           the same, held to a fifth of the yardstick's metres

Any other planner is named module:function, and flies beside them: --planners rrtstar,tour,my_planners:mine
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from math import inf
from pathlib import Path
from typing import Any

from benchmarks.calibration import MARKS, MISMATCHED
from benchmarks.flights import (
    OVER_SEEDS,
    Conditions,
    Flight,
    conditions,
    expect_none,
    expect_open,
    flown,
    mean_and_std,
    mean_over_seeds,
    region_named,
    written,
)
from benchmarks.floor import Floor
from benchmarks.floor import floor as floor_of
from benchmarks.missions import ROUNDS, SAMPLES_A_ROUND, Mission, Row
from benchmarks.tasks import Tasks
from he3.errors import InvalidInput
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from services.ground.planners import PLANNERS, planner_named
from services.mission.embedded_regions import EMBEDDED

PUBLISHED = {
    ("t1", "rrt"): (0.8347, 16829.9),
    ("t1", "rrtstar"): (0.8517, 15024.1),
    ("t2", "rrt"): (0.5318, 18588.5),
    ("t2", "rrtstar"): (0.4949, 15358.5),
}
"""RMSE [ppb] and path [m] of the paper's table, one seed each."""

YARDSTICK = "rrtstar"
HARDER = "rrtstar-matern52"
SAME_BELIEF = "rrtstar-own-kernel"
FIFTH = "tour-fifth"
ORBITAL = "tour-orbital"
BIASED = "tour-orbital-biased"
ALL = ("rrt", YARDSTICK, HARDER, SAME_BELIEF, "informative", "tour", FIFTH, ORBITAL, BIASED)


def run(
    seeds: int = 10,
    regions: Sequence[str] = ("t1", "t2"),
    region: Path | None = None,
    planners: Sequence[str] = ALL,
    kernel: str = "se",
    own_kernel: str = "smooth+rough",
    jobs: int = 2,
    engine: str = "local",
    store: Path | None = None,
    floor: bool = True,
    noise: float = DEFAULT_NOISE_STD_PPB,
    start: Sequence[float] = (),
    budget: float | None = None,
    json: Path | None = None,
    out: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row a mission; the table printed, figures drawn into `out`, rows written to `json`.

    regions: embedded names; region: a field as .npz in their place. kernel: of the paper's protocol; own_kernel: of our
    planners. floor: find it, too, which takes half a minute a region and budget. noise: standard deviation [ppb];
    start: X,Y [m]; budget: metres, of every mission. engine, store: as `he3 campaign run` takes them; with a store, a
    run that was ended goes on. Raises InvalidInput for names that are not known and numbers that do not fit.
    """
    if seeds < 1:
        raise InvalidInput(f"expected one seed at least, got {seeds}")
    if not planners or not (regions or region):
        raise InvalidInput("expected one planner and one region at least, got none")
    known = (*ALL, *(name for name in PLANNERS if name not in ALL))
    unknown = [name for name in planners if name not in known and ":" not in name]
    if unknown:
        raise InvalidInput(f"expected planners among {'; '.join(known)}, or module:function; got {', '.join(unknown)}")
    for name in planners:
        if ":" in name:
            planner_named(name)
    names = [str(region)] if region is not None else list(regions)
    shared = conditions(noise, start, budget)
    for name in names:
        expect_open(region_named(name), shared.start_m)
    if FIFTH in planners and YARDSTICK not in planners:
        raise InvalidInput(f"expected {YARDSTICK} among the planners, as '{FIFTH}' is measured by it")
    first = [shared.on(_flight(name, planner, seed, kernel, own_kernel)) for name in names for planner in planners
             for seed in range(1, seeds + 1) if planner != FIFTH]  # fmt: skip
    with Tasks(jobs, engine, store) as pool:
        missions, failures = flown(first, pool)
        if FIFTH in planners:
            fifths = []
            for name in names:
                yardstick = _rows(missions, name, YARDSTICK)
                metres = mean_and_std(yardstick, "path_length_m")[0] if yardstick else inf
                fifths += [shared.on(Flight(name, "tour", own_kernel, seed, budget_m=metres / 5, label=FIFTH))
                           for seed in range(1, seeds + 1)]  # fmt: skip
            of_fifths, failed = flown([flight for flight in fifths if flight.budget_m < inf], pool)
            missions |= of_fifths
            failures += failed
        floors = _floors(missions, names, planners, shared, pool) if floor else {}
        for name in names:
            say("")
            for line in table(missions, name, planners, floors.get(name, ())):
                say(line)
        rows = [mission.row for mission in missions.values()]
        written(rows, json, say, pool, floors=[asdict(found) for name in names for found in floors.get(name, ())])
    if out is not None:
        from benchmarks.figures import paper_figures

        for path in paper_figures(missions, names, planners, out):
            say(f"written {path}")
    expect_none(failures)
    return rows


def _flight(region: str, planner: str, seed: int, kernel: str, own_kernel: str) -> Flight:
    if planner in ("rrt", YARDSTICK):
        return Flight(region, planner, kernel, seed)
    if planner == HARDER:
        return Flight(region, YARDSTICK, "matern52", seed, label=HARDER)
    if planner == SAME_BELIEF:
        return Flight(region, YARDSTICK, own_kernel, seed, label=SAME_BELIEF)
    if planner == ORBITAL:
        return Flight(region, "tour", own_kernel, seed, prior="orbital", label=ORBITAL)
    if planner == BIASED:
        return Flight(region, "tour", own_kernel, seed, prior="orbital", orbital_gain=1.3, orbital_offset_ppb=1.0,
                      label=BIASED)  # fmt: skip
    return Flight(region, planner, own_kernel, seed)


def _floors(
    missions: dict[Flight, Mission],
    names: Sequence[str],
    planners: Sequence[str],
    shared: Conditions,
    pool: Tasks,
) -> dict[str, list[Floor]]:
    """The floors of each region, without a limit on metres first."""
    wanted = [(name, shared) for name in names]
    for name in names if FIFTH in planners else ():
        yardstick = _rows(missions, name, YARDSTICK)
        if yardstick:
            fifth_m = min(shared.budget_m, mean_and_std(yardstick, "path_length_m")[0] / 5)
            wanted.append((name, replace(shared, budget_m=fifth_m)))
    found = dict(pool.results(_floor, wanted))
    return {name: [found[one] for one in wanted if one[0] == name and one in found] for name in names}


def _floor(wanted: tuple[str, Conditions]) -> Floor:
    """The floor of the region of that name under these conditions."""
    name, shared = wanted
    return floor_of(region_named(name), budget_m=shared.budget_m, noise_std_ppb=shared.noise_std_ppb,
                    start_m=shared.start_m)  # fmt: skip


def _rows(missions: dict[Flight, Mission], region: str, name: str) -> list[Row]:
    return [mission.row for flight, mission in missions.items() if (flight.region, flight.name) == (region, name)]


def table(
    missions: dict[Flight, Mission], region: str, planners: Sequence[str], floors: Sequence[Floor] = ()
) -> list[str]:
    """Lines of the comparison on one region: mean and standard deviation over seeds, and ratios to the yardstick."""
    head = (
        f"{'planner':<22} {'kernel':<13} {'RMSE ppb':>17} {'metres':>15} {'/ RMSE':>7} {'/ m':>6} {'/ m52':>6} "
        f"{'68 %':>6} {'95 %':>6}  {'published':<18}"
    )
    lines = [f"{region}: {region_named(region).title}", head, "-" * len(head)]
    yardsticks = _rows(missions, region, YARDSTICK), _rows(missions, region, HARDER)
    for planner in planners:
        rows = _rows(missions, region, planner)
        if not rows:
            continue
        rmse, metres = (mean_and_std(rows, key)[0] for key in ("rmse_ppb", "path_length_m"))
        ratio = _ratios(rmse, metres, *yardsticks)
        published: Any = PUBLISHED.get((region, planner))
        beside = f"{published[0]:.4f} {published[1]:9.1f} m" if published else ""
        kernel = rows[0]["kernel"] + (MISMATCHED.get(rows[0]["kernel"], "") if region in EMBEDDED else "")
        lines.append(
            f"{planner:<22} {kernel:<13} {mean_over_seeds(rows, 'rmse_ppb', 4, 6)} "
            f"{mean_over_seeds(rows, 'path_length_m', 0, 4)} {ratio} "
            f"{mean_and_std(rows, 'coverage_68')[0]:6.1%} {mean_and_std(rows, 'coverage_95')[0]:6.1%}  {beside}"
        )
    for lowest in floors:
        free = lowest.budget_m is None
        if lowest.why_not:
            lines.append(f"{'floor' if free else 'floor-fifth':<22} left out: {lowest.why_not}")
            continue
        lines.append(
            f"{'floor' if free else 'floor-fifth':<22} {'true, known':<13} {lowest.rmse_ppb:8.4f} {'':<8} "
            f"{lowest.length_m:8.0f} {'':<6} {_ratios(lowest.rmse_ppb, lowest.length_m, *yardsticks)}"
        )
    for lowest in floors:
        name = "tour" if lowest.budget_m is None else FIFTH
        tours = _rows(missions, region, name)
        if tours and not lowest.why_not:
            error = mean_and_std(tours, "rmse_ppb")[0] / lowest.rmse_ppb - 1
            metres = mean_and_std(tours, "path_length_m")[0] / lowest.length_m - 1
            lines.append(f"{name} compared with its floor: RMSE {error:+.1%}, metres {metres:+.1%}")
    lines.append(
        f"{OVER_SEEDS}; ratios are to {YARDSTICK}, '/ m52' to the RMSE of {HARDER}; "
        "coverage: share of the cells in the intervals of 68.3 and 95.4 %"
    )
    shown = {MISMATCHED.get(mission.row["kernel"]) for mission in missions.values()} if region in EMBEDDED else set()
    lines += [mark for mark in MARKS if mark[0] in shown]
    for flight, mission in missions.items():
        if flight.region == region and mission.row["samples"] < ROUNDS * SAMPLES_A_ROUND:
            lines.append(
                f"{flight.name}, seed {flight.seed}: {mission.row['samples']} of {ROUNDS * SAMPLES_A_ROUND} samples: "
                f"{mission.ended}"
            )
    return lines


def _ratios(rmse: float, metres: float, yardstick: Sequence[Row], harder: Sequence[Row]) -> str:
    to_rmse, to_metres = (
        mean_and_std(yardstick, key)[0] if yardstick else 0.0 for key in ("rmse_ppb", "path_length_m")
    )
    to_harder = mean_and_std(harder, "rmse_ppb")[0] if harder else 0.0
    parts = ((rmse, to_rmse, 7), (metres, to_metres, 6), (rmse, to_harder, 6))
    return " ".join(f"{value / to:{width}.3f}" if to else " " * width for value, to, width in parts)

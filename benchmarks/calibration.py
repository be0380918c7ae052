"""Coverage of the intervals: the share of the truth within 1 and 2 posterior deviations, by kernel, over fields.

A probability of 68 % is about all fields of a kind, not about one. So each seed draws its own variation of an embedded
region and its own noise; for a region from a file, only the noise varies. Samples are taken where the paper's `rrtstar`
goes, and where `informative` and `tour` go. Every kernel is fitted to the same samples. The reference fields are a
smooth trend with a rough perturbation of exponential covariance, so `smooth+rough` matches them. The other kernels are
marked as mismatched: too smooth for the perturbation, or without the trend. "auto" is whichever the fit chooses.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.flights import Flight, conditions, expect_open, fly, mean_and_std, region_named, written
from benchmarks.missions import Row
from benchmarks.worker_pool import WorkerPool, progress
from he3.errors import InvalidInput
from he3.gp import fit_hyperparameters
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from he3.kernels import AUTO, KERNELS
from he3.posterior.grid import GridPosterior
from services.ground.scoring import Scorer
from services.mission.embedded_regions import EMBEDDED

MISMATCHED = {"se": "*", "matern32": "*", "matern52": "*", "matern12": "+"}
"""Kernels that do not match the reference fields, and their mark."""
MARKS = (
    "* mismatched: smoother than the field, so that its intervals are too narrow wherever samples are spread out",
    "+ mismatched: without the field's smooth part, so that its intervals are a little too wide between even samples",
)
DESIGNS = {"rrtstar": "matern52", "informative": "smooth+rough", "tour": "smooth+rough"}
"""The planners that choose the places, each with the kernel that it plans with."""
NOMINAL = (0.683, 0.954)
JUDGED = (*KERNELS, AUTO)


def run(
    seeds: int = 10,
    regions: Sequence[str] = ("t1", "t2"),
    region: Path | None = None,
    jobs: int = 2,
    noise: float = DEFAULT_NOISE_STD_PPB,
    start: Sequence[float] = (),
    budget: float | None = None,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row a fit; the table printed, rows written to `json`.

    regions: embedded names; region: a field as .npz in their place. noise: standard deviation [ppb]; start: X,Y [m];
    budget: metres. Raises InvalidInput for names that are not known and numbers that do not fit.
    """
    if seeds < 1 or jobs < 1 or not (regions or region):
        raise InvalidInput(f"expected one seed, job and region at least, got {seeds}, {jobs} and {len(regions)}")
    names = [str(region)] if region is not None else list(regions)
    shared = conditions(noise, start, budget)
    for name in names:
        expect_open(region_named(name), shared.start_m)
    flights = [shared.on(Flight(name, planner, kernel, seed, variation=seed)) for name in names
               for planner, kernel in DESIGNS.items() for seed in range(1, seeds + 1)]  # fmt: skip
    found: dict[Flight, list[Row]] = {}
    began = time.monotonic()
    with WorkerPool(jobs) as pool:
        for flight, of_flight in pool.results(coverage, flights):
            found[flight] = of_flight
            progress(f"  {len(found):>3}/{len(flights)} sets of samples   ({time.monotonic() - began:.0f} s)")
        rows = [row for flight in flights for row in found.get(flight, ())]
        for name in names:
            say("")
            for line in table(rows, region_named(name).name):
                say(line)
        written(rows, json, say, pool)
    return rows


def coverage(flight: Flight) -> list[Row]:
    """A row for every kernel, fitted to the samples of that mission."""
    mission, truth = fly(flight), region_named(flight.region, flight.variation)
    scorer, count = Scorer(truth.he3_ppb), len(mission.samples_m)
    rows = []
    for kernel in JUDGED:
        rng = np.random.default_rng(np.random.SeedSequence((flight.seed, count)))
        fitted = fit_hyperparameters(
            mission.samples_m, mission.values_ppb, kernel, rng=rng, noise_std_ppb=flight.noise_std_ppb,
            extent_m=max(truth.grid.width_m, truth.grid.height_m),
        )  # fmt: skip
        posterior = GridPosterior.build(truth.grid, fitted, mission.samples_m, mission.values_ppb)
        score = scorer.score(posterior.mean_ppb, posterior.std_ppb, count, count, 0)
        rows.append(
            {
                "region": truth.name,
                "planner": flight.planner,
                "kernel": kernel,
                "chosen": fitted.kernel.name,
                "seed": flight.seed,
                "samples": count,
                "rmse_ppb": score.rmse_ppb,
                "coverage_68": score.coverage_68,
                "coverage_95": score.coverage_95,
                "log_likelihood": fitted.log_likelihood,
                "mismatched": kernel in MISMATCHED,
            }
        )
    return rows


def table(rows: Sequence[Row], region: str) -> list[str]:
    """Lines of coverage on one region: mean over seeds, and difference from nominal."""
    head = f"{'samples of':<11} {'kernel':<14} {'RMSE ppb':>9} {'68.3 %':>8} {'off':>6} {'95.4 %':>8} {'off':>6}"
    lines = [f"{region_named(region).title if region in EMBEDDED else region}", head, "-" * len(head)]
    for planner in DESIGNS:
        for kernel in JUDGED:
            group = [row for row in rows if (row["region"], row["planner"], row["kernel"]) == (region, planner, kernel)]
            if not group:
                continue
            one, two = (mean_and_std(group, key)[0] for key in ("coverage_68", "coverage_95"))
            lines.append(
                f"{planner:<11} {kernel + (MISMATCHED.get(kernel, '') if region in EMBEDDED else ''):<14} "
                f"{mean_and_std(group, 'rmse_ppb')[0]:9.4f} {one:8.1%} {100 * (one - NOMINAL[0]):+6.1f} "
                f"{two:8.1%} {100 * (two - NOMINAL[1]):+6.1f}"
            )
    lines += ["off: points from nominal, mean over fields", *(MARKS if region in EMBEDDED else ())]
    return lines

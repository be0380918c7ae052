"""Coverage of the intervals: the share of the truth in the central ones of 68.3 and 95.4 %, by kernel, over fields.

A probability of 68 % is about all fields of a kind, not about one. So each seed draws its own variation of an embedded
region and its own noise; for a region from a file, only the noise varies. Samples are taken where the paper's `rrtstar`
goes, and where `informative` and `tour` go. Every kernel is fitted to the same samples: with the uncertainty of its
hyperparameters counted (`bayes`, as missions do unless told otherwise), and with those of maximum likelihood (`ml`).
The two differ most where samples are few, as with --rounds 2,4,6. The reference fields are a smooth trend with a rough
perturbation of exponential covariance, so `smooth+rough` matches them. The other kernels are marked as mismatched: too
smooth for the perturbation, or without the trend. "auto" mixes all of them; with `ml` it is the one that the fit
chooses.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

from benchmarks.flights import Flight, conditions, expect_open, fly, mean_and_std, region_named, written
from benchmarks.missions import ROUNDS, SAMPLES_A_ROUND, Row
from benchmarks.tasks import Tasks, progress
from he3.errors import InvalidInput
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from he3.kernels import AUTO, KERNELS
from services.ground.belief import Belief
from services.ground.fitting import fit
from services.ground.observation import Observation
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
POOR = (0.45, 0.80)
"""Coverage of the two intervals below which a single mission's map is no longer honest."""
_OF_POOR = f"poor: missions whose intervals hold less than {POOR[0]:.0%} and less than {POOR[1]:.0%} of the field"
_OF_A_LINE = ("region", "planner", "hyperparameters", "kernel", "samples")
_COVERAGES = ("coverage_68", "coverage_95")
HYPERPARAMETERS = ("bayes", "ml")


def run(
    seeds: int = 10,
    regions: Sequence[str] = ("t1", "t2"),
    region: Path | None = None,
    rounds: Sequence[int] = (ROUNDS,),
    jobs: int = 2,
    engine: str = "local",
    store: Path | None = None,
    noise: float = DEFAULT_NOISE_STD_PPB,
    start: Sequence[float] = (),
    budget: float | None = None,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row a fit; the table printed, rows written to `json`.

    regions: embedded names; region: a field as .npz in their place; rounds: of 5 samples, of each mission. noise:
    standard deviation [ppb]; start: X,Y [m]; budget: metres. engine, store: as `he3 campaign run` takes them; with a
    store, a run that was ended goes on. Raises InvalidInput for names that are not known and numbers that do not fit.
    """
    if seeds < 1 or jobs < 1 or not (regions or region) or not rounds or min(rounds) < 1:
        raise InvalidInput(f"expected one seed, job, region and round at least, got {seeds}, {jobs} and {len(regions)}")
    names = [str(region)] if region is not None else list(regions)
    shared = conditions(noise, start, budget)
    for name in names:
        expect_open(region_named(name), shared.start_m)
    flights = [
        shared.on(Flight(name, planner, kernel, seed, variation=seed, rounds=count, likeliest=False))
        for name in names for count in rounds for planner, kernel in DESIGNS.items() for seed in range(1, seeds + 1)
    ]  # fmt: skip
    found: dict[Flight, list[Row]] = {}
    began = time.monotonic()
    with Tasks(jobs, engine, store) as pool:
        for flight, of_flight in pool.results(coverage, flights):
            found[flight] = of_flight
            progress(f"  {len(found):>3}/{len(flights)} sets of samples   ({time.monotonic() - began:.0f} s)")
        rows = [row for flight in flights for row in found.get(flight, ())]
        for name in names:
            for count in rounds:
                say("")
                for line in table(rows, region_named(name).name, count * SAMPLES_A_ROUND):
                    say(line)
        written(rows, json, say, pool)
    return rows


def coverage(flight: Flight) -> list[Row]:
    """A row for every kernel and kind of hyperparameters, fitted to the samples of that mission."""
    mission, truth = fly(flight), region_named(flight.region, flight.variation)
    scorer, count = Scorer(truth.he3_ppb, truth.known), len(mission.samples_m)
    rows = []
    for kernel, how in ((kernel, how) for how in HYPERPARAMETERS for kernel in JUDGED):
        belief = Belief(truth.grid, kernel, flight.noise_std_ppb, likeliest=how == "ml")
        for number, (place, value) in enumerate(zip(mission.samples_m, mission.values_ppb, strict=True)):
            belief.add(f"{number}", Observation((1, 1, number), (float(place[0]), float(place[1])), float(value)))
        request = belief.fit_request(1, (flight.seed, count))
        assert request is not None
        belief.adopt(fit(request))
        score = scorer.score(belief.map.mean_ppb, belief.map.std_ppb, count, count, 0, belief.interval_ends())
        fitted = belief.hyperparameters
        rows.append(
            {
                "region": truth.name,
                "planner": flight.planner,
                "kernel": kernel,
                "hyperparameters": how,
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


def poor(rows: Sequence[Row]) -> tuple[int, int]:
    """How many missions' intervals of 68.3 and of 95.4 % hold less than ``POOR`` of the field."""
    low, high = (sum(row[key] < least for row in rows) for key, least in zip(_COVERAGES, POOR, strict=True))
    return low, high


def table(rows: Sequence[Row], region: str, samples: int) -> list[str]:
    """Lines of coverage on one region with so many samples: mean over seeds, least, and difference from nominal."""
    head = (
        f"{'samples of':<11} {'hyper':<6} {'kernel':<14} {'RMSE ppb':>9} {'68.3 %':>8} {'off':>6} {'least':>6} "
        f"{'95.4 %':>8} {'off':>6} {'least':>6} {'poor':>7}"
    )
    title = region_named(region).title if region in EMBEDDED else region
    lines = [f"{title}, {samples} samples", head, "-" * len(head)]
    for planner, how, kernel in product(DESIGNS, HYPERPARAMETERS, JUDGED):
        wanted = (region, planner, how, kernel, samples)
        group = [row for row in rows if tuple(row[key] for key in _OF_A_LINE) == wanted]
        if not group:
            continue
        one, two = (mean_and_std(group, key)[0] for key in ("coverage_68", "coverage_95"))
        least_one, least_two = (min(row[key] for row in group) for key in ("coverage_68", "coverage_95"))
        mark = MISMATCHED.get(kernel, "") if region in EMBEDDED else ""
        lines.append(
            f"{planner:<11} {how:<6} {kernel + mark:<14} {mean_and_std(group, 'rmse_ppb')[0]:9.4f} "
            f"{one:8.1%} {100 * (one - NOMINAL[0]):+6.1f} {least_one:6.1%} "
            f"{two:8.1%} {100 * (two - NOMINAL[1]):+6.1f} {least_two:6.1%} {'/'.join(map(str, poor(group))):>7}"
        )
    lines += ["off: points from nominal, mean over fields", _OF_POOR, *(MARKS if region in EMBEDDED else ())]
    return lines

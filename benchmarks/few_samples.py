"""Missions of 10, 20 and 30 samples on third-party fields and ours: how much of each field the map's intervals hold.

The fields are those of the exam, by name. A variation of `t1` or `t2` is another field of the same kind. A third-party
field is as it is, so a variation of it begins at another place, drawn from the ground that can be reached. Every
variation has its own noise and its own seed of the planner. Each number of samples is a mission of its own: a planner
that knows how many samples are left, as `tour` does, spreads 10 of 10 otherwise than the first 10 of 30.

The map of a mission counts that its hyperparameters are uncertain (`bayes`). Beside it stands the map of the same
samples under those of maximum likelihood (`ml`), as published.

    he3 bench few-samples --data DIR --variations 20 --store few.db --json few.json

Missions are flown variation by variation, so that those flown so far are a fair sample of all. With --store, the same
command goes on where an interrupted one stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.calibration import NOMINAL, POOR, poor
from benchmarks.exam_fields import ExamField, load_field, names_in
from benchmarks.flights import mean_and_std, planner_for, region_named, written
from benchmarks.missions import SAMPLES_A_ROUND, Row, drawn_start, run_mission, start_of
from benchmarks.sgptools_peer import belief_of
from benchmarks.tasks import Tasks, progress
from he3.errors import InvalidInput
from he3.kernels import AUTO, KERNELS
from services.console.campaign.identity import checksum_of
from services.ground.planners import planner_named
from services.ground.scoring import Scorer
from services.mission.embedded_regions import EMBEDDED

HYPERPARAMETERS = ("bayes", "ml")
_START = 12  # tells the seeds of starts from all others
_MOST_NAMED = 20  # missions below ``POOR`` that are printed one by one
_ALL = "all"


@dataclass(frozen=True, slots=True)
class Trial:
    """One mission on a field of the exam; sha256: of the field's own variation, so that another file is flown anew."""

    field: str
    data: Path | None
    sha256: str
    planner: str
    kernel: str
    rounds: int
    variation: int


def run(
    data: Path | None = None,
    fields: Sequence[str] = (),
    planners: Sequence[str] = ("tour", "informative"),
    rounds: Sequence[int] = (2, 4, 6),
    variations: int = 20,
    first: int = 1,
    kernel: str = AUTO,
    jobs: int = 1,
    engine: str = "local",
    store: Path | None = None,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """Two rows a mission, one for each kind of hyperparameters; the table printed, rows written to `json`.

    data: folder with rasters (docs/exam.md); without it, our own regions alone. fields: all that there are if empty.
    rounds: of 5 samples, of each mission. variations: of each field, the first of which has the number `first`.
    engine, store: as `he3 campaign run` takes them. Raises InvalidInput for names and numbers that do not fit.
    """
    for name, least in (
        ("variations", variations),
        ("first", first),
        ("jobs", jobs),
        ("rounds", min(rounds, default=0)),
    ):
        if least < 1:
            raise InvalidInput(f"--{name}: expected 1 or more, got {least}")
    if not planners:
        raise InvalidInput("--planners: expected one planner or more, got none")
    if kernel not in (*KERNELS, AUTO):
        raise InvalidInput(f"expected a kernel among {', '.join((*KERNELS, AUTO))}; got {kernel!r}")
    for planner in planners:
        planner_named(planner)
    names = list(fields) or names_in(data)
    sums = {name: checksum_of(load_field(name, data).region) for name in names}
    trials = [
        Trial(name, data, sums[name], planner, kernel, count, variation)
        for variation in range(first, first + variations)
        for count, name, planner in product(rounds, names, planners)
    ]
    found: dict[Trial, list[Row]] = {}
    began = time.monotonic()
    with Tasks(jobs, engine, store) as pool:
        for trial, of_trial in pool.results(fly, trials):
            found[trial] = of_trial
            row = of_trial[0]
            progress(
                f"  {len(found):>4}/{len(trials)}  {trial.field:<14} {trial.planner:<12} {row['samples']:>3} samples, "
                f"variation {trial.variation:<4} {row['coverage_68']:6.1%} {row['coverage_95']:6.1%}   "
                f"({time.monotonic() - began:.0f} s)"
            )
        rows = [row for trial in trials for row in found.get(trial, ())]
        for line in table(rows):
            say(line)
        written(rows, json, say, pool)
    return rows


# --- missions -------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=2)
def _field(name: str, data: Path | None) -> ExamField:
    return load_field(name, data)


def fly(trial: Trial) -> list[Row]:
    """The rows of that mission: its map's, and that of the same samples under maximum likelihood."""
    field, seed = _field(trial.field, trial.data), trial.variation
    if trial.field in EMBEDDED:
        region = region_named(trial.field, seed)
        start_m = start_of(region)
    else:
        region = field.region
        start_m = drawn_start(region, np.random.default_rng((_START, seed)))
    mission = run_mission(
        region, planner_for(trial.planner), trial.kernel, seed, rounds=trial.rounds, start_m=start_m,
        noise_std_ppb=field.noise_std_ppb, likeliest=False, history=False,
    )  # fmt: skip
    places, values, std = mission.samples_m, mission.values_ppb, float(region.he3_ppb[field.known].std())
    shared = {
        "field": trial.field,
        "planner": trial.planner,
        "kernel": trial.kernel,
        "variation": trial.variation,
        "samples": trial.rounds * SAMPLES_A_ROUND,
        "taken": len(places),
        "start_m": list(start_m),
        "metres": mission.row["path_length_m"],
        "ended": mission.ended,
        "field_std_ppb": std,
        "samples_std": float(values.std()) / std if len(values) else 0.0,
    }
    likeliest = belief_of(region, places, values, trial.kernel, seed, field.noise_std_ppb, likeliest=True)
    score = Scorer(region.he3_ppb, region.known).score(
        likeliest.map.mean_ppb, likeliest.map.std_ppb, len(places), len(places), 0, likeliest.interval_ends()
    )
    of_ml = {"rmse_ppb": score.rmse_ppb, "coverage_68": score.coverage_68, "coverage_95": score.coverage_95}
    of_mission = {key: mission.row[key] for key in of_ml}
    return [
        {
            **shared,
            "hyperparameters": how,
            **scores,
            "nrmse": scores["rmse_ppb"] / std,
            **({"places_m": places.tolist(), "values_ppb": values.tolist()} if how == "bayes" else {}),
        }
        for how, scores in zip(HYPERPARAMETERS, (of_mission, of_ml), strict=True)
    ]


# --- the table ------------------------------------------------------------------------------------------------------


def table(rows: Sequence[Row]) -> list[str]:
    """Lines: for each field, planner and number of samples, then over fields, both kinds of hyperparameters abreast."""
    of_one = f"{'68.3 %':>8} {'95.4 %':>7} {'poor':>8} {'RMSE/std':>9}"
    head = f"{'field':<14} {'planner':<12} {'samples':>7} {'missions':>8}" + f"  |{of_one}" * len(HYPERPARAMETERS)
    over = f"{'':<44}" + "".join(f"  |{how:^35}" for how in HYPERPARAMETERS)
    lines = [over, head, "-" * len(head)]
    fields, planners, counts = (
        list(dict.fromkeys(row[key] for row in rows)) for key in ("field", "planner", "samples")
    )
    groups = [*product(fields, planners, counts), *product((_ALL,), (*planners, _ALL), counts)]
    for name, planner, count in (*groups, *product((_ALL,), (*planners, _ALL), (_ALL,))):
        wanted = {"field": name, "planner": planner, "samples": count}
        group = [row for row in rows if all(value in (_ALL, row[key]) for key, value in wanted.items())]
        if group:
            each = [[row for row in group if row["hyperparameters"] == how] for how in HYPERPARAMETERS]
            lines.append(
                f"{name:<14} {planner:<12} {count:>7} {len(each[0]):>8}"
                + "".join(f"  |{_figures(one)}" for one in each)
            )
    fewer = sum(row["taken"] < row["samples"] for row in rows if row["hyperparameters"] == "bayes")
    lines += [
        f"poor: missions whose intervals hold less than {POOR[0]:.0%} / less than {POOR[1]:.0%} of the field; "
        f"nominal: {NOMINAL[0]:.1%}, {NOMINAL[1]:.1%}",
        *([f"missions that ended before their last round: {fewer}"] if fewer else []),
        *_named([row for row in rows if row["hyperparameters"] == "bayes"]),
    ]
    return lines


def _figures(rows: Sequence[Row]) -> str:
    one, two, error = (mean_and_std(rows, key)[0] for key in ("coverage_68", "coverage_95", "nrmse"))
    return f"{one:8.1%} {two:7.1%} {'{}/{}'.format(*poor(rows)):>8} {error:9.3f}"


def _named(rows: Sequence[Row]) -> Iterator[str]:
    """Lines about the missions below either bound, those first whose intervals hold the least."""
    worst = sorted((row for row in rows if any(poor([row]))), key=lambda row: (row["coverage_68"], row["coverage_95"]))
    for row in worst[:_MOST_NAMED]:
        yield (
            f"  {row['field']}, {row['planner']}, {row['samples']} samples, variation {row['variation']}, from "
            f"{row['start_m'][0]:g},{row['start_m'][1]:g}: {row['coverage_68']:.1%} and {row['coverage_95']:.1%}; the "
            f"samples vary by {row['samples_std']:.2f} of the field's standard deviation"
        )
    if len(worst) > _MOST_NAMED:
        yield f"  and {len(worst) - _MOST_NAMED} more"

"""A mission in one process beside its planner and map alone: what the services around them cost, in processor time.

Both are flown in this process one after the other, with the same planner, kernel and seed, so load on the machine
meets both. Neither draws pictures, records or keeps an event log. Times are of the processor, child processes included,
and begin when everything is imported.

    alone_s      `benchmarks.missions`: planning, measuring, the map after each sample, a refit each round [s]
    services_s   `he3 run SCENARIO --in-process`: the same with rover, link, custody, messages and the report [s]
    ratio        services_s / alone_s
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks import kept
from benchmarks.missions import run_mission
from he3.errors import InvalidInput
from services.console.launch.in_process import run_in_process
from services.console.launch.scenarios import choose
from services.console.report.outputs import outputs
from services.console.report.progress import SilentProgress
from services.mission.regions import load_region

Row = dict[str, Any]


def run(
    scenarios: Sequence[str] = ("t1-paper", "t1"),
    seed: int = 1,
    repeats: int = 1,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """A row for each scenario, with the least time of the repeats; printed, and written to ``json``.

    Raises InvalidInput for less than one repeat or an unknown scenario.
    """
    if repeats < 1:
        raise InvalidInput(f"expected one repeat or more, got {repeats}")
    run_in_process(choose("short").scenario, outputs(None, None, None), SilentProgress())  # imports and the like
    say(f"{'scenario':<12} {'planner':<12} {'kernel':<14} {'alone':>9} {'services':>10} {'ratio':>7}")
    rows = []
    for name in scenarios:
        row = _row(name, seed, repeats)
        rows.append(row)
        say(
            f"{name:<12} {row['planner']:<12} {row['kernel']:<14} {row['alone_s']:>7.2f} s {row['services_s']:>8.2f} s "
            f"{row['ratio']:>7.2f}"
        )
    kept.write_whole(json, rows)
    return rows


def _row(name: str, seed: int, repeats: int) -> Row:
    scenario = choose(name, seed=seed).scenario
    ground = scenario.ground
    region = load_region(scenario.region, scenario.field.field_seed)
    alone, services = [], []
    for _ in range(repeats):
        alone.append(
            _processor_s_of(
                lambda: run_mission(
                    region,
                    ground.planner,
                    ground.kernel,
                    scenario.seed,
                    rounds=scenario.rounds,
                    samples=scenario.samples_per_round,
                    likeliest=ground.hyperparameters == "ml",
                )
            )
        )
        services.append(_processor_s_of(lambda: run_in_process(scenario, outputs(None, None, None), SilentProgress())))
    return {
        "scenario": name,
        "planner": ground.planner,
        "kernel": ground.kernel,
        "seed": scenario.seed,
        "alone_s": min(alone),
        "services_s": min(services),
        "ratio": min(services) / min(alone),
    }


def _processor_s_of(work: Callable[[], Any]) -> float:
    """Processor time of the work in this process and in its children, which have ended then [s]."""
    before = sum(os.times()[:4])
    work()
    return sum(os.times()[:4]) - before


if __name__ == "__main__":
    run()

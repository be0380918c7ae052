"""Error against driven metres: `tour` under budgets, beside the paper's `rrtstar` and, if installed, SGP-Tools.

Every mission takes 150 samples from the same start with the same noise, and is scored on all cells with the same
Gaussian process; where SGP-Tools is there, each is scored with the peers' own process, too (`rmse_own_gp_ppb`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.flights import (
    OVER_SEEDS,
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
from benchmarks.missions import Mission, Row
from benchmarks.tasks import Tasks, progress
from he3.errors import InvalidInput
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB

BUDGETS_M = (3500.0, 4500.0, 6000.0, 9000.0, 15000.0)
PEER_BUDGETS_M = (3500.0, 4500.0, 6000.0)


def run(
    seeds: int = 5,
    regions: Sequence[str] = ("t1", "t2"),
    region: Path | None = None,
    budgets: Sequence[float] = BUDGETS_M,
    kernel: str = "smooth+rough",
    jobs: int = 2,
    engine: str = "local",
    store: Path | None = None,
    peers: bool = True,
    noise: float = DEFAULT_NOISE_STD_PPB,
    start: Sequence[float] = (),
    json: Path | None = None,
    out: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row a mission; the table printed, the frontier drawn into `out`, rows written to `json`.

    regions: embedded names; region: a field as .npz in their place; peers: also run SGP-Tools, once per budget and
    region. noise: standard deviation [ppb]; start: X,Y [m]. engine, store: as `he3 campaign run` takes them; with a
    store, a run that was ended goes on. Raises InvalidInput for numbers that do not fit.
    """
    if seeds < 1 or not budgets or not all(budget > 0 for budget in budgets) or not (regions or region):
        raise InvalidInput(
            f"expected one seed and region at least and positive budgets, got {seeds}, {regions} and {tuple(budgets)}"
        )
    names = [str(region)] if region is not None else list(regions)
    shared = conditions(noise, start, None)
    for name in names:
        expect_open(region_named(name), shared.start_m)
    flights = [Flight(name, "tour", kernel, seed, budget_m=budget) for name in names for budget in budgets
               for seed in range(1, seeds + 1)]  # fmt: skip
    flights += [Flight(name, "rrtstar", "matern52", seed) for name in names for seed in range(1, seeds + 1)]
    with Tasks(jobs, engine, store) as pool:
        missions, failures = flown([shared.on(flight) for flight in flights], pool)
        peer_rows = _peer_rows(missions, pool, say) if peers else []
        rows = [mission.row for mission in missions.values()] + peer_rows
        for name in names:
            say("")
            for line in table(rows, region_named(name).name):
                say(line)
        written(rows, json, say, pool)
    if out is not None:
        from benchmarks.figures import frontier_figure

        curves = {name: _curves(rows, region_named(name).name) for name in names}
        say(f"written {frontier_figure(curves, {}, out / 'frontier.png')}")
    expect_none(failures)
    return rows


def _peer_rows(missions: dict[Flight, Mission], pool: Tasks, say: Callable[[str], None]) -> list[Row]:
    """SGP-Tools' rows, one for each `tour` with one of its budgets, whose row gets `rmse_own_gp_ppb`."""
    from benchmarks.peer_environments import SGPTOOLS

    try:
        SGPTOOLS.python()
    except InvalidInput as error:
        say(f"without SGP-Tools: {error}")
        return []
    asked = [one for one in missions.items() if one[0].planner == "tour" and one[0].budget_m in PEER_BUDGETS_M]
    rows = {}
    for (flight, mission), (row, own_gp_ppb) in pool.results(_fly_peer, asked):
        mission.row["rmse_own_gp_ppb"] = own_gp_ppb
        rows[flight] = row
        progress(
            f"  {flight.region:<4} sgptools  budget {flight.budget_m:.0f} m  seed {flight.seed}  "
            f"rmse {row['rmse_ppb']:.4f} ppb  {row['path_length_m']:.0f} m  "
            f"{row['blocked_legs']} legs led around obstacles"
        )
    return [rows[flight] for flight, _ in asked if flight in rows]


def _fly_peer(task: tuple[Flight, Mission]) -> tuple[Row, float]:
    """SGP-Tools' row beside that mission, and the RMSE [ppb] of that mission under the peers' Gaussian process."""
    from benchmarks.sgptools_peer import fly_sgptools, own_gp_rmse

    flight, ours = task
    region = region_named(flight.region)
    row = fly_sgptools(
        region, ours, flight.kernel, flight.seed, flight.budget_m, flight.noise_std_ppb, flight.start_m
    ).row
    return row, own_gp_rmse(region, ours)


def _groups(rows: Sequence[Row], region: str) -> dict[tuple[str, float], list[Row]]:
    groups: dict[tuple[str, float], list[Row]] = {}
    for row in rows:
        if row["region"] == region:
            groups.setdefault((row["planner"], row["budget_m"] or float("inf")), []).append(row)
    return dict(sorted(groups.items()))


def table(rows: Sequence[Row], region: str) -> list[str]:
    """Lines of the frontier on one region."""
    head = f"{'planner':<10} {'budget m':>9} {'metres':>14} {'RMSE ppb':>17} {'own GP':>8} {'plan s':>8}"
    lines = [region, head, "-" * len(head)]
    for (planner, budget), group in _groups(rows, region).items():
        own = [row for row in group if "rmse_own_gp_ppb" in row]
        shown = f"{mean_and_std(own, 'rmse_own_gp_ppb')[0]:8.4f}" if own else f"{'':>8}"
        lines.append(
            f"{planner:<10} {budget:9.0f} {mean_over_seeds(group, 'path_length_m', 0, 3)} "
            f"{mean_over_seeds(group, 'rmse_ppb', 4, 6)} {shown} "
            f"{mean_and_std(group, 'plan_time_s')[0]:8.1f}"
        )
    return [*lines, OVER_SEEDS]


def _curves(rows: Sequence[Row], region: str) -> dict[str, list[tuple[float, float, float]]]:
    curves: dict[str, list[tuple[float, float, float]]] = {}
    for (planner, _), group in _groups(rows, region).items():
        metres = mean_and_std(group, "path_length_m")[0]
        curves.setdefault(planner, []).append((metres, *mean_and_std(group, "rmse_ppb")))
    return curves

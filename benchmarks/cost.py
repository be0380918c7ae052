"""What legs cost: missions on real places that keep their metres low beside such that keep their energy or time low.

The same mission is flown once for each cost: the same place, seed and number of samples. Energy is what the rover
draws in motion, its base load included; `motion` is what of it goes into traction and climbing. Hours are those in
motion. All are of the rover's own model on the path driven. `steepest` is the steepest cell on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks import kept
from benchmarks.data_folder import expect_rasters
from benchmarks.flights import DEFAULT_NOISE_STD_PPB, Conditions, conditions
from benchmarks.places import PLACES, SIZES, Row, files_of, fly
from benchmarks.tasks import Tasks, progress
from he3.driving_cost import UNITS
from he3.errors import He3Error, InvalidInput


def run(
    data: Path | None = None,
    places: Sequence[str] = ("apollo-17", "aristarchus-imp"),
    size: str = "own",
    planners: Sequence[str] = ("tour",),
    costs: Sequence[str] = ("distance", "energy"),
    rounds: int = 30,
    seed: int = 1,
    noise: float = DEFAULT_NOISE_STD_PPB,
    hyperparameters: str = "ml",
    jobs: int = 1,
    out: Path | None = None,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row a mission, in the order of places, planners and costs; rows are written to `json`, reports to `out`.

    data: folder with the rasters. Raises InvalidInput for names that are not known and rasters that are missing;
    He3Error, after the table, if a mission missed samples or led over ground that is too steep.
    """
    for given, known in ((places, tuple(PLACES)), ((size,), SIZES), (costs, tuple(UNITS))):
        for name in given:
            if name not in known:
                raise InvalidInput(f"expected names out of {', '.join(known)}, got {name!r}")
    data = expect_rasters(data, "docs/regions.md", files_of(places))
    shared = conditions(noise, (), None)
    rows: list[Row] = []
    with TemporaryDirectory() as scratch:
        root = Path(scratch) if out is None else out
        flights = [
            (data, root, place, size, planner, rounds, seed, shared, cost, hyperparameters, "smooth+rough")
            for place in places
            for planner in planners
            for cost in costs
        ]
        with Tasks(jobs) as pool:
            for flight, row in pool.results(_flown, flights):
                rows.append(row)
                progress(f"  {len(rows):>3}/{len(flights)}  {flight[2]} {flight[4]} {flight[8]}")
    order = [(flight[2], flight[4], flight[8]) for flight in flights]
    rows.sort(key=lambda row: order.index((row["place"], row["planner"], row["cost"])))
    for line in table(rows):
        say(line)
    kept.write_whole(json, rows)
    problems = [f"{row['place']} {row['planner']} {row['cost']}: {row['problem']}" for row in rows if row["problem"]]
    if problems:
        raise He3Error(f"{len(problems)} of the missions failed, the first: {problems[0]}")
    return rows


def _flown(flight: tuple[Path, Path, str, str, str, int, int, Conditions, str, str]) -> Row:
    return fly(*flight)


def table(rows: Sequence[Row]) -> list[str]:
    """The rows as aligned lines; in each place and planner, what differs from the first cost in per cent."""
    head = (
        f"{'place':<16} {'planner':<12} {'cost':<9} {'samples':>7} {'RMSE ppb':>9} {'driven m':>9} {'hours':>7} "
        f"{'Wh':>8} {'motion Wh':>11} {'Wh/m':>7} {'rises m':>8} {'steepest':>9}  {'energy':>7} {'RMSE':>7}"
    )
    lines = [head, "-" * len(head)]
    first: dict[tuple[str, str], Row] = {}
    for row in rows:
        base = first.setdefault((row["place"], row["planner"]), row)
        lines.append(_line(row, base))
    return lines


def _line(row: Row, base: Row) -> str:
    driving = row["driving"]
    compared = "" if row is base else (
        f"  {driving['energy_wh'] / base['driving']['energy_wh'] - 1:>+7.1%} "
        f"{row['rmse_ppb'] / base['rmse_ppb'] - 1:>+7.1%}"
    )  # fmt: skip
    return (
        f"{row['place']:<16} {row['planner']:<12} {row['cost']:<9} {row['samples']:>7} {row['rmse_ppb']:>9.4f} "
        f"{row['path_length_m']:>9.0f} {driving['duration_h']:>7.1f} {driving['energy_wh']:>8.0f} "
        f"{driving['motion_wh']:>11.0f} {driving['energy_wh'] / row['path_length_m']:>7.4f} {driving['climb_m']:>8.0f} "
        f"{driving['steepest_deg']:>8.2f}°{compared}"
    )

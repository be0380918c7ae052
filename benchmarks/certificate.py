"""The metres to a certificate: our tours, a greedy cover and SGP-Tools' coverage planners; and what it is worth.

On every field of the exam, and for several shares of the prior variance, all planners design a tour after which the
joint posterior variance is at most that share at every target: the same kernel, noise, start and obstacles. `x` is the
metres of `tour` over those of the best other one. `loosened` are SGP-Tools' planners with the laxest of some thresholds
after which the certificate holds, which the library does not look for.

With --missions N, so many small missions are flown until their goal is certified. A promise is kept when the share of
the field that the certificate names does lie as near to the map as it says. SGP-Tools needs an environment of its own
(benchmarks/peers/requirements.txt); without it its rows are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import kept, promises
from benchmarks.covers import PEERS, CoverTask, Row, rows_of
from benchmarks.exam_fields import load_field, names_in
from benchmarks.peer_environments import SGPTOOLS_COVERS
from benchmarks.promises import Promise
from benchmarks.tasks import Tasks, progress
from he3.errors import InvalidInput
from services.console.campaign.identity import checksum_of

OURS = "tour"
OURS_AND_GREEDY = (OURS, "greedy")
_Asked = tuple[str, Path | None, tuple[float, ...], int, tuple[str, ...]]


def run(
    data: Path | None = None,
    fields: Sequence[str] = (),
    ratios: Sequence[float] = (0.9, 0.8, 0.7, 0.6, 0.5),
    peers: Sequence[str] = PEERS,
    seed: int = 1,
    missions: int = 0,
    planner: str = OURS,
    share: float = 0.8,
    blocks: float | None = None,
    probability: float = 0.95,
    rounds: int = 30,
    jobs: int = 1,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> dict[str, list[Row]]:
    """Rows of designs and of missions; the tables printed, the rows added to `json` as they come.

    data: folder with the exam's rasters; fields: some of them, by name; ratios: shares of the prior variance, none for
    missions alone; peers: of HexCover, GreedyCover and GCBCover; missions: how many are flown, with this planner,
    towards a std of that share of the field's, everywhere or for blocks of so many metres, in at most so many rounds
    of 5.
    What the file has already of the same run is not computed again. Raises InvalidInput for names that are not known,
    and for a file of anything else.
    """
    known = names_in(data)
    chosen = list(fields) or known
    for given, among in ((chosen, known), (peers, PEERS)):
        if unknown := [name for name in given if name not in among]:
            raise InvalidInput(f"expected names among {', '.join(among)}; got {', '.join(unknown)}")
    if not all(0.0 < ratio < 1.0 for ratio in (*ratios, share)):
        raise InvalidInput(f"expected ratios and a share between 0 and 1, got {', '.join(map(str, (*ratios, share)))}")
    if peers and not SGPTOOLS_COVERS.installed:
        say("SGP-Tools: not installed, its planners are left out")
        peers = ()
    document = kept.read(json, "designs", "missions")
    kept.expect_fields(json, document, {name: checksum_of(load_field(name, data).region) for name in chosen})
    designs: list[Row] = document["designs"]
    flown: list[Row] = document["missions"]
    asked: list[_Asked] = []
    for name in chosen:
        left = tuple(ratio for ratio in ratios if not _designed(designs, (name, ratio, seed), peers))
        if left:
            asked.append((name, data, left, seed, tuple(peers)))
    flights = [
        Promise(data, chosen[k % len(chosen)], seed + k, planner, share, blocks, probability, rounds)
        for k in range(missions)
    ]
    have = {promises.identity(row) for row in flown}
    with Tasks(jobs) as pool:
        for task, rows in pool.results(_designs, asked):
            computed = {_design(row) for row in rows}
            designs[:] = [row for row in designs if _design(row) not in computed] + rows
            kept.write(json, document)
            progress(f"  {task[0]}: {len(rows)} designs")
        for flight, row in pool.results(promises.fly, [one for one in flights if one.identity not in have]):
            flown.append(row)
            kept.write(json, document)
            progress(f"  {len(flown):>3} missions, the last on {flight.field}")
    wanted, mine = {(name, ratio, seed) for name in chosen for ratio in ratios}, {one.identity for one in flights}
    found = {
        "designs": [row for row in designs if _design(row) in wanted],
        "missions": [row for row in flown if promises.identity(row) in mine],
    }
    for line in (*table(found["designs"]), *promise_table(found["missions"])):
        say(line)
    return found


def _designs(asked: _Asked) -> list[Row]:
    name, data, ratios, seed, peers = asked
    return rows_of(CoverTask(load_field(name, data), seed), ratios, peers)


def _design(row: Row) -> tuple[Any, ...]:
    """What a row's design was made for."""
    return row["field"], row["ratio"], row["seed"]


def _designed(rows: Sequence[Row], design: tuple[str, float, int], peers: Sequence[str]) -> bool:
    """Whether the rows have all of that field, ratio and seed."""
    return {*OURS_AND_GREEDY, *peers} <= {row["method"] for row in rows if _design(row) == design}


def table(rows: Sequence[Row]) -> list[str]:
    """Lines with the metres of each planner, by field and ratio, and those of ours over the best other one's."""
    if not rows:
        return []
    methods = list(dict.fromkeys(row["method"] for row in rows))
    head = (
        f"{'field':<16} {'ratio':>5} " + " ".join(f"{name:>20}" for name in methods) + f" {'x':>6} {'x loosened':>10}"
    )
    lines = [head, "-" * len(head)]
    plain, loosened = [], []
    for key in dict.fromkeys((row["field"], row["ratio"]) for row in rows):
        cells = {row["method"]: row for row in rows if (row["field"], row["ratio"]) == key}
        against = compared(cells, False), compared(cells, True)
        plain += [against[0]] if against[0] is not None else []
        loosened += [against[1]] if against[1] is not None else []
        shown = " ".join(f"{_cell(cells.get(name)):>20}" for name in methods)
        lines.append(f"{key[0]:<16} {key[1]:>5.2f} {shown} {_ratio(against[0]):>6} {_ratio(against[1]):>10}")
    for name, found in (("the planners as they are", plain), ("loosened ones, too", loosened)):
        if found:
            lines.append(f"mean of x against {name}: {np.mean(found):.3f} over {len(found)}, at most {max(found):.3f}")
    ours = [row for row in rows if row["method"] == OURS]
    if failed := sum(not row["holds"] or row["metres"] is None for row in ours):
        lines.append(
            f"{OURS} has no tour with a certificate in {failed} of {len(ours)} cases, which the means leave out"
        )
    return [*lines, "metres (samples); '!': the certificate does not hold"]


def compared(cells: dict[str, Row], loosened: bool) -> float | None:
    """Metres of ours over those of the best other planner whose certificate holds; None if one of both is missing."""
    others = [
        row["metres"] for name, row in cells.items()
        if name != OURS and row["holds"] and row["metres"] and (loosened or "loosened" not in name)
    ]  # fmt: skip
    ours = cells.get(OURS)
    if ours is None or not ours["holds"] or not ours["metres"] or not others:
        return None
    return float(ours["metres"] / min(others))


def _cell(row: Row | None) -> str:
    if row is None or row["metres"] is None:
        return "-"
    return f"{row['metres']:,.0f} ({row['samples']}){'' if row['holds'] else '!'}"


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def promise_table(rows: Sequence[Row]) -> list[str]:
    """Lines on the missions: how many reached their goal, and how many of these kept the promise."""
    if not rows:
        return []
    head = (
        f"{'missions on':<16} {'flown':>5} {'reached':>7} {'kept':>5} {'least within':>12} {'samples':>8} {'metres':>8}"
    )
    lines = [head, "-" * len(head)]
    for name in (*dict.fromkeys(row["field"] for row in rows), None):
        group = [row for row in rows if name in (None, row["field"])]
        reached = [row for row in group if row["reached"]]
        least = f"{min(row['within'] for row in reached):.1%}" if reached else "-"
        samples, metres = (
            np.mean([row[key] for row in reached]) if reached else np.nan for key in ("samples", "metres")
        )
        lines.append(
            f"{name or 'all':<16} {len(group):>5} {len(reached):>7} {sum(row['kept'] for row in reached):>5} "
            f"{least:>12} {samples:>8.1f} {metres:>8,.0f}"
        )
    return lines

"""What a rehearsal foretells, held against the mission that then goes on, and what the rehearsal costs.

Each mission is flown in this process, with a seed of its own, up to a number of samples. There it is rehearsed, and
then it goes on to its end: its metres, hours and mean standard deviation from there on lie in the rehearsal's bands or
do not. A band of 95 % is to hold them in at least 17 of 20 missions. The mission's map has as few cells as that of a
rehearsal, which changes its mean standard deviation by some thousandths and, with `tour`, nothing else.

    wall_s       wall time of all draws of one rehearsal [s]
    cpu_s        processor time of the rehearsal, its child processes and their start included [s]
    cpu_draw_s   processor time of one further draw, in a process that has started [s]
    low_95 .. high_95, median, real     of each figure, per mission
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import os
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import kept
from he3.errors import InvalidInput
from schemas.commands import NoParameters
from schemas.ground import MissionPhase
from schemas.topics import FORK, LINK_SHOW, LIST_COMMANDS
from services.console.launch.scenarios import choose
from services.console.rehearsal.flight import MAP_CELLS, Start, fly
from services.console.rehearsal.forecast import rehearse
from services.ground.belief import Belief
from services.ground.node import build_node as build_ground
from services.ground.pure_tasks import MissionExecutor
from services.mission.in_process import InProcessMission, build_nodes
from services.mission.mission_time import SECOND
from services.mission.regions import load_region
from services.runtime.scheduler import Executor

FIGURES = {"driven_m": "driven", "lasts_s": "lasts", "mean_std_ppb": "mean std"}
Row = dict[str, Any]


def run(
    scenario: str = "t1",
    missions: int = 20,
    draws: int = 20,
    samples: int = 75,
    seed: int = 1,
    processes: int | None = None,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> Row:
    """All rows and the counts. samples: in the map when the mission is rehearsed. seed: of the first mission.

    json: the file that has the rows. Those that it has already are not flown again, so a run that was stopped goes on.
    Raises InvalidInput unless there is a mission, and one that has more samples, and for a file of another run.
    """
    first = choose(scenario, seed=seed).scenario
    if missions < 1 or not 0 < samples < first.samples:
        raise InvalidInput(f"expected a mission and 1 to {first.samples - 1} samples, got {missions} and {samples}")
    what: Row = {"scenario": scenario, "samples": samples, "draws": draws}
    known = {row["seed"]: row for row in _known(json, what)}
    say(f"{scenario} from sample {samples} of {first.samples}, {draws} draws")
    say(f"{'seed':>4} {'wall':>7} {'cpu':>7} {'draw':>6}" + "".join(f"{name:>36}" for name in FIGURES.values()))
    with closing(MissionExecutor()) as executor:
        for number in range(seed, seed + missions):
            if number not in known:
                known[number] = _row(scenario, number, samples, draws, processes, executor)
                kept.write(json, {**what, "rows": list(known.values())})
            say(_line(known[number]))
    rows = [known[number] for number in range(seed, seed + missions)]
    inside = {
        level: {name: sum(row[name][f"in_{level}"] for row in rows) for name in FIGURES} for level in ("68", "95")
    }
    for level, counts in inside.items():
        say(f"in the {level} % band: " + ", ".join(f"{FIGURES[name]} {counts[name]} of {missions}" for name in FIGURES))
    kept.write(json, {**what, "inside": inside, "rows": list(known.values())})
    return {**what, "inside": inside, "rows": rows}


def _known(path: Path | None, what: Row) -> list[Row]:
    """The rows that the file has; none without the file. Raises InvalidInput for one of another run."""
    if path is None or not path.exists():
        return []
    document = kept.read(path, "rows")
    other = {name: document.get(name) for name in what}
    if other != what or not all(isinstance(row.get("seed"), int) for row in document["rows"]):
        raise InvalidInput(f"{path}: expected the rows of {what}, got those of {other}")
    return list(document["rows"])


def _row(scenario: str, seed: int, samples: int, draws: int, processes: int | None, executor: Executor) -> Row:
    chosen = choose(scenario, seed=seed).scenario
    region = load_region(chosen.region, chosen.field.field_seed)
    ground = build_ground(chosen, region, make_belief=partial(Belief, most_cells=MAP_CELLS))
    live = InProcessMission(chosen, executor, nodes=(*build_nodes(chosen, region)[:-1], ground))
    while live.status is None or live.status.samples < samples:
        live.simulation.step()
    under_way = tuple(each.command for each in live.ask(LIST_COMMANDS, NoParameters()).commands if each.end is None)
    start = Start(live.ask(FORK, NoParameters()), live.ask(LINK_SHOW, NoParameters()), under_way)
    before_s, began_s = _processor_s(), time.monotonic()
    (forecast,) = rehearse(start, draws, processes=processes)
    wall_s, cpu_s = time.monotonic() - began_s, _processor_s() - before_s
    fly(start, region, 0, executor)
    before_s = _processor_s()
    fly(start, region, 1, executor)
    draw_s = _processor_s() - before_s
    phase = live.run()
    assert live.status is not None
    driven_m = 0.0 if start.fork.rover is None else start.fork.rover.driven_m
    real = {
        "driven_m": live.status.driven_m - driven_m,
        "lasts_s": (live.simulation.now - start.fork.at) / SECOND,
        "mean_std_ppb": live.status.mean_std_ppb or 0.0,
    }
    row: Row = {
        "seed": seed, "completed": phase is MissionPhase.COMPLETED, "wall_s": wall_s, "cpu_s": cpu_s,
        "cpu_draw_s": draw_s,
    }  # fmt: skip
    for name, value in real.items():
        band = forecast.band(name)
        row[name] = {
            "real": value,
            "median": band.median,
            "low_95": band.low_95,
            "high_95": band.high_95,
            "in_68": band.low_68 <= value <= band.high_68,
            "in_95": band.low_95 <= value <= band.high_95,
        }
    return row


def _line(row: Row) -> str:
    shown = f"{row['seed']:>4} {row['wall_s']:>5.1f} s {row['cpu_s']:>5.1f} s {row['cpu_draw_s']:>4.2f} s"
    for name in FIGURES:
        each, unit = row[name], 1.0 / 3600.0 if name == "lasts_s" else 1.0
        digits = 4 if name == "mean_std_ppb" else 1
        low, real, high = (f"{each[key] * unit:.{digits}f}" for key in ("low_95", "real", "high_95"))
        shown += f"{f'{low} < {real} < {high}' + ('' if each['in_95'] else ' OUT'):>36}"
    return shown


def _processor_s() -> float:
    """Processor time of this process and of its children that have ended [s]."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


if __name__ == "__main__":
    run()

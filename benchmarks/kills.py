"""Real processes, real `kill -9`: rover, ground, link and field in turn, at random instants of short missions.

Each killed process is started again at once. A mission must come to its end with all samples in the map exactly once,
none reported under two numbers, and the map unchanged to the byte by one more restart of the ground.

    restart_s   from the start of the new process until it takes part again: read code, region and journal, joined both
                networks, knows the time; median and maximum over all kills
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import random
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks import kept
from benchmarks.journalled_mission import SERVICES, JournalledMission
from he3.errors import He3Error, InvalidInput

LATEST_S = 1.5
"""The next kill comes within this time of the last restart [s]."""

Row = dict[str, Any]


def run(
    kills: int = 20,
    rounds: int = 8,
    rate: float = 1000.0,
    seed: int = 1,
    within: float = 600.0,
    settings: Sequence[str] = (),
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> Row:
    """Kill each of the four services that many times, over as many missions as needed; returns the counts.

    within: seconds of wall time that one mission may take. settings: other values of the scenario, as for ``--set``.
    Raises He3Error when a sample was lost or doubled, a mission was stuck, or a restart changed the map.
    """
    if kills < 1 or rounds < 1:
        raise InvalidInput(f"expected one kill and one round at least, got {kills} and {rounds}")
    dice = random.Random(seed)
    left = [name for _ in range(kills) for name in SERVICES]
    restarts: list[tuple[str, float]] = []
    row: Row = {"missions": 0, "kills": 0, "samples": 0, "lost": 0, "doubled": 0, "unequal": 0}
    while left:
        row["missions"] += 1
        changes = [f"rounds={rounds}", f"seed={seed + row['missions']}", f"rate={rate}", *settings]
        with (
            tempfile.TemporaryDirectory(prefix="he3-kills-") as folder,
            JournalledMission(Path(folder), changes) as mission,
        ):
            before = len(restarts)
            while left and not mission.over:
                time.sleep(dice.uniform(0.0, LATEST_S))
                name = left.pop(0)
                restarts.append((name, mission.restart(name)))
            mission.wait_until_over(within)
            lost, doubled, unequal = mission.judged()
        row["kills"] = len(restarts)
        row["samples"] += mission.scenario.samples
        row["lost"] += lost
        row["doubled"] += doubled
        row["unequal"] += unequal
        say(
            f"mission {row['missions']}: {len(restarts) - before} kills, {mission.scenario.samples} samples, "
            f"{lost} lost, {doubled} doubled, map {'differs' if unequal else 'the same'} after a restart"
        )
    row["restart_s"] = statistics.median(seconds for _, seconds in restarts)
    row["worst_restart_s"] = max(seconds for _, seconds in restarts)
    for name in SERVICES:
        times = [seconds for who, seconds in restarts if who == name]
        row[f"restart_{name}_s"] = statistics.median(times)
        say(
            f"{name:<7} killed {len(times)} times, back after {statistics.median(times):.2f} s, "
            f"worst {max(times):.2f} s"
        )
    kept.write_whole(json, row)
    if row["lost"] or row["doubled"] or row["unequal"]:
        raise He3Error(f"{row['lost']} lost, {row['doubled']} doubled, {row['unequal']} unequal of {row['missions']}")
    return row


if __name__ == "__main__":
    run()

"""Short missions in real processes, each under a random schedule of machine faults.

    kill    a process dies as in a power failure (SIGKILL), and is started again
    stop    a process is frozen for a while (SIGSTOP), as on a machine that swaps or is suspended
    clock   the machine's wall clock is stepped forwards or back (by libfaketime, where it is installed)
    disk    a process can write no more (its file size is limited); then there is room again

A process that cannot keep what it has accepted must end and say why; it is started again when there is room. The
recorder must continue for any fault of its disk. At the end all samples are in the map exactly once, none was reported
under two numbers, the map is the same to the byte after one more restart of the ground, and every process that ended by
itself explained it in one line.
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import json as json_format
import random
import resource
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from benchmarks.journalled_mission import RECORDER, SERVICES, JournalledMission
from he3.errors import He3Error, InvalidInput

FAKETIME = (
    Path("/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1"),
    Path("/usr/lib/aarch64-linux-gnu/faketime/libfaketime.so.1"),
    Path("/usr/lib/faketime/libfaketime.so.1"),
)
"""Paths of libfaketime on Debian and other systems."""
MAX_EVENTS = 4
MAX_PAUSE_S = 1.5
MAX_STOP_S = 4.0
FULL_S = 1.0
"""How long a disk stays full [s of wall time]."""

Row = dict[str, Any]


class Kind(StrEnum):
    KILL = "kill"
    STOP = "stop"
    CLOCK = "clock"
    DISK = "disk"


@dataclass(frozen=True, slots=True)
class Mishap:
    """One fault: its kind, its process, the delay after the fault before [s], and its duration or amount [s]."""

    kind: Kind
    name: str
    after_s: float
    amount_s: float


def schedule(dice: random.Random, kinds: Sequence[Kind]) -> list[Mishap]:
    """One random schedule of one to four mishaps."""
    mishaps = []
    for _ in range(dice.randint(1, MAX_EVENTS)):
        kind = dice.choice(list(kinds))
        name = dice.choice((*SERVICES, RECORDER)) if kind is not Kind.CLOCK else "machine"
        amount = (
            dice.uniform(0.2, MAX_STOP_S)
            if kind is Kind.STOP
            else dice.choice((-3600.0, -40.0, -2.0, 2.0, 40.0, 86400.0))
        )
        mishaps.append(Mishap(kind, name, dice.uniform(0.0, MAX_PAUSE_S), amount))
    return mishaps


def run(
    schedules: int = 200,
    seed: int = 1,
    rounds: int = 3,
    rate: float = 1000.0,
    within: float = 900.0,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> Row:
    """Run one mission per schedule; returns the counts of faults and failures.

    within: seconds of wall time after which a mission counts as stuck. Raises He3Error when anything went wrong.
    """
    if schedules < 1 or rounds < 1:
        raise InvalidInput(f"expected one schedule and one round at least, got {schedules} and {rounds}")
    library = next((path for path in FAKETIME if path.exists()), None)
    kinds = [kind for kind in Kind if kind is not Kind.CLOCK or library is not None]
    if library is None:
        say("the wall clock is not stepped: libfaketime is not installed")
    row: Row = {"schedules": 0, "samples": 0, "lost": 0, "doubled": 0, "unequal": 0, "stuck": 0, "unexplained": 0}
    happened: Counter[str] = Counter()
    failures = []
    for number in range(schedules):
        mishaps = schedule(random.Random(f"chaos:{seed}:{number}"), kinds)
        happened.update(mishap.kind.value for mishap in mishaps)
        outcome = fly(mishaps, [f"rounds={rounds}", f"seed={seed + number}", f"rate={rate}"], within, library)
        row["schedules"] += 1
        for key, value in outcome.items():
            if key in row:
                row[key] += value
        wrong = {key: value for key, value in outcome.items() if value and key not in ("samples", "why")}
        if wrong:
            failures.append({"schedule": number, "mishaps": [str(mishap) for mishap in mishaps], **outcome})
            say(f"schedule {number}: {wrong}: {outcome.get('why', '')}\n  {mishaps}")
        elif (number + 1) % 10 == 0:
            say(f"{number + 1} of {schedules} schedules, {len(failures)} failed")
        if json is not None:
            json.write_text(json_format.dumps({**row, **happened, "failures": failures}, indent=2) + "\n")
    say(
        f"{row['schedules']} schedules ({', '.join(f'{count} {kind}' for kind, count in sorted(happened.items()))}), "
        f"{row['samples']} samples: {row['lost']} lost, {row['doubled']} doubled, {row['unequal']} maps unequal, "
        f"{row['stuck']} stuck, {row['unexplained']} ends unexplained"
    )
    if failures:
        raise He3Error(f"chaos: {len(failures)} of {schedules} schedules went wrong")
    return {**row, **happened}


def fly(mishaps: Sequence[Mishap], settings: Sequence[str], within: float, library: Path | None) -> Row:
    """The outcome of one mission under that schedule."""
    with tempfile.TemporaryDirectory(prefix="he3-chaos-") as name:
        folder = Path(name)
        clock = folder / "clock-offset"
        clock.write_text("+0\n")
        environment = {}
        if library is not None:
            environment = {
                "LD_PRELOAD": str(library), "FAKETIME_TIMESTAMP_FILE": str(clock), "FAKETIME_NO_CACHE": "1",
                "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            }  # fmt: skip
        outcome: Row = {"samples": 0, "lost": 0, "doubled": 0, "unequal": 0, "stuck": 0, "unexplained": 0}
        try:
            with JournalledMission(folder, settings, recorder=True, environment=environment) as mission:
                outcome["samples"] = mission.scenario.samples
                for mishap in mishaps:
                    time.sleep(mishap.after_s)
                    outcome["unexplained"] += _befall(mission, mishap, clock)
                outcome["unexplained"] += _tend(mission, within)
                outcome["lost"], outcome["doubled"], outcome["unequal"] = mission.judged()
        except He3Error as error:
            outcome["stuck"] = 1
            outcome["why"] = str(error)
    return outcome


def _befall(mission: JournalledMission, mishap: Mishap, clock: Path) -> int:
    """Cause the fault; returns how many processes ended without an explanation."""
    match mishap.kind:
        case Kind.CLOCK:
            clock.write_text(f"{mishap.amount_s:+.0f}\n")
            return 0
        case Kind.KILL:
            unexplained = _revived(mission, mishap.name)
            mission.restart(mishap.name)
            return unexplained
        case Kind.STOP:
            process = mission.process(mishap.name)
            process.send_signal(signal.SIGSTOP)
            time.sleep(mishap.amount_s)
            process.send_signal(signal.SIGCONT)
            return 0
        case Kind.DISK:
            return _fill_the_disk(mission, mishap.name)


def _fill_the_disk(mission: JournalledMission, name: str) -> int:
    process = mission.process(name)
    if process.poll() is not None:
        return _revived(mission, name)
    _, most = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (1, most))
    time.sleep(FULL_S)
    if process.poll() is not None:
        return _revived(mission, name)
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (most, most))
    return 0


def _revived(mission: JournalledMission, name: str) -> int:
    """Start that process again if it has ended; returns 1 if its last line gave no reason, else 0."""
    if mission.process(name).poll() is None:
        return 0
    last = mission.last_words(name)
    mission.start_again(name)
    return 0 if last.startswith("he3 ") and "defect" not in last else 1


def _tend(mission: JournalledMission, within_s: float) -> int:
    """Restart processes that end by themselves until the mission is over; returns how many gave no reason."""
    deadline = time.monotonic() + within_s
    unexplained = 0
    while not mission.over:
        for name in mission.names:
            unexplained += _revived(mission, name)
        if time.monotonic() > deadline:
            mission.wait_until_over(0.0)
        time.sleep(0.05)
    return unexplained


if __name__ == "__main__":
    run()

"""Short missions in real processes, each under a random schedule of what happens to machines in the field.

    kill    a process dies as in a power failure (SIGKILL), and is started again
    stop    a process is frozen for a while (SIGSTOP), as on a machine that swaps or is suspended
    clock   the machine's wall clock is stepped forwards or back (where there is a C compiler)
    disk    a process can write no more (the size of its files is limited); then there is room again

A process that cannot keep what it has accepted must end and say why; it is started again when there is room. The
recorder must go on whatever its disk does. What is counted as wrong:

    lost         a planned sample that is not in the map, or one that came down and is not in the map
    doubled      a sample that is twice in the map, or that was reported under two numbers
    unrecorded   a sample in the map that is in no recording although the recorder was never killed, and a recording
                 that is damaged although no schedule damaged it
    unequal      the map is not the same to the byte after one more restart of the ground
    stuck        the mission did not come to its end
    unexplained  a process that ended by itself, unless its disk was full and its last line says so; a traceback
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import random
import resource
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import kept
from benchmarks.journalled_mission import RECORDER, SERVICES, JournalledMission, judged_samples
from benchmarks.tasks import Tasks, progress
from benchmarks.wall_clock import WallClock, compiled
from he3.errors import He3Error, InvalidInput
from services.mission.processes import LINK

MAX_EVENTS = 4
MAX_PAUSE_S = 1.5
MAX_STOP_S = 4.0
MAX_ROOM_BYTES = 600
"""What a disk takes before it is full: less than a record, or a few."""
STEPS_S = (-3600.0, -40.0, -2.0, 2.0, 40.0, 86400.0)
FULL_S = 1.0
"""How long a disk stays full, from the first byte that it does not take."""
FILLS_WITHIN_S = 30.0
"""A process that writes less than the room in this time goes on with what it has."""
LINK_WRITES_WITHIN_S = 6.0
"""The link saves its clock every five seconds, in a file that is replaced."""
WRONG = ("lost", "doubled", "unrecorded", "unequal", "stuck", "unexplained")
JOURNALS = ("rover", "ground")

Row = dict[str, Any]


class Kind(StrEnum):
    KILL = "kill"
    STOP = "stop"
    CLOCK = "clock"
    DISK = "disk"


@dataclass(frozen=True, slots=True)
class Mishap:
    """What happens, to whom, how long after the one before it [s], and for how long [s] or by how much [s, bytes]."""

    kind: Kind
    name: str
    after_s: float
    amount: float

    def __str__(self) -> str:
        return f"{self.after_s:.1f} s {self.kind} {self.name} {self.amount:g}"


@dataclass(slots=True)
class Outcome:
    """What came of one mission."""

    number: int
    mishaps: tuple[Mishap, ...]
    samples: int = 0
    ends: int = 0
    """Processes that ended by themselves because their disk was full, and said so."""
    lost: int = 0
    doubled: int = 0
    unrecorded: int = 0
    unequal: int = 0
    stuck: int = 0
    unexplained: int = 0
    wall_s: float = 0.0
    why: list[str] = field(default_factory=list)

    @property
    def failed(self) -> bool:
        return any(getattr(self, name) for name in WRONG)


def schedule(dice: random.Random, kinds: Sequence[Kind]) -> tuple[Mishap, ...]:
    """One random schedule of one to four mishaps."""
    mishaps = []
    for _ in range(dice.randint(1, MAX_EVENTS)):
        kind = dice.choice(list(kinds))
        name = dice.choice((*SERVICES, RECORDER)) if kind is not Kind.CLOCK else "machine"
        amounts = {
            Kind.KILL: 0.0,
            Kind.STOP: round(dice.uniform(0.2, MAX_STOP_S), 3),
            Kind.CLOCK: dice.choice(STEPS_S),
            Kind.DISK: float(dice.randint(0, MAX_ROOM_BYTES)),
        }
        mishaps.append(Mishap(kind, name, round(dice.uniform(0.0, MAX_PAUSE_S), 3), amounts[kind]))
    return tuple(mishaps)


def run(
    schedules: int = 200,
    seed: int = 1,
    rounds: int = 2,
    samples_per_round: int = 2,
    rate: float = 2000.0,
    within: float = 600.0,
    jobs: int = 2,
    first: int = 0,
    settings: Sequence[str] = ("rover.state_period_s=600",),
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> Row:
    """Fly one mission a schedule; the counts of what happened and of what went wrong.

    within: seconds of wall time after which a mission counts as stuck. first: number of the first schedule, to fly one
    again. settings: other values of the scenario, as for ``--set``. Raises He3Error when anything went wrong.
    """
    if min(schedules, rounds, samples_per_round) < 1:
        raise InvalidInput(
            f"expected one schedule, round and sample at least, got {schedules}, {rounds} and {samples_per_round}"
        )
    outcomes: list[Outcome] = []
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="he3-chaos-") as name:
        folder = Path(name)
        library = compiled(folder)
        if library is None:
            progress("the wall clock is not stepped: there is no C compiler")
        flown = [f"rounds={rounds}", f"samples_per_round={samples_per_round}", f"rate={rate}", *settings]
        task = partial(fly, seed=seed, settings=flown, within_s=within, folder=folder, library=library)
        with Tasks(jobs) as pool:
            for _, outcome in pool.results(task, range(first, first + schedules)):
                outcomes.append(outcome)
                say(_described(outcome))
                _write(outcomes, json)
                failed = sum(each.failed for each in outcomes)
                progress(
                    f"{len(outcomes)}/{schedules} schedules, {failed} failed, {time.monotonic() - began:.0f} s, "
                    f"{outcome.wall_s:.0f} s this one"
                )
            if pool.stopped is not None:
                say(f"stopped by {pool.stopped.name} after {len(outcomes)} of {schedules} schedules")
            row = _total(outcomes)
            _write(outcomes, json)
            say(
                f"{row['schedules']} schedules ({', '.join(f'{row[kind]} {kind}' for kind in Kind)}), "
                f"{row['samples']} samples, {row['ends']} ends of full disks: "
                + ", ".join(f"{row[name]} {name}" for name in WRONG)
            )
    failures = [each.number for each in outcomes if each.failed]
    if failures:
        raise He3Error(f"chaos: {len(failures)} of {schedules} schedules went wrong: {failures}")
    return row


def _described(outcome: Outcome) -> str:
    wrong = ", ".join(f"{getattr(outcome, name)} {name}" for name in WRONG if getattr(outcome, name))
    mishaps = "; ".join(map(str, outcome.mishaps))
    line = f"schedule {outcome.number:>3}  {outcome.samples} samples  {wrong or 'right'}  ({mishaps})"
    return "\n".join((line, *(f"    {why}" for why in outcome.why))) if outcome.failed else line


def _total(outcomes: Sequence[Outcome]) -> Row:
    happened = Counter(mishap.kind for outcome in outcomes for mishap in outcome.mishaps)
    sums = {name: sum(getattr(each, name) for each in outcomes) for name in ("samples", "ends", *WRONG)}
    return {"schedules": len(outcomes), **{kind.value: happened[kind] for kind in Kind}, **sums}


def _write(outcomes: Sequence[Outcome], json: Path | None) -> None:
    if json is not None:
        rows = [asdict(each) for each in sorted(outcomes, key=lambda each: each.number)]
        kept.write_whole(json, {**_total(outcomes), "rows": rows})


# --- one mission, in a worker process ---------------------------------------------------------------------------


def fly(
    number: int, *, seed: int, settings: Sequence[str], within_s: float, folder: Path, library: Path | None
) -> Outcome:
    """What comes of the mission under the schedule of that number."""
    kinds = [kind for kind in Kind if kind is not Kind.CLOCK or library is not None]
    outcome = Outcome(number, schedule(random.Random(f"chaos:{seed}:{number}"), kinds))
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix=f"{number}-", dir=folder) as name:
        clock = None if library is None else WallClock(library, Path(name) / "wall-clock")
        try:
            with JournalledMission(
                Path(name),
                [*settings, f"seed={seed + number}"],
                recorder=True,
                environment={} if clock is None else clock.environment,
            ) as mission:
                _Flight(mission, outcome, clock).fly(within_s)
        except He3Error as error:
            outcome.stuck = 1
            outcome.why.append(str(error))
    outcome.wall_s = time.monotonic() - began
    return outcome


class _Flight:
    """One mission, and what has happened to its processes."""

    def __init__(self, mission: JournalledMission, outcome: Outcome, clock: WallClock | None) -> None:
        self._mission = mission
        self._outcome = outcome
        self._clock = clock
        self._full: set[int] = set()
        """Ids of the processes whose disk was full at some time."""
        self._recorder_killed = False

    def fly(self, within_s: float) -> None:
        """Let everything happen, tend the mission to its end, and judge it."""
        mission, outcome = self._mission, self._outcome
        outcome.samples = mission.scenario.samples
        for mishap in outcome.mishaps:
            time.sleep(mishap.after_s)
            self._befall(mishap)
        self._tend(within_s)
        taken = mission.samples_in_the_map()
        reported = mission.samples_reported()
        outcome.lost, outcome.doubled = judged_samples(outcome.samples, taken, reported)
        outcome.unequal = int(not mission.map_survives_a_restart())
        self._judge_recordings(taken)
        for name, said in mission.logs:
            if "Traceback (most recent call last)" in said or "ended by itself" in said:
                outcome.unexplained += 1
                outcome.why.append(f"--- {name}\n{said[-3000:]}")

    def _befall(self, mishap: Mishap) -> None:
        mission, name = self._mission, mishap.name
        match mishap.kind:
            case Kind.CLOCK:
                if self._clock is not None:
                    self._clock.set(mishap.amount)
            case Kind.KILL:
                self._recorder_killed = self._recorder_killed or name == RECORDER
                process = mission.process(name)
                process.kill()
                if process.wait() == -signal.SIGKILL:
                    mission.start_again(name)
                else:
                    self._revive(name)
            case Kind.STOP:
                process = mission.process(name)
                process.send_signal(signal.SIGSTOP)
                time.sleep(mishap.amount)
                process.send_signal(signal.SIGCONT)
            case Kind.DISK:
                self._fill_the_disk(name, round(mishap.amount))

    def _fill_the_disk(self, name: str, room_bytes: int) -> None:
        process = self._mission.process(name)
        if process.poll() is not None:
            self._revive(name)
            return
        written = self._mission.written_bytes(name)
        size = 1 if written is None else written + room_bytes
        _, most = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, most))
        self._full.add(process.pid)
        if written is not None:
            self._wait(
                FILLS_WITHIN_S, lambda: process.poll() is not None or self._mission.over or self._filled(name, size)
            )
        elif name == LINK.name:
            time.sleep(LINK_WRITES_WITHIN_S)
        self._wait(FULL_S, lambda: process.poll() is not None)
        if process.poll() is not None:
            self._revive(name)
            return
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (most, most))

    def _filled(self, name: str, size: int) -> bool:
        written = self._mission.written_bytes(name)
        return written is not None and written >= size

    @staticmethod
    def _wait(within_s: float, over: Callable[[], bool]) -> None:
        """Return when it is over, or after that time."""
        end = time.monotonic() + within_s
        while not over() and time.monotonic() < end:
            time.sleep(0.02)

    def _revive(self, name: str) -> None:
        """Start that process again if it has ended, and judge its end."""
        mission, outcome = self._mission, self._outcome
        process = mission.process(name)
        code = process.poll()
        if code is None:
            return
        last = mission.last_words(name)
        if explained(name, code, last, process.pid in self._full):
            outcome.ends += 1
        else:
            outcome.unexplained += 1
            outcome.why.append(f"{name} ended with {code}: {last}\n{mission.said(name)}")
        mission.start_again(name)

    def _tend(self, within_s: float) -> None:
        """Start what ends by itself again until the mission is over; raises He3Error if it is not over in time."""
        deadline = time.monotonic() + within_s
        while not self._mission.over:
            for name in self._mission.names:
                self._revive(name)
            if time.monotonic() > deadline:
                self._mission.wait_until_over(0.0)
            time.sleep(0.05)

    def _judge_recordings(self, taken: Sequence[str]) -> None:
        """End the recorder, and look for the samples of the map in what it has recorded."""
        mission, outcome = self._mission, self._outcome
        code, last = mission.end(RECORDER)
        recorded, problems = mission.samples_recorded()
        missing = sorted(set(taken) - recorded)
        if self._recorder_killed:
            return  # what came down while it was away is in no recording, and its files end where it was killed
        if missing or problems or code:
            outcome.unrecorded += len(missing) or 1
            outcome.why.append(f"recorder ended with {code}: {last}; not recorded: {missing}; {problems}")


def explained(name: str, code: int, last: str, disk_was_full: bool) -> bool:
    """Whether a process that ended by itself had to, and said why in its last line.

    Only a full disk is a reason, and none for the recorder, which goes on without room.
    """
    full = last.startswith(f"he3 {name}: ") and "cannot " in last and last.endswith(": File too large")
    return full and disk_was_full and code > 0 and name in JOURNALS


if __name__ == "__main__":
    run()

"""Random faults: a hundred whole missions that lose nothing, schedules that can be repeated, failures that shrink."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import faults
from benchmarks.fault_schedules import LINK_FAULTS, Fault, FaultKind, link_change, random_schedule, shrunk, telecommand
from benchmarks.faults import World, fly, fly_schedule, fly_world
from he3.errors import He3Error, InvalidInput
from schemas.commands import CommandKind
from schemas.link import LinkChange
from schemas.telemetry import SampleReport
from schemas.topics import SAMPLE
from services.runtime.node import DurableNode, Event, Received, SavedState
from services.runtime.scheduler import InlineExecutor

EXTENT_M = 120.0
BATCH = 4
IN_THE_GATE = 4
"""The missions, of a hundred, that every test run includes."""


def schedule_of(seed: int) -> tuple[Fault, ...]:
    return random_schedule(np.random.default_rng(seed), 9 * 3600.0, EXTENT_M)


@pytest.mark.parametrize(
    "first",
    [
        pytest.param(first, marks=[pytest.mark.exhaustive] if first >= IN_THE_GATE else [])
        for first in range(0, 100, BATCH)
    ],
)
def test_missions_under_random_faults_end_with_every_sample_in_the_map_exactly_once(first: int) -> None:
    failed = [outcome for seed in range(first, first + BATCH) if (outcome := fly(seed)).failed]

    told = "\n".join(f"seed {outcome.seed}: {'; '.join(outcome.why)}" for outcome in failed)
    assert not failed, f"{told}\n(he3 bench faults --runs 1 --seed N shrinks it)"


def test_the_same_seed_gives_the_same_schedule_and_another_one_another() -> None:
    assert schedule_of(7) == schedule_of(7)
    assert schedule_of(7) != schedule_of(8)


def test_every_kind_of_fault_every_service_and_every_command_comes_up() -> None:
    drawn = [fault for seed in range(300) for fault in schedule_of(seed)]

    assert {fault.kind for fault in drawn} == set(FaultKind)
    assert {fault.who for fault in drawn if fault.kind is FaultKind.KILL} == {"rover", "ground", "link", "field"}
    commanded = {fault.who for fault in drawn if fault.kind is FaultKind.COMMAND}
    assert commanded == {kind.value for kind in CommandKind} - {CommandKind.RESUME.value}


def test_every_fault_is_undone_at_its_end() -> None:
    for fault in (fault for seed in range(200) for fault in schedule_of(seed)):
        if fault.kind in LINK_FAULTS:
            begins, ends = (link_change(fault, begins, 1.282) for begins in (True, False))
            assert begins.model_fields_set == ends.model_fields_set or ends == LinkChange(unlimited_rate=True)
        elif fault.kind is FaultKind.COMMAND:
            assert telecommand(fault, True, "first") is not None
            after = telecommand(fault, False, "second")
            if fault.who in ("pause", "safe"):
                assert after is not None
                assert after.kind is CommandKind.RESUME
            if fault.who == "set_keep_out":
                assert after is not None
                assert after.polygon_m is None


def test_only_a_fault_of_the_link_changes_the_link() -> None:
    with pytest.raises(ValueError, match="expected a fault of the link, got kill"):
        link_change(Fault(FaultKind.KILL, 1.0, 1.0, who="rover"), True, 1.282)


def test_a_fault_says_all_that_is_needed_to_repeat_it() -> None:
    fault = Fault(FaultKind.COMMAND, 12.5, 60.0, "set_keep_out", 4.0, torn=True, place_m=(10.0, 20.0))

    assert str(fault) == "command set_keep_out 4 (10.0, 20.0) at 12.500 s for 60.000 s torn"


def test_a_failure_shrinks_to_the_faults_that_it_needs_and_these_to_an_instant() -> None:
    schedule = schedule_of(3) + schedule_of(4)
    guilty = next(fault for fault in schedule if fault.kind is FaultKind.KILL and fault.lasts_s)

    smallest = shrunk(schedule, lambda some: any(f.at_s == guilty.at_s and f.kind is guilty.kind for f in some))

    assert [(fault.at_s, fault.lasts_s) for fault in smallest] == [(guilty.at_s, 0.0)]


class ForgetfulGround:
    """A ground station with a bug: once restarted, it loses the next sample."""

    def __init__(self, node: DurableNode) -> None:
        self._node = node
        self._starts = 0
        self._lost = False
        self.interface, self.state_types, self.functions = node.interface, node.state_types, node.functions

    def checkpoint(self) -> SavedState:
        return {"node": self._node.checkpoint(), "starts": self._starts, "lost": self._lost}

    def restore(self, state: SavedState) -> None:
        self._node.restore(state["node"])
        self._starts, self._lost = state["starts"], state["lost"]

    def handle(self, event: Event, now: int) -> object:
        if type(event).__name__ == "Started":
            self._starts += 1
        if isinstance(event, Received) and event.topic is SAMPLE and self._starts > 1 and not self._lost:
            self._lost = True
            assert isinstance(event.body, SampleReport)
            return []
        return self._node.handle(event, now)


class BuggyWorld(World):
    def _built(self, name: str):  # type: ignore[no-untyped-def]
        node = super()._built(name)
        return ForgetfulGround(node) if name == "ground" else node


@pytest.mark.exhaustive
def test_a_planted_bug_is_found_and_its_schedule_shrinks_to_what_provokes_it() -> None:
    seed = 5
    harmless = Fault(FaultKind.LOSS, 2000.0, 600.0, amount=0.2)
    guilty = Fault(FaultKind.KILL, 4000.0, 30.0, who="ground")
    later = Fault(FaultKind.KILL, 9000.0, 30.0, who="rover")

    def flown(schedule: tuple[Fault, ...]) -> faults.Outcome:
        return fly_world(BuggyWorld(seed, InlineExecutor(), planner="tour"), schedule, patience_s=12 * 3600.0)

    outcome = flown((harmless, guilty, later))
    assert outcome.failed
    assert outcome.why
    smallest = shrunk((harmless, guilty, later), lambda some: flown(some).failed)
    assert [fault.kind for fault in smallest] == [FaultKind.KILL]
    assert smallest[0].who == "ground"


def test_a_run_without_failures_writes_its_counts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said: list[str] = []

    row = faults.run(runs=2, seed=40, jobs=1, json=tmp_path / "faults.json", say=said.append)

    assert {name: row[name] for name in ("runs", "lost", "doubled", "stuck", "unequal", "failed_seeds")} == {
        "runs": 2, "lost": 0, "doubled": 0, "stuck": 0, "unequal": 0, "failed_seeds": [],
    }  # fmt: skip
    assert json.loads((tmp_path / "faults.json").read_text()) == row
    assert said == ["runs 2  lost 0  doubled 0  stuck 0  unequal 0"]
    assert "2/2 missions, 0 failed" in capsys.readouterr().err


def fly_planted(seed: int) -> faults.Outcome:
    """A mission whose ground has the bug; of odd seeds it is restarted, so that the bug shows."""
    schedule = (Fault(FaultKind.KILL, 4000.0, 30.0, who="ground" if seed % 2 else "rover"),)
    outcome = fly_world(BuggyWorld(seed, InlineExecutor(), planner="tour"), schedule, patience_s=12 * 3600.0)
    outcome.smallest = schedule if outcome.failed else ()
    return outcome


def test_a_run_with_failures_names_their_seeds_and_faults_writes_them_and_fails(tmp_path: Path) -> None:
    said: list[str] = []

    with pytest.raises(He3Error, match=r"^1 of 2 missions failed, seeds \[5\]$"):
        faults.run(runs=2, seed=4, jobs=1, json=tmp_path / "faults.json", say=said.append, fly_seed=fly_planted)

    row = json.loads((tmp_path / "faults.json").read_text())
    assert (row["runs"], row["failed_seeds"]) == (2, [5])
    counts = {name: row[name] for name in ("lost", "doubled", "stuck", "unequal")}
    assert sum(counts.values()) >= 1
    failure, summary = said
    assert failure.startswith("seed 5 FAILED: ")
    assert failure.endswith("smallest schedule that fails:\n    kill ground at 4000.000 s for 30.000 s")
    assert summary == f"runs 2  {'  '.join(f'{name} {count}' for name, count in counts.items())}"


def test_a_run_of_no_missions_is_refused() -> None:
    with pytest.raises(InvalidInput, match="expected one run and one job at least, got 0 and 2"):
        faults.run(runs=0)


def test_a_mission_without_faults_passes_and_says_nothing() -> None:
    assert not fly_schedule(11, ()).failed

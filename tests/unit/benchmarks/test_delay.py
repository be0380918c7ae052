"""The delay study: a pipeline hides light time, stop-and-wait loses it every round, and the map is the same."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import delay
from benchmarks.delay import Case, Remembering, scenario_of
from he3.errors import InvalidInput
from services.runtime.scheduler import InlineExecutor

ROUNDS = 3
FAR_S = 1200.0


@pytest.fixture(scope="module")
def study(quarter_of_t1: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[delay.Row], Path]:
    """A short study on a small region, with all of its files."""
    folder = tmp_path_factory.mktemp("delay")
    rows = delay.run(
        json=folder / "delay.json", out=folder, light_times=(0.0, FAR_S), blackouts=(0.5,), rounds=ROUNDS, jobs=2,
        region=str(quarter_of_t1), say=lambda _: None,
    )  # fmt: skip
    return rows, folder


def time_s(rows: list[delay.Row], light_time_s: float, pipelined: bool) -> float:
    return next(
        row["mission_time_s"]
        for row in rows
        if row["light_time_s"] == light_time_s and bool(row["pipeline"]) is pipelined and not row["blackout"]
    )


@pytest.mark.exhaustive
def test_stop_and_wait_pays_the_round_trip_every_round_and_a_pipeline_only_once(
    study: tuple[list[delay.Row], Path],
) -> None:
    rows, _ = study
    waiting = time_s(rows, FAR_S, False) - time_s(rows, 0.0, False)
    ahead = time_s(rows, FAR_S, True) - time_s(rows, 0.0, True)

    assert waiting == pytest.approx(ROUNDS * 2 * FAR_S, abs=1.0)
    assert ahead == pytest.approx(2 * FAR_S, abs=1.0)


def test_light_time_changes_neither_plans_nor_map(study: tuple[list[delay.Row], Path]) -> None:
    rows, _ = study
    for pipelined in (False, True):
        same = [row for row in rows if bool(row["pipeline"]) is pipelined and not row["blackout"]]
        assert len({(row["rmse_ppb"], row["path_length_m"], row["samples"]) for row in same}) == 1


def test_a_row_for_every_condition_is_written_and_drawn(study: tuple[list[delay.Row], Path]) -> None:
    rows, folder = study
    written = json.loads((folder / "delay.json").read_text())["rows"]

    assert written == rows
    assert {(row["light_time_s"], row["blackout"], row["pipeline"]) for row in rows} == {
        (0.0, 0.0, 0), (0.0, 0.0, 2), (FAR_S, 0.0, 0), (FAR_S, 0.0, 2), (1.282, 0.5, 0), (1.282, 0.5, 2),
    }  # fmt: skip
    assert (folder / "delay.png").read_bytes().startswith(b"\x89PNG")


def test_a_share_without_contact_becomes_a_duty_cycle() -> None:
    case = Case(light_time_s=1.282, blackout=0.25, pipeline=2, planner="rrt", region="t1", seed=1, rounds=3)
    cycle = scenario_of(case).link.duty_cycle

    assert cycle is not None
    assert (cycle.period_s, cycle.contact_s) == (14_400.0, 10_800.0)


def test_what_was_computed_once_is_not_computed_again() -> None:
    calls: list[int] = []

    class Counting(InlineExecutor):
        def submit(self, function, /, *arguments):  # type: ignore[no-untyped-def]
            calls.append(1)
            return super().submit(function, *arguments)

    executor = Remembering(Counting())
    assert [executor.submit(divmod, 7, 2).result() for _ in range(3)] == [(3, 1)] * 3
    assert executor.submit(divmod, 7, 3).result() == (2, 1)
    assert len(calls) == 2


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"pipeline": 0}, "expected a pipeline of one round"),
        ({"blackouts": (1.0,)}, "expected black-outs from 0 to below 1"),
        ({"light_times": (1.0,)}, "expected a light time of 0 to compare with"),
    ],
)
def test_a_study_that_compares_nothing_is_refused(wrong: dict[str, object], complaint: str) -> None:
    with pytest.raises(InvalidInput, match=complaint):
        delay.run(**wrong)  # type: ignore[arg-type]

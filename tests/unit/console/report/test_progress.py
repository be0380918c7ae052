"""Progress: what is shown, how durations read, when a line is written."""

from __future__ import annotations

import io
from collections.abc import Iterator

import pytest
from rich.console import Console

from schemas.ground import GroundStatus, MissionPhase
from services.console.client.time_format import duration
from services.console.report.progress import Moment, PlainProgress, moment_of, panel, plain_line, sparkline, time_left_s

MOMENT = Moment(
    phase="executing", round=3, rounds=30, samples=15, samples_total=150, rmse_ppb=0.98765, mean_std_ppb=0.9,
    driven_m=1234.5, mission_time_s=90_000.0, in_flight=2, rover="driving at (1, 2) m",
)  # fmt: skip


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.4, "0 s"),
        (59.4, "59 s"),
        (65, "1 min 05 s"),
        (3600, "1 h 00 min"),
        (86_399, "23 h 59 min"),
        (190_000, "2 d 04 h"),
    ],
)
def test_a_duration_reads_as_people_say_it(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_time_left_goes_by_the_samples_that_are_done() -> None:
    assert time_left_s(MOMENT, 10.0) == pytest.approx(90.0)
    assert time_left_s(Moment(), 10.0) is None


def test_a_plain_line_names_everything_that_matters() -> None:
    line = plain_line(MOMENT, 10.0)
    for part in ("3/30", "15/150", "0.9877 ppb", "1234 m", "1 d 01 h", "in flight 2", "1 min 30 s", "executing"):
        assert part in line
    assert "\n" not in line


@pytest.mark.parametrize(("samples", "phase"), [(8, "planning"), (9, "ending")])
def test_a_mission_with_all_its_samples_is_not_said_to_plan(samples: int, phase: str) -> None:
    status = GroundStatus(
        phase=MissionPhase.PLANNING, planner="tour", round=3, rounds=3, samples=samples, samples_total=9, driven_m=0.0,
        budget_m=None, plan_revision=1, plans_in_work=0, map_revision=1, mean_std_ppb=1.0, kernel=None, score=None,
        rover=None, rover_made_at=None,
    )  # fmt: skip
    assert moment_of(status, 0.0, 0).phase == phase


def test_a_line_is_written_for_each_round_and_now_and_then_in_between() -> None:
    times: Iterator[float] = iter([0.0, 0.05, 1.0, 2.0, 3.0, 14.0, 14.01, 14.02])
    stream = io.StringIO()
    progress = PlainProgress(stream, clock=lambda: next(times), every_s=10.0)
    with progress:
        for number in (0, 0, 1, 1, 1, 2):
            progress.show(lambda number=number: Moment(round=number))
    rounds = [line.split()[1] for line in stream.getvalue().splitlines()]
    assert rounds == ["1/0", "1/0", "2/0"]


def test_what_is_new_to_say_is_below_a_line_once() -> None:
    times = iter(range(10))
    stream = io.StringIO()
    with PlainProgress(stream, clock=lambda: float(next(times))) as progress:
        for number, detail in ((0, "walled in"), (1, "walled in"), (2, ""), (2, "blocked")):
            progress.show(lambda number=number, detail=detail: Moment(round=number, detail=detail))
    assert [line.strip() for line in stream.getvalue().splitlines() if not line.startswith("round")] == [
        "walled in", "blocked",
    ]  # fmt: skip


def test_the_panel_draws_on_any_terminal_and_shows_the_figures() -> None:
    stream = io.StringIO()
    Console(file=stream, width=100, force_terminal=False).print(panel("title", "note", MOMENT, 10.0, [1.2, 1.0, 0.9]))
    text = stream.getvalue()
    for part in ("title", "note", "15 of 150", "0.9877 ppb", "1,234 m", "2 messages", "driving at (1, 2) m", "█"):
        assert part in text


def test_a_sparkline_spans_lowest_to_highest_and_never_outgrows_its_width() -> None:
    assert sparkline([0.0, 1.0, 2.0], 10) == "▁▅█"
    assert sparkline([1.0, 1.0], 10) == "▁▁"
    assert len(sparkline([float(i) for i in range(1000)], 58)) == 58

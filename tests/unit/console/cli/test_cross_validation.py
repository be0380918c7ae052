"""A cross-validation in lines of text, and as a table."""

from __future__ import annotations

import csv
import io

from schemas.maps import CrossValidation, PredictedSample
from services.console.cli.map.cross_validation import SHOWN, lines_of, table_of


def found(scores: list[float]) -> CrossValidation:
    samples = tuple(
        PredictedSample(
            sample_id=f"r01s{k + 1}", x_m=10.5, y_m=20.0, measured_ppb=8.0 + score, expected_ppb=8.0, std_ppb=1.0,
            score=score,
        )
        for k, score in enumerate(scores)
    )  # fmt: skip
    return CrossValidation(
        rmse_ppb=0.91745, bias_ppb=-0.0095, score_rms=0.94, within_68=0.7, within_95=0.96, samples=samples,
        revision=181, mission_time_ns=0,
    )  # fmt: skip


def test_the_summary_comes_first_and_then_the_samples_that_surprise_most() -> None:
    lines = lines_of(found([0.1, -3.2, 0.2, 0.3, 2.0, -0.4, 0.5]))
    assert lines[:4] == [
        "error       0.9174 ppb RMSE, -0.0095 ppb on average",
        "coverage    70.0% within the intervals of 68.3 %, 96.0% within those of 95.4 %",
        "scores      0.94 RMS; 1 is honest, more is too certain",
        "map         revision 181, 7 samples",
    ]
    assert lines[6] == "r01s2          10.5     20.0     4.800     8.000   1.000   -3.2"
    assert [line.split()[0] for line in lines[6:-1]] == ["r01s2", "r01s5", "r01s7", "r01s6", "r01s4"]
    assert len({len(line) for line in lines[5:-1]}) == 1, "the columns stand under their names"
    assert lines[-1] == f"the {SHOWN} of the largest scores, in ppb; --csv and --json list all"


def test_few_samples_are_all_listed() -> None:
    assert [line.split()[0] for line in lines_of(found([0.1, -3.2]))[6:]] == ["r01s2", "r01s1"]


def test_the_table_has_every_sample_in_the_order_of_arrival() -> None:
    rows = list(csv.DictReader(io.StringIO(table_of(found([0.1, -3.2])))))
    assert [row["sample_id"] for row in rows] == ["r01s1", "r01s2"]
    assert rows[1] == {
        "sample_id": "r01s2", "x_m": "10.5", "y_m": "20.0", "measured_ppb": "4.8", "expected_ppb": "8.0",
        "std_ppb": "1.0", "score": "-3.2",
    }  # fmt: skip

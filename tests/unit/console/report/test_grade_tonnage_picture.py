"""The picture and the lines of a grade-tonnage curve."""

from __future__ import annotations

import csv
import io

import numpy as np

from schemas.maps import GradeTonnage, GradeTonnagePoint, Interval
from services.console.cli.map.grade_tonnage import lines_of, table_of
from services.console.report.grade_tonnage_picture import grade_tonnage_figure


def interval(expected: float) -> Interval:
    return Interval(expected=expected, low=0.9 * expected, high=1.2 * expected)


FOUND = GradeTonnage(
    area_m2=250_000.0,
    curve=(
        GradeTonnagePoint(
            cutoff_ppb=7.0, area_m2=interval(200_000.0), mean_ppb=interval(8.5), mass_kg_per_m=interval(2.5)
        ),
        GradeTonnagePoint(
            cutoff_ppb=9.5, area_m2=interval(50_000.0), mean_ppb=interval(10.0), mass_kg_per_m=interval(0.8)
        ),
        GradeTonnagePoint(cutoff_ppb=14.0, area_m2=interval(0.0), mean_ppb=None, mass_kg_per_m=interval(0.0)),
    ),
    bulk_density_kg_m3=1660.0, probability=0.9, draws=2000, block_m=19.0, revision=7, samples=30, mission_time_ns=0,
)  # fmt: skip


def test_both_curves_are_drawn_over_the_cut_offs_with_their_bands() -> None:
    left, right = grade_tonnage_figure(FOUND).axes
    assert np.allclose(left.lines[0].get_xydata(), [(7.0, 80.0), (9.5, 20.0), (14.0, 0.0)])
    assert np.allclose(right.lines[0].get_xydata(), [(7.0, 8.5), (9.5, 10.0)])
    assert len(left.collections) == len(right.collections) == 1


def test_a_curve_without_any_ground_above_has_a_picture_too() -> None:
    left, right = grade_tonnage_figure(FOUND.model_copy(update={"curve": FOUND.curve[2:]})).axes
    assert len(left.lines[0].get_xdata()) == 1
    assert len(right.lines[0].get_xdata()) == 0


def test_the_lines_stand_under_their_names_and_leave_out_a_mean_that_is_none() -> None:
    lines = lines_of(FOUND)
    assert lines[1] == "      7   80.0 (72.0 to 96.0) %    8.50 (7.65 to 10.20)      2.500 (2.250 to 3.000)"
    assert lines[3] == "     14      0.0 (0.0 to 0.0) %                              0.000 (0.000 to 0.000)"
    assert len({len(line) for line in lines[:4]}) == 1
    assert lines[4:] == [
        "area        250,000 m2 in all",
        "intervals   90%, from 2,000 fields at places 19 m apart",
        "map         revision 7, 30 samples",
    ]


def test_the_table_has_a_row_a_cut_off_with_the_ends_of_each_figure() -> None:
    rows = list(csv.DictReader(io.StringIO(table_of(FOUND))))
    assert rows[1]["cutoff_ppb"] == "9.5"
    assert (rows[1]["mean_ppb"], rows[1]["mean_ppb_low"], rows[1]["mean_ppb_high"]) == ("10.0", "9.0", "12.0")
    assert rows[2]["mean_ppb"] == ""
    figures = [f"{name}{end}" for name in ("area_m2", "mean_ppb", "mass_kg_per_m") for end in ("", "_low", "_high")]
    assert list(rows[0]) == ["cutoff_ppb", *figures]

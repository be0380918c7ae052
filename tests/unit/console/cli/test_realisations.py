"""Realisations as files: arrays for NumPy, a table for everything else."""

from __future__ import annotations

import csv
import io

import numpy as np

from services.console.cli.map.realisations import arrays_of, described, table_of
from services.console.client.map_queries import Realisations

FOUND = Realisations(
    values=np.arange(12, dtype=np.float32).reshape(2, 2, 3),
    x_m=np.array([5.0, 15.0, 25.0]),
    y_m=np.array([5.0, 15.0]),
    resolution_m=10.0,
    revision=7,
    samples=30,
)


def test_the_arrays_have_their_places_beside_them() -> None:
    with np.load(io.BytesIO(arrays_of(FOUND))) as arrays:
        assert set(arrays) == {"x_m", "y_m", "he3_ppb"}
        assert np.array_equal(arrays["he3_ppb"], FOUND.values)
        assert np.array_equal(arrays["x_m"], FOUND.x_m)
        assert np.array_equal(arrays["y_m"], FOUND.y_m)


def test_the_table_has_a_row_a_cell_from_the_south_west_on_and_a_column_a_realisation() -> None:
    rows = list(csv.DictReader(io.StringIO(table_of(FOUND))))
    assert len(rows) == 6
    assert rows[0] == {"x_m": "5", "y_m": "5", "r1": "0", "r2": "6"}
    assert rows[4] == {"x_m": "15", "y_m": "15", "r1": "4", "r2": "10"}


def test_what_was_written_is_told_in_one_line() -> None:
    assert described(FOUND) == "2 realisations of 2 x 3 cells of 10 m, revision 7, 30 samples"

"""The map's benchmark prints all its figures for every kernel, in short time on a small site."""

import json
from pathlib import Path

import pytest

from benchmarks.map_speed import run
from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.kernels import KERNELS


def test_every_size_and_kernel_has_a_row_with_all_times_in_seconds(tmp_path: Path) -> None:
    said: list[str] = []
    target = tmp_path / "map.json"
    rows = run(sizes=(6, 9), json=target, grid=SiteGrid(12, 15, 10.0), say=said.append)
    written = json.loads(target.read_text(encoding="utf-8"))
    assert written["rows"] == rows
    assert [(row["n"], row["kernel"]) for row in rows] == [(n, kernel) for n in (6, 9) for kernel in (*KERNELS, "auto")]
    for row in rows:
        assert row["cells"] == 180
        for key in (
            "update_s",
            "stream_s",
            "refit_s",
            "mixture_update_s",
            "mixture_refit_s",
            "predict_s",
            "sklearn_predict_s",
        ):
            assert 0 < row[key] < 60
        assert row["read_fraction"] == 0 if row["kernel"] == "se" else 0 < row["read_fraction"] <= 1
    assert len(said) == 1 + len(rows)


@pytest.mark.parametrize("kernel", ["se", "smooth+rough"])
def test_scikit_learn_can_be_left_out(kernel: str) -> None:
    (row,) = run(sizes=(6,), kernels=(kernel,), grid=SiteGrid(12, 15, 10.0), sklearn=False, say=lambda _: None)
    assert row["sklearn_predict_s"] is None


def test_a_size_without_samples_is_refused() -> None:
    with pytest.raises(InvalidInput, match="expected sizes of one sample or more, got 150, 0"):
        run(sizes=(150, 0), sklearn=False)

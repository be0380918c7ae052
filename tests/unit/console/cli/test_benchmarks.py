"""Benchmarks on the command line: flags made from the parameters of a function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import pytest

from he3.errors import InvalidInput
from services.console.cli.benchmarks import arguments_of, listing, run_benchmark


def run(
    sizes: Sequence[int] = (150, 1000),
    names: tuple[str, ...] = (),
    region: str | None = None,
    json: Path | str | None = None,
    seeds: int = 10,
    budget_m: float | None = None,
    full: bool = False,
    kind: Literal["a", "b"] = "a",
    say: Callable[[str], None] = print,
) -> None:
    """A benchmark."""


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], {}),
        (["--seeds", "3"], {"seeds": 3}),
        (["--seeds=3"], {"seeds": 3}),
        (["--sizes", "10,20"], {"sizes": (10, 20)}),
        (["--names", "se,matern52"], {"names": ("se", "matern52")}),
        (["--full"], {"full": True}),
        (["--no-full"], {"full": False}),
        (["--budget-m", "3500"], {"budget_m": 3500.0}),
        (["--region", "t1.npz", "--json", "x.json"], {"region": "t1.npz", "json": Path("x.json")}),
        (["--kind", "b"], {"kind": "b"}),
    ],
)
def test_flags_become_arguments_of_the_right_type(words: list[str], expected: dict[str, Any]) -> None:
    assert arguments_of(run, words) == expected


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--speed", "3"], "got '--speed'"),
        (["3"], "got '3'"),
        (["--seeds"], "expected a value after --seeds"),
        (["--seeds", "three"], "--seeds: expected N, got 'three'"),
        (["--sizes", "1,x"], "--sizes: expected N, got 'x'"),
        (["--kind", "c"], "expected one of a, b; got 'c'"),
        (["--say", "it"], "got '--say'"),
    ],
)
def test_a_flag_that_is_not_right_is_refused_in_one_line(words: list[str], complaint: str) -> None:
    with pytest.raises(InvalidInput) as refusal:
        arguments_of(run, words)
    assert complaint in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_every_benchmark_of_the_checkout_is_listed_with_what_it_measures() -> None:
    lines = listing()
    assert lines[0] == "Benchmarks:"
    assert all(len(line.split()) > 1 for line in lines[1:])


def test_a_benchmark_explains_its_flags_without_running() -> None:
    said: list[str] = []
    run_benchmark("map", ["--help"], said.append)
    assert "Usage: he3 bench map" in said[0]
    assert "--sizes N,..." in said[0]
    assert "--no-sklearn" in said[0]
    assert "default: None" not in said[0]
    assert said[0].rstrip().endswith("printed, and written to ``json`` if given.")
    assert "Raises" not in said[0]


def test_a_part_of_other_benchmarks_is_not_run() -> None:
    with pytest.raises(InvalidInput, match="is a part of other benchmarks"):
        run_benchmark("missions", [], print)


def test_a_result_that_cannot_be_written_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="json: expected a file that can be written"):
        run_benchmark("paper", ["--json", str(tmp_path), "--seeds", "0"], print)
    # What comes next is the benchmark's own check: the folder was made on the way.
    with pytest.raises(InvalidInput, match="expected one seed at least"):
        run_benchmark("paper", ["--json", str(tmp_path / "new" / "rows.json"), "--seeds", "0"], print)
    assert (tmp_path / "new").is_dir()

"""Benchmarks on the command line: commands made from the signatures of their functions."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import pytest
import typer

from he3.errors import InvalidInput
from services.console.__main__ import main
from services.console.cli.benchmarks import _benchmark, command, command_of, described

came: dict[str, Any] = {}


def run(
    sizes: Sequence[int] = (150, 1000),
    names: tuple[str, ...] = (),
    region: str | None = None,
    json: Path | str | None = None,
    seeds: int = 10,
    budget_m: float | None = None,
    full: bool = False,
    kind: Literal["a", "b"] = "a",
    *,
    say: Callable[[str], None] = print,
) -> None:
    """A benchmark."""
    came.clear()
    came.update(locals())


DEFAULTS = {
    "sizes": (150, 1000), "names": (), "region": None, "json": None, "seeds": 10, "budget_m": None, "full": False,
    "kind": "a", "say": print,
}  # fmt: skip


def called(*words: str) -> dict[str, Any]:
    command_of("mine", run, "About it.")(list(words), prog_name="he3 bench mine", standalone_mode=False)
    return came


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
    assert called(*words) == DEFAULTS | expected


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--speed", "3"], "--speed"),
        (["3"], "3"),
        (["--seeds"], "--seeds"),
        (["--seeds", "three"], "--seeds"),
        (["--sizes", "1,x"], "expected N,..., got '1,x'"),
        (["--kind", "c"], "--kind"),
        (["--say", "it"], "--say"),
    ],
)
def test_a_flag_that_is_not_right_is_refused_in_one_line(words: list[str], complaint: str) -> None:
    usage_error: Any = typer.BadParameter.__bases__[0]
    with pytest.raises(usage_error) as refusal:
        called(*words)
    assert complaint in refusal.value.format_message()
    assert "\n" not in refusal.value.format_message()


def test_every_benchmark_of_the_checkout_is_listed_with_what_it_measures(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench"]) == 0
    out = capsys.readouterr().out
    assert described()
    for name, about in described().items():
        assert f"  {name} " in out
        assert about.split()[0] in out


def test_a_benchmark_explains_its_flags_without_running(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "map", "--help"]) == 0
    out = capsys.readouterr().out
    assert "Usage: he3 bench map [OPTIONS]" in out
    assert "--sizes N,..." in out
    assert "[default: 150,1000]" in out
    assert "--sklearn / --no-sklearn" in out
    assert "\n      update_s " in out  # a table of the module's docstring stands as it is
    assert "--grid" not in out
    assert out.rstrip().endswith("printed, and written to `json` if given.")
    assert "Raises" not in out


@pytest.mark.parametrize("name", described())
def test_the_help_of_a_benchmark_speaks_of_its_flags_alone_and_tells_folders_from_files(name: str) -> None:
    function, _ = _benchmark(name)
    flags = {flag.name: flag for flag in command(name).params}
    further = (inspect.getdoc(function) or "").partition("Raises ")[0]
    without = set(inspect.signature(function).parameters) - set(flags)
    assert [each for each in without if re.search(rf"\b{each}\b", further)] == []
    for each in {"data", "out", "folder"} & set(flags):
        assert flags[each].metavar == "DIR"


def test_a_part_of_other_benchmarks_is_not_run() -> None:
    with pytest.raises(InvalidInput, match="expected a benchmark, got missions, a part of other benchmarks"):
        command("missions")


def test_a_result_that_cannot_be_written_is_refused_before_anything_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "paper", "--json", str(tmp_path), "--seeds", "0"]) == 2
    assert capsys.readouterr().err.startswith("he3: --json: expected a file that can be written")
    # What comes next is the benchmark's own check: the folder was made on the way.
    assert main(["bench", "paper", "--json", str(tmp_path / "new" / "rows.json"), "--seeds", "0"]) == 2
    assert "expected one seed at least" in capsys.readouterr().err
    assert (tmp_path / "new").is_dir()

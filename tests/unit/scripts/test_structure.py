"""The figures of scripts/structure, on imports and code whose answer is known."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.processes import run

SCRIPT = Path(__file__).parents[3] / "scripts" / "structure.py"


@pytest.fixture(scope="module")
def structure() -> ModuleType:
    spec = importlib.util.spec_from_file_location("structure", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["structure"] = module
    spec.loader.exec_module(module)
    return module


def test_the_longest_chain_runs_from_the_top_to_a_module_without_imports(structure: ModuleType) -> None:
    imports = {"a": {"b", "d"}, "b": {"c"}, "c": {"d"}, "d": set(), "e": {"d"}}
    assert structure.longest_chain(imports) == ["a", "b", "c", "d"]
    assert structure.circles_of(imports) == []


def test_a_circle_is_found_and_counts_as_one_level(structure: ModuleType) -> None:
    imports = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}
    assert structure.circles_of(imports) == [["b", "c"]]
    assert structure.longest_chain(imports) == ["a", "b", "d"]


def test_packages_are_taken_as_a_whole(structure: ModuleType) -> None:
    imports = {
        "s.runtime": set(),
        "s.runtime.node": {"s.other"},
        "s.runtime.custody": set(),
        "s.runtime.custody.sender": {"s.runtime.custody.stream", "s.runtime.node"},
        "s.runtime.custody.stream": {"s.runtime.node"},
        "s.other": set(),
    }
    within = structure.packages_within(imports, "s.runtime")
    assert within == {"s.runtime.node": set(), "s.runtime.custody": {"s.runtime.node"}}


def test_bodies_that_differ_in_names_alone_are_duplicates_but_signatures_are_not(
    structure: ModuleType, tmp_path: Path
) -> None:
    body = "\n".join(
        f"    total = (total {operator} weight) * values[{row}] if limit {operator} total else max(values)"
        for row, operator in enumerate(("+", "-", "*", "/", "%"))
    )
    first = f"def mean(values, weight, limit):\n    total = 0\n{body}\n    return total\n"
    second = first.replace("values", "numbers").replace("total", "result").replace("mean", "average")
    signature = "def {}(" + ", ".join(f"argument_{number}: int = {number}" for number in range(30)) + "): ...\n"
    sources = {
        tmp_path / "a.py": first + signature.format("f"),
        tmp_path / "b.py": second + signature.format("g"),
    }
    (found,) = structure.duplicates_in(tmp_path, sources)
    assert (found.first, found.second) == ("a.py:2-8", "b.py:2-8")


def test_the_longest_class_comes_first_with_its_lines_and_methods(structure: ModuleType, tmp_path: Path) -> None:
    source = "class Short:\n    x = 1\n\n\nclass Long:\n    def f(self): ...\n\n    def g(self): ...\n"
    first, second = structure.longest_classes(tmp_path, {tmp_path / "m.py": source})
    assert (first.name, first.place, first.lines, first.methods) == ("Long", "m.py:5", 4, 2)
    assert (second.name, second.lines, second.methods) == ("Short", 2, 0)


def test_a_reader_that_wants_no_more_lines_ends_the_output_quietly(tmp_path: Path) -> None:
    for package in ("he3", "schemas", "services", "benchmarks", "examples", "scripts"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    here, there = os.pipe()
    os.close(here)  # as `head` does when it has its lines
    with os.fdopen(there, "wb") as output:
        done = run([sys.executable, SCRIPT, tmp_path], stdout=output)
    assert (done.returncode, done.stderr) == (0, "")

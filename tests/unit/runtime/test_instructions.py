"""Our processes compute with the same instructions on every x86-64 processor that has them."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from services.runtime.child import ROOT
from services.runtime.instructions import X86_64_V3, common_instructions, instructions

common = pytest.mark.skipif(instructions() != X86_64_V3, reason="this processor has not the instructions of x86-64-v3")
SEEN = """
import json
from services.runtime.entry import prepare_process

prepare_process()
import numpy
import scipy.linalg
from numpy._core._multiarray_umath import __cpu_features__
from threadpoolctl import threadpool_info

cores = {library["architecture"] for library in threadpool_info() if library["internal_api"] == "openblas"}
print(json.dumps([sorted(cores), __cpu_features__["X86_V3"], __cpu_features__["X86_V4"]]))
"""


def seen(**given: str) -> list[object]:
    """OpenBLAS's kinds of processor, and whether numpy uses the instructions of x86-64-v3 and of -v4, in a process."""
    bare = {name: value for name, value in os.environ.items() if name not in common_instructions()}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SEEN], capture_output=True, text=True, env={**bare, **given}, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    found: list[object] = json.loads(done.stdout)
    return found


@common
def test_a_process_computes_with_the_instructions_that_all_processors_have() -> None:
    assert seen() == [["Haswell"], True, False]


@common
def test_a_kind_of_processor_that_the_user_asks_for_is_kept() -> None:
    assert seen(OPENBLAS_CORETYPE="Sandybridge")[0] == ["Sandybridge"]


def test_where_the_instructions_are_missing_nothing_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.runtime.instructions._flags", lambda: frozenset({"sse2", "avx", "avx512f"}))
    assert common_instructions() == {}
    assert instructions() == os.uname().machine


def test_numpy_is_told_to_leave_only_what_the_processor_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.runtime.instructions._flags", lambda: frozenset({"avx2", "fma", "bmi2"}))
    assert common_instructions() == {"OPENBLAS_CORETYPE": "Haswell"}
    assert instructions() == X86_64_V3

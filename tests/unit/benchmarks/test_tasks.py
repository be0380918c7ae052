"""The tasks of benchmarks: results as they arrive and from a store, errors raised in the caller, workers ended."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from benchmarks.flights import Flight
from benchmarks.tasks import Tasks
from benchmarks.values import decoded, encoded
from he3.errors import He3Error, InvalidInput
from schemas.commands import CommandKind


@dataclass(slots=True)
class Found:
    """A result."""

    number: int
    values: np.ndarray
    worker: int


def square(folder: Path | None, number: int) -> Found:
    if folder is not None:
        (folder / str(number)).touch(exist_ok=False)
    return Found(number * number, np.arange(number, dtype=np.float32), os.getpid())


def up_to(number: int) -> Iterator[int]:
    yield from range(number)


def refuse_odd(number: int) -> int:
    if number % 2:
        raise InvalidInput(f"expected another number than {number}")
    return number


def first_then_wait(number: int) -> int:
    if number > 1:
        threading.Event().wait()
    return os.getpid()


def test_each_task_comes_with_its_result_and_from_the_store_the_next_time(tmp_path: Path) -> None:
    folder, store = tmp_path / "touched", tmp_path / "tasks.sqlite"
    folder.mkdir()
    with Tasks(1, store=store) as pool:
        found = dict(pool.results(partial(square, folder), range(5)))
        assert {number: one.number for number, one in found.items()} == {n: n * n for n in range(5)}
        assert found[3].values.tolist() == [0.0, 1.0, 2.0]
        assert found[3].values.dtype == np.float32
        assert len({one.worker for one in found.values()}) == 1, "a worker is used again"
        assert list(pool.results(partial(square, folder), [])) == []
        assert list(pool.items(up_to, [3])) == [(3, 0), (3, 1), (3, 2)]
        errors = dict(pool.outcomes(refuse_odd, [2, 3]))
        assert errors[2] == 2
        assert str(errors[3]) == "expected another number than 3"
        with pytest.raises(He3Error, match="expected another number than 5"):
            list(pool.results(refuse_odd, [5]))
    with pytest.raises(ProcessLookupError):
        os.kill(found[0].worker, 0)
    with Tasks(1, store=store) as pool:
        again = dict(pool.results(partial(square, folder), range(5)))
    assert {number: one.worker for number, one in again.items()} == dict.fromkeys(range(5), found[0].worker)


def test_a_value_comes_back_as_it_was() -> None:
    for value in (
        Flight("t1", "tour", "matern52", 3, budget_m=math.inf, start_m=(1.0, 2.5)),
        {"rows": [1, 2.5, None, True, "text"], 3: (Path("a/b"), CommandKind.PAUSE), "~odd": {}},
        [range(3), (), -math.inf],
    ):
        assert decoded(encoded(value)) == (value if not isinstance(value, list) else [(0, 1, 2), (), -math.inf])
    array = np.array([[1, 2], [3, 4]], dtype=np.int16)[:, ::-1]
    assert np.array_equal(decoded(encoded(array)), array)
    assert decoded(encoded(np.float64(0.1))) == 0.1
    assert decoded(encoded(CommandKind.PAUSE)) is CommandKind.PAUSE, "a member that equals its text is no text"
    with pytest.raises(InvalidInput, match="expected a value that a task can have, got set"):
        encoded({1, 2})
    with pytest.raises(InvalidInput, match="expected a function or type of a module"):
        encoded(lambda: None)


def test_a_pool_without_a_job_is_refused() -> None:
    with pytest.raises(InvalidInput, match="expected one job at least, got 0"):
        Tasks(0)


BENCHMARK = """
import sys
from benchmarks.tasks import Tasks
from tests_of_the_pool import first_then_wait

if __name__ == "__main__":
    rows = []
    with Tasks(2) as pool:
        for _, row in pool.results(first_then_wait, [0, 1, 2, 3]):
            rows.append(row)
            sys.stderr.write(f"row {len(rows)}\\n")
            sys.stderr.flush()
        print(pool.stopped.name, len(rows), *rows, flush=True)
    print("not reached")
"""


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.exhaustive), signal.SIGTERM])
def test_a_signal_ends_the_tasks_keeps_the_results_and_is_raised_again(number: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "tests_of_the_pool.py").write_text(Path(__file__).read_text())
    (tmp_path / "benchmark.py").write_text(BENCHMARK)
    path = os.pathsep.join((str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])))
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "benchmark.py")], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        process_group=0, env={**os.environ, "PYTHONPATH": path},
    ) as process:  # fmt: skip
        assert process.stderr is not None
        assert [process.stderr.readline() for _ in range(2)] == ["row 1\n", "row 2\n"]
        os.killpg(process.pid, number)  # as a terminal does it
        said, trace = process.communicate()
    name, count, *workers = said.split()
    assert (name, count) == (number.name, "2")
    assert process.returncode == -number
    assert trace.count("Traceback") == (number == signal.SIGINT)  # Python's own, of this process alone
    for worker in workers:
        with pytest.raises(ProcessLookupError):
            os.kill(int(worker), 0)

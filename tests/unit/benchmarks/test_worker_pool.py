"""The worker pool: results as they arrive, errors raised in the caller, all workers ended at the end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.worker_pool import WorkerPool
from he3.errors import He3Error, InvalidInput


def square(number: int) -> int:
    return number * number


def own_pid(_: int) -> int:
    return os.getpid()


def up_to(number: int) -> Iterator[int]:
    yield from range(number)


def first_then_wait(folder: Path) -> Iterator[int]:
    yield os.getpid()
    threading.Event().wait()


def refuse(number: int) -> int:
    raise InvalidInput(f"expected another number than {number}")


class Unpicklable(Exception):
    def __init__(self, one: str, other: str) -> None:
        super().__init__(one + other)


def refuse_in_a_way_that_cannot_be_pickled(_: int) -> int:
    raise Unpicklable("one", "other")


def die(_: int) -> int:
    os._exit(7)


def test_each_task_comes_with_its_result() -> None:
    with WorkerPool(2) as pool:
        assert dict(pool.results(square, range(7))) == {n: n * n for n in range(7)}
        assert list(pool.results(square, [])) == []


def test_a_task_with_several_items_gives_them_in_order() -> None:
    with WorkerPool(1) as pool:
        assert list(pool.items(up_to, [2, 3])) == [(2, 0), (2, 1), (3, 0), (3, 1), (3, 2)]


def test_an_item_comes_before_its_task_ends_and_the_worker_of_a_task_that_was_left_is_killed(tmp_path: Path) -> None:
    with WorkerPool(1) as pool:
        _, waiting = next(pool.items(first_then_wait, [tmp_path]))
        assert waiting != os.getpid()
        ((_, fresh),) = pool.results(own_pid, [0])
        assert fresh != waiting
        with pytest.raises(ProcessLookupError):
            os.kill(waiting, 0)
    with pytest.raises(ProcessLookupError):
        os.kill(fresh, 0)


def test_a_worker_is_used_again() -> None:
    with WorkerPool(1) as pool:
        first, second = (dict(pool.results(own_pid, [0, 1])) for _ in range(2))
        assert len({*first.values(), *second.values()}) == 1


def test_what_a_function_raises_is_raised_where_its_result_is_wanted() -> None:
    with WorkerPool(1) as pool:
        with pytest.raises(InvalidInput, match="expected another number than 3"):
            list(pool.results(refuse, [3]))
        with pytest.raises(He3Error, match="Unpicklable: oneother"):
            list(pool.results(refuse_in_a_way_that_cannot_be_pickled, [0]))
        assert list(pool.results(square, [3])) == [(3, 9)]


def test_a_worker_that_dies_is_reported_with_its_exit_code() -> None:
    with WorkerPool(1) as pool, pytest.raises(He3Error, match="a worker process ended with exit code 7"):
        list(pool.results(die, [0]))


def test_a_pool_without_a_job_is_refused() -> None:
    with pytest.raises(InvalidInput, match="expected one job at least, got 0"):
        WorkerPool(0)


BENCHMARK = """
import sys
from benchmarks.worker_pool import WorkerPool
from tests_of_the_pool import first_then_wait

if __name__ == "__main__":
    rows = []
    with WorkerPool(2) as pool:
        for _, row in pool.items(first_then_wait, [0, 1, 2, 3]):
            rows.append(row)
            sys.stderr.write(f"row {len(rows)}\\n")
            sys.stderr.flush()
        print(pool.stopped.name, len(rows), *rows, flush=True)
    print("not reached")
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_tasks_keeps_the_results_and_is_raised_again(number: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "tests_of_the_pool.py").write_text(Path(__file__).read_text())
    (tmp_path / "benchmark.py").write_text(BENCHMARK)
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "benchmark.py")], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        process_group=0,
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

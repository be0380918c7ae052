"""The runner and the local engine: every task its row, whatever dies on the way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from he3.errors import He3Error, InvalidInput
from services.console.campaign.engines import LocalEngine, engine_named
from services.console.campaign.identity import software_identity
from services.console.campaign.runner import Progress, run
from services.console.campaign.store import Store
from services.console.campaign.task import DONE, FAILED, LOST, Reply, Task
from services.runtime.instructions import common_instructions

WORK = '''
"""Work of a test."""
import os, pathlib, signal, weakref
from he3.errors import He3Error

def work(arguments):
    number, folder = arguments["number"], pathlib.Path(arguments["folder"])
    with open(folder / str(number), "a") as log:
        log.write(f"{os.getpid()}\\n")
    if number == 3 and len((folder / "3").read_text().split()) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 4:
        raise He3Error("no luck with 4")
    if number == 5:
        os._exit(7)
    print("heard by nobody")
    names = ("PYTHONHASHSEED", "LC_ALL", "OPENBLAS_NUM_THREADS", "OPENBLAS_CORETYPE")
    env = {name: os.environ[name] for name in names if name in os.environ}
    return {"square": number**2, "hash": hash("he3"), "text": f"{1.5:n}", **env}

class Circle:
    made = []

    def __init__(self):
        self.itself = self
        Circle.made.append(weakref.ref(self))

def circle(arguments):
    left = sum(each() is not None for each in Circle.made)
    Circle()
    return {"left": left}

def nan(arguments):
    return {"figure": float("nan")}
'''


@pytest.fixture(name="work")
def _work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "work_of_a_test.py").write_text(WORK)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    (tmp_path / "log").mkdir()
    return tmp_path


def tasks_of(work: Path, numbers: Iterator[int] | range | list[int], function: str = "work") -> list[Task]:
    software = software_identity("work_of_a_test")
    return [
        Task(f"work_of_a_test:{function}", {"number": n, "folder": str(work / "log")}, software, {"seed": n})
        for n in numbers
    ]


def test_a_worker_keeps_nothing_of_the_tasks_before(work: Path) -> None:
    with Store(work / "s.sqlite", write=True) as store, LocalEngine(1) as engine:
        run(tasks_of(work, range(4), "circle"), store, engine)
        assert [row.result for row in store.rows()] == [{"left": 0}] * 4


def test_every_task_has_its_row_although_workers_die_and_none_is_computed_twice(
    work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONHASHSEED", "5")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    for name in common_instructions():
        monkeypatch.setenv(name, "of this host alone")
    with Store(work / "s.sqlite", write=True) as store, LocalEngine(2) as engine:
        run(tasks_of(work, range(3)), store, engine)
        done = run(tasks_of(work, [*range(6), 2]), store, engine)
        assert (done.total, done.kept, done.done, done.failed, done.left) == (6, 3, 1, 2, 0)
        rows = {row.labels["seed"]: row for row in store.rows()}
    assert sorted(rows) == list(range(6))
    log = {number: len((work / "log" / str(number)).read_text().split()) for number in range(6)}
    assert log == {0: 1, 1: 1, 2: 1, 3: 2, 4: 1, 5: 3}, "a killed worker's task is computed again, a failed one is not"
    assert rows[4].error == "no luck with 4"
    assert rows[5].error == "the worker process ended 3 times, at last with exit code 7"
    environment = {"PYTHONHASHSEED": "0", "LC_ALL": "C", "OPENBLAS_NUM_THREADS": "1"}
    environment |= {name: value for name, value in common_instructions().items() if name == "OPENBLAS_CORETYPE"}
    seen: set[Any] = set()
    for number in range(4):
        result = dict(rows[number].result or {})
        assert result.pop("square") == number**2
        seen.add(result.pop("hash"))
        assert result == {"text": "1.5", **environment}
    assert len(seen) == 1


def test_a_failed_task_is_computed_again_on_demand_only(work: Path) -> None:
    with Store(work / "s.sqlite", write=True) as store, LocalEngine(1) as engine:
        one = tasks_of(work, [4])
        assert run(one, store, engine).failed == 1
        again = run(one, store, engine)
        assert (again.kept, again.failed, again.failed_before) == (1, 0, 1)
        assert run(one, store, engine, retry_failed=True).failed == 1
        nan = run(tasks_of(work, [0], "nan"), store, engine)
        assert nan.failed == 1
        assert "JSON" in nan.last_error or "float" in nan.last_error


def test_a_worker_of_other_software_is_refused_in_one_line(work: Path) -> None:
    (task,) = tasks_of(work, [0])
    other = Task(task.work, task.arguments, "he3-seeker-9.9.9+0", task.labels)
    with Store(work / "s.sqlite", write=True) as store, LocalEngine(1) as engine:
        with pytest.raises(
            InvalidInput, match=r"expected the campaign's software, he3-seeker-9.9.9\+0; got he3-seeker-"
        ):
            run([other], store, engine)
        assert list(store.rows()) == []


class Gone:
    """An engine that computes one task and is gone then."""

    workers = 1
    about = "an engine that is soon gone"

    def __init__(self) -> None:
        self._replies: list[tuple[Task, Reply]] = []
        self._status = DONE

    def submit(self, task: Task) -> None:
        self._replies.append((task, Reply(self._status, {"figure": 1.0})))
        self._status = LOST

    def replies(self, timeout_s: float) -> list[tuple[Task, Reply]]:
        found, self._replies = self._replies, []
        return found

    def close(self) -> None: ...

    def __enter__(self) -> Gone:
        return self

    def __exit__(self, *_: object) -> None: ...


def test_what_came_before_an_engine_was_gone_is_in_the_store(tmp_path: Path) -> None:
    tasks = [Task("some:work", {"number": number}, "this") for number in range(4)]
    with Store(tmp_path / "s.sqlite", write=True) as store:
        with pytest.raises(He3Error, match="1 of 4 are in the store: the same command continues"):
            run(tasks, store, Gone())
        assert len(list(store.rows())) == 1


def test_progress_says_rate_time_left_failures_and_means() -> None:
    progress = Progress(10, kept=2, workers=2)
    for figure in (1.0, 2.0, 3.0):
        progress.add(Reply(DONE, {"rmse_ppb": figure, "name": "x", "completed": True}, wall_s=3.0))
    progress.add(Reply(FAILED, error="no luck", wall_s=3.0))
    progress.elapsed_s = 8.0
    assert progress.left == 4
    assert progress.busy == 0.75
    assert progress.line(["rmse_ppb"]) == "6/10  30.0 a minute  8 s left  1 failed  map RMSE 2 ppb"


@pytest.mark.parametrize(
    ("name", "workers", "refusal"),
    [
        ("grid", None, "expected local, dask or dask:ADDRESS, got 'grid'"),
        ("local:7", None, "expected local, dask"),
        ("dask:", None, "expected local, dask"),
        ("dask:tcp://127.0.0.1:1", 2, "a cluster has its own workers"),
        ("local", 0, "expected one at least, got 0"),
    ],
)
def test_an_engine_that_does_not_exist_is_refused(name: str, workers: int | None, refusal: str) -> None:
    with pytest.raises(InvalidInput, match=refusal):
        engine_named(name, workers)


WAITING = """
import sys, threading
from pathlib import Path
from services.console.campaign.engines import LocalEngine
from services.console.campaign.identity import software_identity
from services.console.campaign.task import Task

with LocalEngine(1) as engine:
    software = software_identity("work_of_a_test")
    engine.submit(Task("work_of_a_test:work", {"number": 0, "folder": sys.argv[1]}, software))
    engine.replies(60)
    print(Path(sys.argv[1], "0").read_text().strip(), flush=True)
    threading.Event().wait()
"""


def test_worker_processes_end_with_a_runner_that_is_killed(work: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", WAITING, str(work / "log")], stdout=subprocess.PIPE, text=True) as one:
        assert one.stdout is not None
        worker = int(one.stdout.readline())
        descriptor = os.pidfd_open(worker)
        one.send_signal(signal.SIGKILL)
        import select

        assert select.select([descriptor], [], [], 20)[0], "the worker process ends"
        os.close(descriptor)

"""A test run, a benchmark or a worker of either that is killed with `kill -9` leaves no process behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

import pytest

from tests.processes import he3, start
from tests.waiting import expect_within, until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")

MARK = "HE3_TEST_MARK"
"""Environment variable by which every process below a test run is found, wherever it was moved to."""

A_TEST_THAT_WAITS = """
import threading
from pathlib import Path

def test_that_waits(missions):
    mission = missions("short", "--rate", "100")
    mission.start("link", "field", "rover", "ground")
    mission.start("recorder", flags=["--out", str(Path(__file__).parent / "mission.mcap")])
    mission.ready()
    (Path(__file__).parent / "ready").touch()
    threading.Event().wait()
"""


class Marked:
    """All processes whose environment holds one mark."""

    def __init__(self) -> None:
        self.mark = uuid4().hex
        self.environment = {MARK: self.mark}

    def pids(self) -> dict[int, str]:
        """Command lines of those that run."""
        found = {}
        for folder in Path("/proc").iterdir():
            if folder.name.isdigit():
                try:
                    if f"{MARK}={self.mark}".encode() in (folder / "environ").read_bytes():
                        found[int(folder.name)] = (folder / "cmdline").read_text().replace("\0", " ")
                except OSError:
                    continue
        return found

    def wait_until_gone(self) -> None:
        until(lambda: not self.pids(), lambda: f"the end of {self.pids()}")


@pytest.fixture
def marked() -> Iterator[Marked]:
    processes = Marked()
    yield processes
    for pid in processes.pids():
        os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize(
    "killed", ["controller", *(pytest.param(name, marks=pytest.mark.exhaustive) for name in ("alone", "worker"))]
)
def test_a_test_run_that_is_killed_leaves_no_service(killed: str, marked: Marked, tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text("from tests.integration.conftest import *\n")
    (tmp_path / "test_that_waits.py").write_text(A_TEST_THAT_WAITS)
    flags = ["-p", "no:cacheprovider", "-p", "no:randomly", "--rootdir", str(tmp_path)]
    flags += [] if killed == "alone" else ["-n", "1"]
    command = [sys.executable, "-m", "pytest", "-q", *flags, str(tmp_path)]
    with start(command, env=marked.environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as run:
        until(lambda: (tmp_path / "ready").exists() or run.poll() is not None, "the services to be ready")
        assert run.poll() is None
        services = {pid: line for pid, line in marked.pids().items() if "services." in line}
        assert len(services) >= 5, services
        if killed == "worker":
            (worker,) = {parent_of(pid) for pid, line in services.items() if "services.link" in line}
            assert worker != run.pid
            os.kill(worker, signal.SIGKILL)
            until(lambda: not services.keys() & marked.pids().keys(), lambda: f"the end of {marked.pids()}")
        run.kill()
        marked.wait_until_gone()


@pytest.mark.parametrize("killed", ["benchmark", "worker"])
def test_a_benchmark_that_is_killed_leaves_no_process_and_no_file(killed: str, marked: Marked, tmp_path: Path) -> None:
    plugin = "examples.most_uncertain:most_uncertain"  # plug-ins plan in processes of their own, below the workers
    command = he3("bench", "paper", "--planners", plugin, "--regions", "t1", "--seeds", "9", "--no-floor")
    environment = {**marked.environment, "TMPDIR": str(tmp_path)}
    with start(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as benchmark:
        until(lambda: planners_of(marked), "a planner process")
        if killed == "worker":  # another one takes its place, and flies its mission
            planner, worker = next(iter(planners_of(marked).items()))
            os.kill(worker, signal.SIGKILL)
            until(lambda: planner not in marked.pids(), lambda: f"the end of {planner} among {marked.pids()}")
            until(lambda: worker_processes(marked) >= 2, lambda: f"another worker among {marked.pids()}")
            assert benchmark.poll() is None
        benchmark.kill()
        marked.wait_until_gone()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "code"), [pytest.param(signal.SIGINT, 130, marks=pytest.mark.exhaustive), (signal.SIGTERM, 143)]
)
def test_a_benchmark_that_a_signal_ends_keeps_the_rows_that_it_has(
    number: signal.Signals, code: int, marked: Marked, quarter_of_t1: Path, tmp_path: Path
) -> None:
    out = tmp_path / "rows.json"
    flags = ["--region", str(quarter_of_t1), "--planners", "rrt,tour", "--seeds", "1", "--json", str(out)]
    command = he3("bench", "paper", *flags)
    with start(command, env=marked.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as benchmark:
        assert "1/2" in benchmark.stderr.readline()  # the tour is being planned still
        told_at = time.monotonic()
        benchmark.send_signal(number)
        said, errors = benchmark.communicate()
        expect_within(2.0, time.monotonic() - told_at, "the end of the benchmark")
    assert benchmark.returncode == code
    document = json.loads(out.read_text())
    assert [row["planner"] for row in document["rows"]] == ["rrt"]
    assert document["stopped_by"] == number.name
    assert f"stopped by {number.name}: 1 rows so far" in said
    assert "Traceback" not in errors
    marked.wait_until_gone()


def planners_of(marked: Marked) -> dict[int, int]:
    """The planner processes, each with its parent, a worker process."""
    found = {}
    for pid, line in marked.pids().items():
        if "planner_server" in line:
            with suppress(OSError):  # it has ended since
                found[pid] = parent_of(pid)
    return found


def worker_processes(marked: Marked) -> int:
    """How many worker processes there are."""
    return sum("services.console.campaign.worker" in line for line in marked.pids().values())


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])

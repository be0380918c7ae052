"""`kill -9` on a process that started others: every descendant ends, children of children included."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.runtime.child import ROOT, child_environment, python_command
from services.runtime.entry import PARENT
from tests.processes import run
from tests.waiting import until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")

STARTER = """
import subprocess, sys
from services.runtime.child import child_environment
subprocess.run(sys.argv[1:], env=child_environment())
"""
"""A process that starts one of ours, as a test or a benchmark does."""

THROUGH_A_SHELL = """
import subprocess, sys
from services.runtime.child import child_environment
subprocess.run(["sh", "-c", '"$@"; sleep 600', "sh", *sys.argv[1:]], env=child_environment())
"""
"""A starter with a process in between that outlives its parent, so that the kernel does not report its end."""

WANTED = (
    "services.console", "services.link", "services.field", "services.rover", "services.ground", "services.recorder",
    "services.ground.map.process", "planner_server",
)  # fmt: skip


def descendants(pid: int) -> dict[int, str]:
    """Command lines of all processes below that one."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except (OSError, IndexError):
                continue
    below = {pid}
    while more := {child for child, parent in parents.items() if parent in below} - below:
        below |= more
    return {each: command_line(each) for each in below - {pid}}


def command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except OSError:
        return ""


def running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def ours(pid: int) -> dict[int, str]:
    """The descendants that run code of this project."""
    return {each: line for each, line in descendants(pid).items() if "services." in line}


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    (tmp_path / "runtime").mkdir()
    return {**child_environment(), "XDG_RUNTIME_DIR": str(tmp_path / "runtime")}


@pytest.fixture
def starter(
    request: pytest.FixtureRequest, tmp_path: Path, environment: dict[str, str], coarse_t1: Path
) -> Iterator[int]:
    """Process id of a process that has started a whole mission; all of that mission's processes run."""
    flags = ("--rate", "100", "--quiet", "--out", str(tmp_path / "out"), "--set", f"region={coarse_t1}")
    he3 = python_command("services.console", "run", "short", *flags)
    command = [sys.executable, "-c", request.param, *he3]
    process = subprocess.Popen(
        command, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    left: dict[int, str] = {}
    try:

        def started() -> bool:
            nonlocal left
            assert process.poll() is None, "the mission ended by itself"
            left = ours(process.pid)
            return all(any(wanted in line for line in left.values()) for wanted in WANTED)

        until(started, lambda: f"other processes than {left}")
        yield process.pid
    finally:
        left |= descendants(process.pid)
        for pid in (process.pid, *left):
            if running(pid):
                os.kill(pid, signal.SIGKILL)
        process.wait()


def assert_gone(pids: dict[int, str]) -> None:
    until(
        lambda: not any(running(pid) for pid in pids),
        lambda: f"the end of {[line for pid, line in pids.items() if running(pid)]}",
    )


@pytest.mark.parametrize(
    "starter",
    [
        pytest.param(STARTER, id="direct", marks=pytest.mark.exhaustive),
        pytest.param(THROUGH_A_SHELL, id="through-a-shell"),
    ],
    indirect=True,
)
def test_a_whole_mission_ends_when_the_process_that_started_it_is_killed(starter: int) -> None:
    below = ours(starter)
    os.kill(starter, signal.SIGKILL)
    assert_gone({pid: line for pid, line in below.items() if not line.startswith("sh ")})


@pytest.mark.parametrize("starter", [STARTER], indirect=True, ids=["direct"])
@pytest.mark.parametrize("victim", [pytest.param("services.console", marks=pytest.mark.exhaustive), "services.ground "])
def test_the_children_of_a_killed_process_end(starter: int, victim: str) -> None:
    (pid,) = [pid for pid, line in ours(starter).items() if victim in line and "-c" not in line.split()]
    below = ours(pid)
    assert len(below) >= 2
    os.kill(pid, signal.SIGKILL)
    assert_gone(below)


def test_a_process_whose_parent_is_gone_already_ends_at_once(environment: dict[str, str]) -> None:
    """It would wait for its router for ever."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    command = python_command("services.rover", "short", "--moon", "tcp/127.0.0.1:9", "--earth", "tcp/127.0.0.1:9")
    assert run(command, env={**environment, PARENT: str(gone.pid)}).returncode == 0


def test_a_process_that_a_user_starts_by_hand_outlives_its_parent(tmp_path: Path) -> None:
    """As `python -m services.rover ... & disown` does, when the shell ends."""
    command = python_command("services.rover", "short", "--moon", "tcp/127.0.0.1:9", "--earth", "tcp/127.0.0.1:9")
    log = tmp_path / "rover.log"
    code = f"import subprocess; print(subprocess.Popen({command!r}, stdout=-3, stderr=open({str(log)!r}, 'w')).pid)"
    shell = subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.PIPE, text=True)
    rover = int(shell.stdout)
    try:

        def looked_for_its_router() -> bool:  # long after its parent has ended
            assert running(rover), log.read_text()
            return "still trying" in log.read_text()

        until(looked_for_its_router, "the rover to look for its router")
        os.kill(rover, signal.SIGTERM)
        assert_gone({rover: "services.rover"})
    finally:
        if running(rover):
            os.kill(rover, signal.SIGKILL)

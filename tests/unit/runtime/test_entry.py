"""Importing changes nothing, and the environment of a process is set before it imports numpy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from services.ground.planner_process import PlannerProcess
from services.runtime.child import ROOT, child_environment, python_command
from services.runtime.entry import PARENT

IMPORT_EVERYTHING = """
import os, pkgutil, signal, sys

def state():
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    return dict(os.environ), list(sys.path), handlers

before = state()
import he3, schemas, services
for package in (he3, schemas, services):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        __import__(module.name)
        assert state() == before, module.name
assert "numpy" in sys.modules
"""

WATCH_NUMPY = """
import os, runpy, sys

class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            sys.stderr.write("numpy sees " + os.environ.get("OPENBLAS_NUM_THREADS", "nothing") + "\\n")

sys.meta_path.insert(0, Watch())
sys.argv = sys.argv[1:]
runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
"""


def bare_environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}


def test_importing_any_module_changes_no_environment_no_path_and_no_signal_handler() -> None:
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_EVERYTHING], capture_output=True, text=True, env=bare_environment()
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        *([f"services.{name}", "short", "--help"] for name in ("field", "rover", "link", "ground", "recorder")),
        ["services.ground.map.process", "earth", "tcp/127.0.0.1:9", "short"],
        ["services.console", "region", "show", "t1"],
        ["benchmarks.floor", "--help"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_numpy_is_first_imported_with_one_blas_thread(arguments: list[str]) -> None:
    command = [sys.executable, "-c", WATCH_NUMPY, *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, env=bare_environment(), stdin=subprocess.DEVNULL, cwd=ROOT
    )
    seen = [line for line in done.stderr.splitlines() if line.startswith("numpy sees")]
    assert seen[:1] == ["numpy sees 1"], done.stderr


def test_the_planner_process_has_one_blas_thread_whatever_its_owner_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    with PlannerProcess() as planners:
        assert planners.submit(os.getenv, "OPENBLAS_NUM_THREADS").result(60) == "1"


def test_a_number_of_threads_that_the_user_asks_for_reaches_the_children(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    assert child_environment()["OPENBLAS_NUM_THREADS"] == "3"


def test_a_child_is_told_who_its_parent_is_and_does_not_tell_its_own_children() -> None:
    assert child_environment()[PARENT] == str(os.getpid())
    code = f"import os; from services.runtime.entry import end_with_parent as e; e(); print(os.getenv({PARENT!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=child_environment(), cwd=ROOT
    )
    assert done.stdout == "None\n"


@pytest.fixture
def strange_folder(tmp_path: Path) -> Path:
    """A working directory with modules named as ours and as Python's own, none of which may be imported."""
    for name in ("random", "socket", "queue", "signal", "json", "numpy", "pydantic", "zenoh"):
        (tmp_path / f"{name}.py").write_text(f"raise SystemExit('the {name} of the working directory')\n")
    for name in ("he3", "schemas", "services"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"raise SystemExit('the {name} of the working directory')\n")
    return tmp_path


@pytest.mark.parametrize("name", ["field", "rover", "link", "ground", "recorder", "console"])
def test_a_child_imports_nothing_from_the_working_directory(name: str, strange_folder: Path) -> None:
    done = subprocess.run(
        python_command(f"services.{name}", "--help"),
        capture_output=True, text=True, cwd=strange_folder, env=child_environment(),
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert "Usage" in done.stdout or "usage" in done.stdout


@pytest.mark.parametrize("name", ["rover", "ground", "console"])
def test_a_service_started_by_hand_passes_over_modules_of_the_working_directory(
    name: str, strange_folder: Path
) -> None:
    """Python itself takes `services` from there, if there is one; every other name is ours or Python's own."""
    for other in ("he3", "schemas", "services"):
        (strange_folder / other / "__init__.py").unlink()
        (strange_folder / other).rmdir()
    done = subprocess.run(
        [sys.executable, "-m", f"services.{name}", "--help"],
        capture_output=True, text=True, cwd=strange_folder,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("given", ["", os.pathsep, f".{os.pathsep}/nowhere", f"/nowhere{os.pathsep}"])
def test_an_empty_entry_of_the_path_is_not_the_working_directory(
    given: str, strange_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", given)
    monkeypatch.chdir(strange_folder)
    show = "import sys; from services.runtime.entry import forget_working_directory as f; f(); print(sys.path)"
    for environment in (child_environment(), {**os.environ, "PYTHONPATH": os.pathsep.join((ROOT, given))}):
        command = [sys.executable, "-P", "-c", show]
        done = subprocess.run(command, capture_output=True, text=True, cwd=strange_folder, env=environment, check=True)
        assert not {"''", "'.'", repr(str(strange_folder))} & set(done.stdout.strip("[]\n").split(", "))


def test_in_a_checkout_that_is_installed_its_root_is_on_the_path_once_and_not_first() -> None:
    show = "import sys; from services.runtime.entry import forget_working_directory as f; f(); print(sys.path)"
    command = [sys.executable, "-c", f"import sys; sys.path.append({ROOT!r}); {show}"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    assert not done.stdout.startswith(("['',", f"[{ROOT!r},"))


def test_a_planner_task_imports_nothing_from_the_working_directory(
    strange_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(strange_folder)
    with PlannerProcess() as planners:
        assert planners.submit(len, (1, 2)).result(60) == 2

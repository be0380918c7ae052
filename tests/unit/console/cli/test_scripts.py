"""The scripts of a checkout."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import pytest

from tests.waiting import expect_within

ROOT = Path(__file__).parents[4]


def current() -> bool:
    """Whether .venv is what `scripts/setup` would make: only then may a test run it."""
    stamp = ROOT / ".venv" / "he3-setup.sha256"
    sources = b"".join(
        (ROOT / name).read_bytes() for name in ("requirements-dev.lock", "pyproject.toml", "scripts/setup")
    )
    wanted = subprocess.run(["sha256sum"], input=sources, capture_output=True, check=True).stdout
    return stamp.is_file() and stamp.read_bytes().strip() == wanted.strip()


def locked(name: str) -> list[str]:
    """The lines of a lock that name a package with its version."""
    return [line for line in (ROOT / name).read_text().splitlines() if line and line[0].isalnum()]


def test_what_a_mission_runs_with_is_locked_without_tools_of_development_and_at_their_versions() -> None:
    runtime, every, build = (
        {line.split()[0] for line in locked(f"requirements{kind}.lock")} for kind in ("", "-dev", "-build")
    )
    assert runtime < every
    assert build < every
    tools = {line.partition("==")[0] for line in every - runtime}
    assert {"mypy", "pytest", "ruff", "hypothesis", "import-linter", "selenium", "vulture", "scikit-learn"} <= tools
    assert {"numpy", "eclipse-zenoh", "ompl", "starlette", "cryptography"} <= {
        line.partition("==")[0] for line in runtime
    }


@pytest.mark.parametrize(
    "name", ["scripts/sbom", "scripts/setup", "scripts/demo", "scripts/test", "scripts/lock", ".ci/run"]
)
def test_every_script_can_be_run_and_is_plain_shell(name: str) -> None:
    assert os.access(ROOT / name, os.X_OK)
    subprocess.run(["sh", "-n", str(ROOT / name)], check=True)


def test_setup_is_quick_and_silent_when_it_is_current() -> None:
    if not current():
        pytest.skip("the environment was not made by scripts/setup, or not from this lock")
    began = time.monotonic()
    done = subprocess.run([ROOT / "scripts" / "setup"], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
    expect_within(1.0, time.monotonic() - began, "a setup that has nothing to do")


@pytest.mark.parametrize("name", ["requirements.lock", "requirements-dev.lock", "requirements-build.lock"])
def test_a_lock_names_every_package_with_its_hashes_and_nothing_of_the_machine(name: str) -> None:
    text = (ROOT / name).read_text()
    packages = locked(name)
    assert packages
    assert all("==" in line for line in packages)
    assert text.count("--hash=sha256:") >= len(packages)
    assert "://" not in text
    assert str(Path.home()) not in text

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
    sources = b"".join((ROOT / name).read_bytes() for name in ("requirements.lock", "pyproject.toml", "scripts/setup"))
    wanted = subprocess.run(["sha256sum"], input=sources, capture_output=True, check=True).stdout
    return stamp.is_file() and stamp.read_bytes().strip() == wanted.strip()


@pytest.mark.parametrize("name", ["scripts/setup", "scripts/demo", "scripts/test", "scripts/lock", ".ci/run"])
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


def test_the_lock_names_every_package_with_its_hashes_and_nothing_of_the_machine() -> None:
    text = (ROOT / "requirements.lock").read_text()
    packages = [line for line in text.splitlines() if line and line[0].isalnum()]
    assert len(packages) > 40
    assert all("==" in line for line in packages)
    assert text.count("--hash=sha256:") >= len(packages)
    assert "://" not in text
    assert str(Path.home()) not in text

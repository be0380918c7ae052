"""The units of deploy/systemd: valid, closed to what the services do not need, and one for each process."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from services.mission.deployment import deployment
from services.mission.processes import PROCESSES

UNITS = sorted(deployment("systemd").glob("*.service"))
MOST_EXPOSED = 2.0
"""Of ten, as `systemd-analyze security` counts."""
needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="no systemd-analyze: apt-get install systemd"
)


def analysed(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *words], capture_output=True, text=True, check=False)


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """The units, with the interpreter of this machine in place of the installed one."""
    for unit in UNITS:
        (tmp_path / unit.name).write_text(unit.read_text().replace("/opt/he3/bin/python", sys.executable))
    return tmp_path


def test_there_is_a_unit_for_each_process_and_for_the_page() -> None:
    assert {unit.stem for unit in UNITS} == {f"he3-{each.name}" for each in PROCESSES} | {"he3-web"}


@needs_systemd
@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_systemd_finds_nothing_to_say_of_a_unit(unit: Path, here: Path) -> None:
    done = analysed("verify", "--recursive-errors=no", str(here / unit.name))
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "")


@needs_systemd
@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_is_hardly_exposed(unit: Path, here: Path) -> None:
    done = analysed("security", "--offline=true", "--no-pager", str(here / unit.name))
    exposure = re.search(r"Overall exposure level for \S+: ([\d.]+)", done.stdout)
    assert exposure is not None, done.stderr
    assert float(exposure[1]) < MOST_EXPOSED

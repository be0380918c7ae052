"""`he3 demo`: a mission with the published protocol beside it; both end by themselves, and both end on Ctrl-C."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

from schemas.report import MissionReport
from tests.processes import he3, run, start
from tests.waiting import expect_within, until

GONE_WITHIN_S = 2.0
"""How long all processes of a demo may take to end, as promised."""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    runtime = tmp_path / "runtime"
    runtime.mkdir()
    return {**os.environ, "XDG_RUNTIME_DIR": str(runtime)}


def children_of(pid: int) -> dict[int, str]:
    """Command line by process id of each child."""
    found = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                command = (folder / "cmdline").read_text().replace("\0", " ")
            except OSError:
                continue
            if parent == pid:
                found[int(folder.name)] = command
    return found


def test_the_demo_ends_with_a_line_that_compares_it_with_the_published_protocol_on_the_same_seed(
    tmp_path: Path, environment: dict[str, str], coarse_t1: Path
) -> None:
    out = tmp_path / "demo"
    shorter = ("--set", "rounds=1", "--set", "samples_per_round=3", "--set", f"region={coarse_t1}")
    ended = run(he3("demo", *shorter, "--seed", "5", "--out", str(out)), env=environment)
    assert ended.returncode == 0, ended.stderr
    report = MissionReport.model_validate_json((out / "report.json").read_text())
    assert (report.scenario, report.planner, report.seed, report.samples) == ("t1", "tour", 5, 3)
    figures = r"\d+\.\d\d ppb after \d+\.\d km"
    line = ended.stdout.splitlines()[-1]
    assert re.fullmatch(rf"tour: {figures}; published protocol \(t1-paper, same seed\): {figures}", line), line
    assert f"tour: {report.rmse_ppb:.2f} ppb" in line


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_mission_and_the_published_protocol_beside_it(
    tmp_path: Path, environment: dict[str, str], number: signal.Signals
) -> None:
    command = he3("demo", "--out", str(tmp_path / "demo"))
    with start(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment) as process:
        try:
            # Five services, and the mission beside them.
            until(lambda: len(children_of(process.pid)) == 6, "all processes of the demo to be started")
            children = children_of(process.pid)
            (beside,) = (pid for pid, command in children.items() if " t1-paper " in command)
            assert os.getpriority(os.PRIO_PROCESS, beside) == 19
            told_at = time.monotonic()
            process.send_signal(number)
            process.communicate()
            assert process.returncode == 128 + number
            until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children), "the processes to end")
            expect_within(GONE_WITHIN_S, time.monotonic() - told_at, "the end of the demo", processes=2)
        finally:
            process.kill()

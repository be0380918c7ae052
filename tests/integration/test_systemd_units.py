"""The units of deploy/systemd: valid, closed to what the services do not need, and one for each process."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
from contextlib import ExitStack, suppress
from datetime import timedelta
from pathlib import Path

import pytest

from schemas.roles import Role
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.console.launch.keys import issue_for_processes
from services.mission.deployment import deployment
from services.mission.processes import PROCESSES
from services.runtime.trust.audit import file_lines, verify
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import Subject
from tests.confined import NUMBERS, settings
from tests.processes import start
from tests.waiting import PATIENCE_S, until

CONFINED = Path(__file__).parents[1] / "confined.py"

UNITS = sorted(deployment("systemd").glob("*.service"))
AUDITED = ("link", "ground", "rover")
"""The processes that carry out what people order."""
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


def test_who_commands_and_changes_a_mission_of_units_is_written_down() -> None:
    for unit in UNITS:
        name = unit.stem.removeprefix("he3-")
        expected = f"--audit %S/he3/{name}/audit.jsonl"
        assert (expected in settings(unit)["ExecStart"][0]) == (name in AUDITED)


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


# --- the commands of the units, under their restrictions -------------------------------------------------------------


class Started:
    """The command of a unit as a process under the unit's restrictions, and what it tells its service manager."""

    def __init__(self, unit: Path, replaced: dict[str, str], folder: Path, flags: str) -> None:
        self.name = unit.stem
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(folder / f"{unit.stem}.notify"))
        self._socket.setblocking(False)
        self.said: set[str] = set()
        command = settings(unit)["ExecStart"][0].replace("$FLAGS", flags)
        for name, value in replaced.items():
            command = command.replace(name, value)
        self.log = folder / f"{unit.stem}.log"
        environment = {
            "NOTIFY_SOCKET": str(folder / f"{unit.stem}.notify"), "WATCHDOG_USEC": "1500000",
            "XDG_RUNTIME_DIR": str(folder),
        }  # fmt: skip
        with self.log.open("wb") as log:
            confining = [sys.executable, "-P", str(CONFINED), str(unit)]
            self.process = start([*confining, *command.split()], env=environment, stdout=log, stderr=log)

    def has_said(self, word: str) -> bool:
        """Whether it has told its manager that; fails if it has ended first."""
        with suppress(BlockingIOError):
            while True:
                self.said.add(self._socket.recv(100).decode())
        assert word in self.said or self.process.poll() is None, self.log.read_text()
        return word in self.said

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._socket.close()


@pytest.mark.exhaustive
@needs_systemd
@pytest.mark.skipif(not NUMBERS.exists(), reason="no numbers of system calls for x86-64: apt-get install libc6-dev")
def test_the_commands_of_all_units_run_a_mission_under_their_restrictions(tmp_path: Path) -> None:
    keys = Authority.create(tmp_path / "keys")
    issue_for_processes(keys, timedelta(days=1))
    keys.issue(Subject(Role.OPERATOR, "web"))
    endpoints = free_endpoints("tls")
    scenario = tmp_path / "mission.toml"
    network = f'rate = 2000.0\n[network]\nmoon = "{endpoints.moon}"\nearth = "{endpoints.earth}"\n'
    text = deployment("scenarios", "short.toml").read_text()
    scenario.write_text(text.replace("rounds = 3", "rounds = 1").replace("[ground]", f"{network}[ground]", 1))
    with ExitStack() as stack:
        services = []
        for unit in UNITS:
            name = unit.stem.removeprefix("he3-")
            identity = keys.folder / "identities" / ("operator-web" if name == "web" else f"{name}-main")
            replaced = {
                "/opt/he3/bin/python": sys.executable, "/etc/he3/mission.toml": str(scenario),
                "%d": str(identity), "%S": str(tmp_path / "state"),
            }  # fmt: skip
            flags = f"--mission short --earth {endpoints.earth} --port 0 --authority" if name == "web" else ""
            if name == "web":
                (tmp_path / "state" / "he3" / "web").mkdir(parents=True)
                until(lambda: services[0].has_said("READY=1"), "a service to be ready")
            services.append(Started(unit, replaced, tmp_path, flags))
            stack.callback(services[-1].close)
        for word in ("READY=1", "WATCHDOG=1"):
            until(lambda word=word: all(each.has_said(word) for each in services), f"{word} of every unit")
        viewer = keys.folder / "identities" / "viewer-launcher"
        with MissionClient(endpoints.earth, "short", identity=viewer) as client:
            until(lambda: client.status().is_over, "the end of the mission")
            assert client.status().samples == 3
        for each in services:
            # A socket keeps few messages: those of a long mission would leave no room for the last one.
            assert each.has_said("WATCHDOG=1")
            each.process.terminate()
        for each in services:
            each.process.wait(PATIENCE_S)
            assert each.has_said("STOPPING=1")
    assert (tmp_path / "state" / "he3" / "recorder" / "mission.mcap").stat().st_size > 0
    for name in AUDITED:
        verdict = verify(file_lines(tmp_path / "state" / "he3" / name / "audit.jsonl"))
        assert (verdict.fault, verdict.lines > 0) == (None, True)
    logs = "".join(each.log.read_text() for each in services)
    assert "not permitted" not in logs
    assert "Traceback" not in logs

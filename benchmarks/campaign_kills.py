"""Campaigns under kill -9: runner, workers and scheduler at random; the rows beside those of an undisturbed run.

Two campaigns fly the same missions of `short`. One is left in peace, on local workers. During the other, something is
killed every few seconds: the command itself, a worker process, and with a Dask cluster its workers and its scheduler.
What was killed is started again, the command as an operator would. A run counts as

    missing    a mission without a row
    unequal    a mission whose row is not that of the undisturbed run, to the byte

No mission can have two rows, by the store's key; `flown_twice` counts those that were computed although they had one.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.flights import Row, written
from he3.errors import He3Error
from services.console.campaign.store import Store
from services.console.campaign.study import load_study
from services.console.campaign.task import canonical
from services.console.launch.endpoints import free_endpoints
from services.runtime.child import child_environment, python_command

STUDY = """name = "kills"
scenarios = ["short"]
seeds = {missions}
[set]
rounds = {rounds}
"""


def run(
    missions: int = 2000,
    rounds: int = 3,
    cluster: bool = True,
    every: float = 5.0,
    seed: int = 1,
    folder: Path | None = None,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> Row:
    """The counts; printed, and written to `json`. Raises He3Error if a row is missing or unequal.

    rounds: of each mission; `short` has 3. cluster: disturb a Dask cluster of two workers, else two local workers.
    every: seconds between two kills, on average. folder: keep study and stores there, so that a run that was ended
    continues.
    """
    with ExitStack() as stack:
        place = (
            Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="he3-kills-"))) if folder is None else folder
        )
        place.mkdir(parents=True, exist_ok=True)
        study = place / "kills.toml"
        study.write_text(STUDY.format(missions=missions, rounds=rounds))
        calm, wild = place / "calm.sqlite", place / "wild.sqlite"
        killed = Disturbed(study, wild, cluster, every, np.random.default_rng(seed)).flown()
        say("killed: " + ", ".join(f"{count} times a {name}" for name, count in sorted(killed.items())))
        subprocess.run(_command(study, calm, "local"), env=child_environment(), check=True, stdout=subprocess.DEVNULL)
        keys = {task.key for task in load_study(study).tasks()}
        (expected, _), (found, twice) = _rows(calm), _rows(wild)
        row: Row = {
            "missions": missions,
            "rows": len(found),
            "missing": len(keys - found.keys()),
            "unequal": sum(found[key] != expected.get(key) for key in keys & found.keys()),
            "flown_twice": twice,
            "killed": dict(killed),
        }
    say("  ".join(f"{name} {row[name]}" for name in ("missions", "rows", "missing", "unequal", "flown_twice")))
    written([row], json, say)
    if row["missing"] or row["unequal"] or row["rows"] != missions or row["flown_twice"]:
        raise He3Error(f"{row['missing']} rows are missing, {row['unequal']} unequal, {row['flown_twice']} flown twice")
    return row


class Disturbed:
    """A campaign during which processes are killed."""

    def __init__(self, study: Path, store: Path, cluster: bool, every_s: float, rng: np.random.Generator) -> None:
        self._every_s, self._rng = every_s, rng
        self._killed: Counter[str] = Counter()
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._commands: dict[str, list[str]] = {}
        if cluster:
            address = free_endpoints().moon.removeprefix("tcp/")
            host, _, port = address.rpartition(":")
            dask = [sys.executable, "-P", "-m", "dask"]
            self._commands["scheduler"] = [*dask, "scheduler", "--host", host, "--port", port, "--no-dashboard"]
            for number in (1, 2):
                self._commands[f"worker {number}"] = [*dask, "worker", f"tcp://{address}", "--nthreads", "1",
                                                      "--no-dashboard", "--host", host]  # fmt: skip
            self._commands["command"] = _command(study, store, f"dask:tcp://{address}")
        else:
            self._commands["command"] = _command(study, store, "local")

    def flown(self) -> Counter[str]:
        """How often what was killed until the command came to its end."""
        try:
            while True:
                for name, command in self._commands.items():
                    if name not in self._processes or self._processes[name].poll() is not None:
                        self._processes[name] = subprocess.Popen(
                            command, env=child_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                        )  # fmt: skip
                try:
                    code = self._processes["command"].wait(self._rng.exponential(self._every_s))
                except subprocess.TimeoutExpired:
                    self._kill_one()
                    continue
                if code == 0:
                    return self._killed
        finally:
            for process in self._processes.values():
                process.kill()
                process.wait()

    def _kill_one(self) -> None:
        name = str(self._rng.choice([*self._commands, "worker process"]))
        pids = _worker_processes(self._processes.values()) if name == "worker process" else [self._processes[name].pid]
        if not pids:
            return
        try:
            os.kill(int(self._rng.choice(pids)), signal.SIGKILL)
        except ProcessLookupError:
            return
        self._killed[name.rstrip(" 12")] += 1
        if name in self._processes:
            self._processes[name].wait()


def _command(study: Path, store: Path, engine: str) -> list[str]:
    return python_command("services.console", "campaign", "run", str(study), "--store", str(store), "--engine", engine,
                          "--quiet", *(("--workers", "2") if engine == "local" else ()))  # fmt: skip


def _worker_processes(owners: Any) -> list[int]:
    """Process ids of the worker processes that descend from those processes."""
    parents: dict[int, int] = {}
    commands: dict[int, bytes] = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            commands[int(path.name)] = (path / "cmdline").read_bytes()
        except OSError:
            continue
    roots = {owner.pid for owner in owners}

    def descends(pid: int) -> bool:
        while pid in parents and pid not in roots:
            pid = parents[pid]
        return pid in roots

    return [pid for pid, line in commands.items() if b"services.console.campaign.worker" in line and descends(pid)]


def _rows(path: Path) -> tuple[dict[str, str], int]:
    """The results by key, and how many were computed more than once."""
    with Store(path, write=False) as store:
        return {row.key: canonical(row.result) for row in store.rows() if row.result is not None}, store.rewritten

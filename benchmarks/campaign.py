"""Campaigns: what an engine costs for each task, and time and memory of the report on many rows.

    overhead_ms      wall time for a task that returns at once, on each engine: what a mission pays beside its flight
    report_s         HTML, CSV and Parquet of a store of that many rows, in a process of its own
    report_cpu_s     processor time of that process, which a busy machine hardly changes
    report_mb        the most memory of that process

The rows are drawn, not flown: two planners over four parameters, with the figures of a mission.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.flights import Row, written
from he3.errors import He3Error
from services.console.campaign.engines import engine_named
from services.console.campaign.identity import software_identity
from services.console.campaign.runner import run as compute
from services.console.campaign.store import Store
from services.console.campaign.task import DONE, Reply, Task
from services.runtime.child import child_environment, python_command


def run(
    tasks: int = 200,
    rows: int = 100_000,
    engines: Sequence[str] = ("local", "dask"),
    workers: int = 2,
    json: Path | None = None,
    out: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row an engine and one for the report; printed, written to `json`, the report's page kept in `out`.

    engines: as --engine of he3 campaign takes them.
    """
    found: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="he3-campaign-") as scratch:
        for name in engines:
            overhead_ms = _overhead_ms(name, tasks, workers, Path(scratch))
            found.append({"engine": name, "tasks": tasks, "workers": workers, "overhead_ms": overhead_ms})
            say(f"{name:<10} {overhead_ms:6.1f} ms a task beside its work, {tasks} tasks, {workers} workers")
        if rows:
            report = _report(rows, Path(scratch), out)
            found.append(report)
            say(
                f"report     {report['report_s']:6.1f} s, {report['report_cpu_s']:.1f} s of the processor, "
                f"{report['report_mb']:.0f} MB for {rows} rows"
            )
    written(found, json, say)
    return found


def nothing(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Work that is done at once."""
    return dict(arguments)


def _overhead_ms(engine: str, count: int, workers: int, scratch: Path) -> float:
    """Wall time [ms] for each of that many tasks that do nothing, once the workers run."""
    software = software_identity("benchmarks")
    tasks = [Task(f"{__name__}:nothing", {"number": number}, software) for number in range(count + 8 * workers)]
    chosen = None if engine.partition(":")[2] else workers
    with Store(scratch / f"{engine[:5]}.sqlite", write=True) as store, engine_named(engine, chosen) as at_work:
        compute(tasks[count:], store, at_work)  # starts the workers
        began = time.perf_counter()
        compute(tasks[:count], store, at_work)
        return 1000 * (time.perf_counter() - began) / count


def _report(count: int, scratch: Path, out: Path | None) -> Row:
    """Time and memory of the report on that many rows."""
    path = scratch / "rows.sqlite"
    fill(path, count)
    folder = scratch if out is None else out
    folder.mkdir(parents=True, exist_ok=True)
    files = {"--out": folder / "report.html", "--csv": scratch / "rows.csv", "--parquet": scratch / "rows.parquet"}
    flags = (word for flag, file in files.items() for word in (flag, str(file)))
    command = python_command("services.console", "campaign", "report", str(path), *flags)
    began, streams = time.perf_counter(), {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, env=child_environment(), text=True, **streams) as process:
        assert process.stderr is not None
        said = process.stderr.read()
        # Of this process alone: the workers before it may have taken more memory.
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    elapsed_s = time.perf_counter() - began
    if process.returncode:
        raise He3Error(f"the report failed: {said.strip()}")
    per_mb = 1024.0 * (1024.0 if sys.platform == "darwin" else 1.0)
    return {
        "rows": count,
        "report_s": elapsed_s,
        "report_cpu_s": used.ru_utime + used.ru_stime,
        "report_mb": used.ru_maxrss / per_mb,
        "store_mb": path.stat().st_size / 1e6,
    }


def fill(path: Path, count: int) -> None:
    """Write a store of that many rows, drawn."""
    with Store(path, write=True) as store:
        store.describe(study="drawn", description="rows that were drawn, not flown", software="none")
        store.write_all(_drawn(count))


def _drawn(count: int) -> Iterator[tuple[Task, Reply]]:
    rng = np.random.default_rng(1)
    for number in range(count // 2):
        light_time, loss, battery = (float(f"{value:.6g}") for value in rng.random(3))
        boulders, luck = int(rng.integers(60)), rng.normal(size=4)
        for planner, factor in (("tour", 0.75), ("rrtstar", 1.0)):
            values = {"planner": planner, "light_time": 1200 * light_time, "loss": loss / 2,
                      "battery": 300 + 2700 * battery, "boulders": boulders}  # fmt: skip
            labels = {
                "scenario": "t1", "seed": number + 1, "parameters": values,
                "settings": {"ground.planner": planner, "link.up.loss": loss / 2, "rounds": 6},
            }  # fmt: skip
            hours = 12 + 5 * factor + 4 * light_time**2 + 3 * (1 - battery) ** 3 + 0.5 * luck[0]
            result = {
                "completed": bool(battery > 0.01), "detail": "the battery is empty", "samples": 30,
                "rmse_ppb": 0.9 + 0.1 * factor + 0.05 * luck[1] + 0.001 * boulders,
                "path_length_m": 3500 * factor + 150 * luck[2] + 2 * boulders, "mission_time_s": 3600 * hours,
                "coverage_68": float(np.clip(0.66 + 0.08 * luck[3], 0, 1)),
                "messages_lost": float(round(200 * loss / 2)), "map_sha256": f"{number:064x}",
            }  # fmt: skip
            yield Task("drawn:row", values | {"seed": number}, "none", labels), Reply(DONE, result, wall_s=3.0)

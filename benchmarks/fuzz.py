"""Fuzz everything that takes input from outside: no traceback, no defect, no hang, and refused input changes nothing.

Each surface (command line, scenario files, region files, messages, page requests) gets its share of random examples
from one seed. A faulty example is printed with its seed.

    examples   in all, shared out among the surfaces
    faults     examples whose outcome is neither success nor a refusal in one line
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from benchmarks import kept
from benchmarks.fuzzing.surface import Hang, Surface, noticing_a_hang
from he3.errors import He3Error, InvalidInput

SHOWN_FAULTS = 50


def surfaces() -> dict[str, Callable[[Path], Surface]]:
    """Constructor of each surface, which takes a separate folder."""
    from benchmarks.fuzzing.command_line import CommandLine
    from benchmarks.fuzzing.messages import Messages
    from benchmarks.fuzzing.page_requests import PageRequests, PageRequestsOverTls
    from benchmarks.fuzzing.region_files import RegionFiles
    from benchmarks.fuzzing.scenario_files import ScenarioFiles

    return {
        "cli": CommandLine,
        "scenario": ScenarioFiles,
        "region": RegionFiles,
        "messages": Messages,
        "page": PageRequests,
        "page-tls": PageRequestsOverTls,
    }


def run(examples: int = 5_000, seed: int = 1, only: str = "", json: Path | None = None) -> None:
    """Fuzz all surfaces, or only the one named; exit code 1 if there was a fault."""
    known = surfaces()
    if only and only not in known:
        raise InvalidInput(f"--only: expected one of {', '.join(known)}, got '{only}'")
    if examples < 1:
        raise InvalidInput(f"--examples: expected at least 1, got {examples}")
    names = [only] if only else list(known)
    rows = []
    for name in names:
        row = fuzz(name, max(1, examples // len(names)), seed)
        rows.append(row)
        print(
            f"{name:<10} {row['examples']:>7} examples, {len(row['faults'])} faults, slowest {row['slowest_s']:.2f} s"
        )
        for fault in row["faults"][:SHOWN_FAULTS]:
            print(f"  seed {fault['seed']}: {fault['input']}\n    {fault['wrong']}")
    kept.write_whole(json, rows)
    if any(row["faults"] for row in rows):
        raise He3Error("fuzz: faults were found; see above")


def fuzz(name: str, examples: int, seed: int) -> dict[str, Any]:
    """The outcome of that many examples on one surface: faults with the seed of each, and the slowest example [s]."""
    faults: list[dict[str, Any]] = []
    slowest_s, slowest = 0.0, ""
    told = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="he3-fuzz-") as folder:
        surface = surfaces()[name](Path(folder))
        try:
            for number in range(examples):
                one = f"{name}:{seed}:{number}"
                began = time.monotonic()
                what, wrong = _judged(surface, Random(one))
                took = time.monotonic() - began
                if took > slowest_s:
                    slowest_s, slowest = took, what
                if wrong is not None:
                    faults.append({"seed": one, "input": what, "wrong": wrong})
                if time.monotonic() - told > 5.0:
                    told = time.monotonic()
                    print(f"fuzz: {name} {number + 1} of {examples}, {len(faults)} faults", file=sys.stderr)
        finally:
            surface.close()
    return {"surface": name, "examples": examples, "faults": faults, "slowest_s": slowest_s, "slowest": slowest}


def _judged(surface: Surface, rng: Random) -> tuple[str, str | None]:
    try:
        with noticing_a_hang():
            return surface.example(rng)
    except Hang:
        return "(see the seed)", "hangs"
    except Exception as error:  # noqa: BLE001 - any exception of the code under test is a fault to report
        where = error.__traceback__
        while where is not None and where.tb_next is not None:
            where = where.tb_next
        line = "" if where is None else f" at {where.tb_frame.f_code.co_filename}:{where.tb_lineno}"
        return "(see the seed)", f"{type(error).__name__}: {str(error)[:300]}{line}"

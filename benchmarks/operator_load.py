"""Query times under load: 50 clients send 20 queries per second each to a running mission, and to a bare queryable.

Two missions of the same scenario and seed, each in separate processes at the same rate: one left alone, one asked by
`clients` sessions, each `per_second` times a second, mostly for points, some for boxes, a few for whole layers. In the
same run and at the same times a bare Zenoh queryable, in a process of its own on the same router, answers as many bytes
as a point has. The pace of the missions is compared by what they had done at equal wall times: the mission time at
which each sample was measured.
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any

from benchmarks import kept
from he3.errors import He3Error, PeerUnreachable
from schemas.topics import MAP_BOX, MAP_LAYER, MAP_POINT, Side
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import Endpoints, free_endpoints
from services.console.launch.launcher import Launcher
from services.mission.deployment import deployment
from services.runtime.child import ROOT, child_environment, python_command
from services.runtime.transport.client import selector_text
from services.runtime.transport.opening import open_client

SCENARIO = "t1-paper"
POINT_SHARE, BOX_SHARE = 0.90, 0.08
"""Shares of point and box queries; the rest are whole layers of 1 MB each."""
BARE_SHARE = 0.2
"""Share of additional queries to the bare queryable."""
LAYERS_TIMED = 400
WARM_UP_S = 3.0


@dataclass(slots=True)
class Times:
    """Query times [s] by kind, and the errors."""

    by_kind: dict[str, list[float]] = field(
        default_factory=lambda: {kind: [] for kind in ("point", "box", "layer", "bare")}
    )
    errors: list[str] = field(default_factory=list)


def run(
    clients: int = 50,
    per_second: float = 20.0,
    seconds: float = 60.0,
    rate: float = 300.0,
    seed: int = 1,
    json: Path | None = None,
) -> dict[str, Any]:
    """The figures, printed and written to a file."""
    say = _say
    say(f"a mission left alone for {seconds:g} s at simulation speed {rate:g}x ...")
    alone = _mission(rate, seed, lambda client, _: _left_alone(client, seconds))
    say(f"the same with {clients} clients asking {per_second:g} times a second each ...")
    figures: dict[str, Any] = {}

    def asked(client: MissionClient, endpoints: Endpoints) -> dict[str, int]:
        with _Bare(endpoints.earth):
            figures.update(_load(endpoints.earth, clients, per_second, seconds))
            done = _measured(client)
            figures.update(_whole_layers(endpoints.earth))
        return done

    under_load = _mission(rate, seed, asked)
    figures["pace_ratio"] = _pace(alone, under_load)
    row = {"clients": clients, **figures}
    say("")
    for name, value in row.items():
        say(f"{name:<18} {value:.6g}" if isinstance(value, float) else f"{name:<18} {value}")
    say(
        f"{'point / bare':<18} median {row['point_p50_s'] / row['bare_p50_s']:.2f} (at most 2), "
        f"99th percentile {row['point_p99_s'] / row['bare_p99_s']:.2f} (at most 5)"
    )
    say(f"{'layer / bare':<18} {row['layer_s'] / row['bare_layer_s']:.2f} (at most 1.5)")
    if json is not None:
        _write(json, row)
    return row


# --- missions -------------------------------------------------------------------------------------------------------


def _mission(rate: float, seed: int, during: Any) -> dict[str, int]:
    endpoints = free_endpoints()
    path = deployment("scenarios", f"{SCENARIO}.toml")
    with tempfile.TemporaryDirectory() as logs:
        flags = ("--rate", str(rate), "--seed", str(seed))
        with (
            Launcher(path, endpoints, flags, logs=Path(logs)) as launcher,
            MissionClient.when_up(endpoints.earth, SCENARIO, launcher.check, "bench") as client,
        ):
            _begun(client)
            result: dict[str, int] = during(client, endpoints)
            launcher.check()
            return result


def _begun(client: MissionClient) -> None:
    """Wait until time runs and the ground has a map."""
    deadline = time.monotonic() + 60.0
    while True:
        try:
            if client.status().plan_revision >= 1 and client.history().revisions:
                return
        except He3Error:
            pass
        if time.monotonic() > deadline:
            raise PeerUnreachable("the mission has not begun within 60 s")
        time.sleep(0.1)


def _left_alone(client: MissionClient, seconds: float) -> dict[str, int]:
    time.sleep(seconds + WARM_UP_S)
    return _measured(client)


def _measured(client: MissionClient) -> dict[str, int]:
    """Mission time [ns since its start] at which each sample so far was measured."""
    start = client.clock().start_ns
    return {sample.sample_id: sample.measured_at - start for sample in client.track().samples}


def _pace(alone: dict[str, int], under_load: dict[str, int]) -> float:
    """Progress of the loaded mission relative to the other at the last common sample: 1 unchanged, below 1 slower."""
    both = alone.keys() & under_load.keys()
    if not both:
        return float("nan")
    last = max(both, key=lambda name: alone[name])
    return alone[last] / under_load[last]


# --- load -----------------------------------------------------------------------------------------------------------


def _load(endpoint: str, clients: int, per_second: float, seconds: float) -> dict[str, Any]:
    times = Times()
    lock = threading.Lock()
    begin = time.monotonic() + WARM_UP_S
    threads = [
        threading.Thread(target=_client, args=(endpoint, number, per_second, begin, seconds, times, lock))
        for number in range(clients)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    by_kind = {kind: sorted(took) for kind, took in times.by_kind.items()}
    for error in sorted(set(times.errors))[:5]:
        _say(f"error: {error}")
    return {
        "queries": sum(len(took) for kind, took in by_kind.items() if kind != "bare"),
        "errors": len(times.errors),
        "point_p50_s": _quantile(by_kind["point"], 0.5),
        "point_p99_s": _quantile(by_kind["point"], 0.99),
        "bare_p50_s": _quantile(by_kind["bare"], 0.5),
        "bare_p99_s": _quantile(by_kind["bare"], 0.99),
        "box_p50_s": _quantile(by_kind["box"], 0.5),
        "layer_loaded_p50_s": _quantile(by_kind["layer"], 0.5),
    }


def _client(
    endpoint: str, number: int, per_second: float, begin: float, seconds: float, times: Times, lock: threading.Lock
) -> None:
    chance = random.Random(number)
    mine = Times()
    session = open_client(Side.EARTH, endpoint)
    try:
        due = begin + number / 1000 + chance.random() / per_second
        while due < begin + seconds:
            time.sleep(max(0.0, due - time.monotonic()))
            # As people ask: at irregular times, so that clients do not march in step.
            due += chance.expovariate(per_second)
            kind, selector = _question(chance)
            _ask(session, kind, selector, mine)
            if chance.random() < BARE_SHARE:
                _ask(session, "bare", BARE_KEY, mine)
    finally:
        session.close()
    with lock:
        times.errors += mine.errors
        for name, took in mine.by_kind.items():
            times.by_kind[name] += took


def _question(chance: random.Random) -> tuple[str, str]:
    what = chance.random()
    if what < POINT_SHARE:
        return "point", f"{MAP_POINT.key(SCENARIO)}?x={chance.uniform(0, 500):.1f};y={chance.uniform(0, 500):.1f}"
    layer = chance.choice(("mean", "std"))
    if what < POINT_SHARE + BOX_SHARE:
        x, y = chance.uniform(0, 400), chance.uniform(0, 400)
        box = {"layer": layer, "x_min": x, "x_max": x + 100, "y_min": y, "y_max": y + 100, "format": "npy"}
        return "box", f"{MAP_BOX.key(SCENARIO)}?{selector_text(box)}"
    return "layer", f"{MAP_LAYER.key(SCENARIO)}?layer={layer};format=npy"


def _ask(session: Any, kind: str, selector: str, times: Times) -> int:
    began = time.perf_counter()
    size = 0
    replies = 0
    for reply in session.get(selector, timeout=10.0):
        replies += 1
        if reply.ok is None:
            times.errors.append(reply.err.payload.to_string())
        else:
            size = len(reply.ok.payload)
    if replies != 1:
        times.errors.append(f"{kind}: expected one reply, got {replies}")
    times.by_kind[kind].append(time.perf_counter() - began)
    return size


def _whole_layers(endpoint: str) -> dict[str, float]:
    """Time of a whole layer as float32, and of as many bytes from the bare queryable, in random order.

    Each is the mean of its middle half: where a process happens to run, such a transfer takes 0.9 or 1.7 ms, and a
    median between the two would be either, by chance.
    """
    session = open_client(Side.EARTH, endpoint)
    times = Times()
    selectors = {"layer": f"{MAP_LAYER.key(SCENARIO)}?layer=mean;format=npy", "bare": f"{BARE_KEY}?large"}
    turns = [*selectors] * LAYERS_TIMED
    random.Random(0).shuffle(turns)
    try:
        for kind in turns:
            _ask(session, kind, selectors[kind], times)
    finally:
        session.close()
    return {
        "layer_s": _middle_mean(times.by_kind["layer"]),
        "bare_layer_s": _middle_mean(times.by_kind["bare"]),
    }


def _middle_mean(took: list[float]) -> float:
    quarter = len(took) // 4
    return mean(sorted(took)[quarter : len(took) - quarter])


def _quantile(ordered: Sequence[float], share: float) -> float:
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else float("nan")


# --- the bare queryable ---------------------------------------------------------------------------------------------

BARE_KEY = f"he3/{SCENARIO}/bench/bare"
BARE_BYTES = 220
LARGE_BYTES = 500 * 500 * 4 + 128


class _Bare:
    """A process that answers with fixed bytes, from within Zenoh's callback, and does nothing else."""

    def __init__(self, endpoint: str) -> None:
        self._command = python_command("benchmarks.operator_load", endpoint)

    def __enter__(self) -> None:
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**child_environment(), "PYTHONPATH": ROOT},
        )
        assert self._process.stdout is not None
        if self._process.stdout.readline().strip() != "ready":
            raise He3Error("the bare queryable did not start")

    def __exit__(self, *_: object) -> None:
        self._process.communicate()


def _answer_barely(endpoint: str) -> None:
    small, large = b"x" * BARE_BYTES, b"x" * LARGE_BYTES
    session = open_client(Side.EARTH, endpoint)

    def answer(query: Any) -> None:
        query.reply(query.key_expr, large if dict(query.parameters) else small)

    session.declare_queryable(BARE_KEY, answer)
    print("ready", flush=True)
    sys.stdin.read()
    session.close()


def _say(line: str) -> None:
    print(line, flush=True)


def _write(path: Path, row: dict[str, Any]) -> None:
    kept.write_whole(path, row)


if __name__ == "__main__":
    _answer_barely(sys.argv[1])

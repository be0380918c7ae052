"""The operator's page in Chromium: bytes to each of 20 open pages, the answer to a click, the work of a page at rest.

A mission in separate processes at rate 100, one page server, and as many windows of one Chromium. Each window reaches
the server by a port of its own, which counts what passes: a browser keeps six connections a port, and a page holds one
open. While all are open, the first is clicked: the page answers at once from its own map where it holds that of the
place, and then the ground answers; the bound is on the ground's answer. Then mission time stands still, and the main
thread of the first page is watched.

Shares of a core are processor time of the main thread. The times of its tasks, which also hold the time in which a
task waits for a core (20 windows share the machine's), are in the file as `..._wall`. Needs Chromium with its driver
(Debian: chromium, chromium-driver) and selenium.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from random import Random
from socket import IPPROTO_TCP, SHUT_WR, TCP_NODELAY, create_connection, create_server, socket
from statistics import median
from typing import Any, Final

from benchmarks import kept
from benchmarks.browser import chromium
from he3.errors import He3Error, InvalidInput, PeerUnreachable
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.console.launch.launcher import Launcher
from services.mission.deployment import deployment
from services.runtime.child import ROOT, child_environment, python_command

SCENARIO: Final = "t1-paper"
BEGUN_SAMPLES: Final = 3
WITHIN_S: Final = 300.0
SETTLE_S: Final = 5.0
MOST_BYTES_S: Final = 40_000
MOST_CLICK_MS: Final = 60
MOST_MAIN_THREAD: Final = 0.15
"""What is promised: bytes a second to each page, median of a click's answer, share of a core at rest."""
CLICK: Final = """
const [x, y, done] = arguments, map = document.getElementById('map'), place = document.getElementById('place');
const box = map.getBoundingClientRect();
const at = {clientX: box.left + x * box.width, clientY: box.top + y * box.height, button: 0, pointerId: 1};
const began = performance.now();
let held = null;
new MutationObserver((changes, watch) => {
  const took = performance.now() - began;
  if (place.dataset.held) held ??= took;
  if (!place.dataset.point || !changes.some(({attributeName}) => attributeName === 'data-point')) return;
  watch.disconnect();
  done([held, took]);
}).observe(place, {attributeFilter: ['data-held', 'data-point']});
for (const kind of ['pointerdown', 'pointerup', 'click'])
  map.dispatchEvent(new PointerEvent(kind, {...at, bubbles: true, isPrimary: true, detail: 1}));
"""


def run(
    pages: int = 20,
    rate: float = 100.0,
    seconds: float = 30.0,
    clicks: int = 20,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """The figures, printed and written to a file."""
    if pages < 1 or clicks < 1 or seconds <= 0:
        raise InvalidInput(f"expected pages, clicks and seconds over 0, got {pages}, {clicks} and {seconds:g}")
    say(f"{pages} pages over a mission at simulation speed {rate:g}x for {seconds:g} s ...")
    with ExitStack() as stack:
        mission = stack.enter_context(_mission(rate))
        address = stack.enter_context(_page_server(mission))
        gates = [stack.enter_context(_counted(address)) for _ in range(pages)]
        driver = stack.enter_context(chromium("--window-size=1440,900"))
        driver.set_script_timeout(WITHIN_S)
        windows = _opened(driver, gates)
        time.sleep(SETTLE_S)
        before, began = [gate.passed for gate in gates], time.monotonic()
        moved = _main_thread(driver, seconds / 2)
        firsts, clicked = _clicked(driver, clicks)
        time.sleep(max(0.0, began + seconds - time.monotonic()))
        took_s = time.monotonic() - began
        rates = sorted((gate.passed - was) / took_s for gate, was in zip(gates, before, strict=True))
        mission.set_clock_rate(0.0)
        time.sleep(SETTLE_S)
        row = {
            "pages": pages,
            "rate": rate,
            "seconds": took_s,
            "visible_windows": windows,
            "bytes_per_s_median": median(rates),
            "bytes_per_s_most": rates[-1],
            "click_ms_median": median(clicked),
            "click_ms_most": max(clicked),
            "click_from_page_ms_median": median(firsts) if firsts else None,
            "clicks_from_page": len(firsts),
            **_named("moving", moved),
            **_named("at_rest", _main_thread(driver, seconds / 2)),
            "load": os.getloadavg()[0],
            "cores": os.cpu_count(),
        }
    _report(row, say)
    kept.write_whole(json, row)
    return row


def _named(when: str, shares: tuple[float, float]) -> dict[str, float]:
    return {f"main_thread_share_{when}": shares[0], f"main_thread_share_{when}_wall": shares[1]}


def _report(row: dict[str, Any], say: Callable[[str], None]) -> None:
    kilobytes, most = row["bytes_per_s_median"] / 1000, row["bytes_per_s_most"] / 1000
    held_ms = row["click_from_page_ms_median"]
    first = "not held" if held_ms is None else f"{held_ms:.0f} ms median, {row['clicks_from_page']} times"
    lines = (
        ("bytes to a page", f"{kilobytes:.1f} kB/s, the most {most:.1f}", f"at most {MOST_BYTES_S / 1000:.0f}"),
        (
            "answer to a click",
            f"{row['click_ms_median']:.0f} ms median, {row['click_ms_most']:.0f} the longest",
            f"under {MOST_CLICK_MS} median",
        ),
        ("  from the page's map", first, ""),
        (
            "main thread at rest",
            f"{row['main_thread_share_at_rest']:.1%} of a core, {row['main_thread_share_moving']:.1%} while it moves",
            f"under {MOST_MAIN_THREAD:.0%}",
        ),
        ("load of the machine", f"{row['load']:.1f} on {row['cores']} cores", ""),
    )
    for name, found, promised in lines:
        say(f"{name:<20} {found}{f' ({promised})' if promised else ''}")


# --- the mission and its page -----------------------------------------------------------------------------------------


@contextmanager
def _mission(rate: float) -> Iterator[MissionClient]:
    endpoints = free_endpoints()
    with tempfile.TemporaryDirectory() as logs:
        path = deployment("scenarios", f"{SCENARIO}.toml")
        with (
            Launcher(path, endpoints, ("--rate", str(rate)), logs=Path(logs)) as launcher,
            MissionClient.when_up(endpoints.earth, SCENARIO, launcher.check, "bench") as client,
        ):
            _wait_for(lambda: _samples(client) >= BEGUN_SAMPLES, f"{BEGUN_SAMPLES} samples")
            yield client


def _samples(client: MissionClient) -> int:
    try:
        return client.status().samples
    except He3Error:
        return 0


@contextmanager
def _page_server(mission: MissionClient) -> Iterator[tuple[str, int]]:
    """The host and the port of a page's server."""
    command = python_command(
        "services.console", "web", "--port", "0", "--mission", mission.mission, "--earth", mission.earth
    )
    environment = {**child_environment(), "PYTHONPATH": ROOT}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stderr is not None
        try:
            found = re.search(r"http://([^:/]+):(\d+)/", process.stderr.readline())
            if found is None:
                raise He3Error("the page's server did not start")
            yield found[1], int(found[2])
        finally:
            process.terminate()


class _Gate:
    """A port that leads to the page's server and counts the bytes that come from it."""

    def __init__(self, listener: socket, target: tuple[str, int]) -> None:
        self._listener, self._target = listener, target
        self.passed = 0
        self.url = f"http://127.0.0.1:{listener.getsockname()[1]}/"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                browser, _ = self._listener.accept()
                with suppress(OSError):
                    server = create_connection(self._target)
                    for each in (browser, server):  # a gate that waits for full packets would add 40 ms to an answer
                        each.setsockopt(IPPROTO_TCP, TCP_NODELAY, 1)
                    threading.Thread(target=self._join, args=(browser, server), daemon=True).start()

    def _join(self, browser: socket, server: socket) -> None:
        with browser, server:
            back = threading.Thread(target=self._pass, args=(server, browser, True), daemon=True)
            back.start()
            self._pass(browser, server, False)
            back.join()

    def _pass(self, source: socket, target: socket, counts: bool) -> None:
        with suppress(OSError):
            while data := source.recv(65_536):
                target.sendall(data)
                if counts:
                    self.passed += len(data)
        with suppress(OSError):
            target.shutdown(SHUT_WR)


@contextmanager
def _counted(target: tuple[str, int]) -> Iterator[_Gate]:
    with create_server(("127.0.0.1", 0)) as listener:
        yield _Gate(listener, target)


# --- the browser ------------------------------------------------------------------------------------------------------


def _opened(driver: Any, gates: list[_Gate]) -> int:
    """Open a window at each gate; returns how many of them think that they are seen. The first one is in front."""
    for number, gate in enumerate(gates):
        if number:
            driver.switch_to.new_window("window")
        driver.get(gate.url)
    handles, seen = driver.window_handles, 0
    for handle in reversed(handles):
        driver.switch_to.window(handle)
        seen += driver.execute_script("return document.visibilityState") == "visible"
        _wait_for(lambda: driver.execute_script("return document.getElementById('map').dataset.shown"), "the map")
    return seen


def _clicked(driver: Any, clicks: int) -> tuple[list[float], list[float]]:
    """Times [ms] from a click on the map to what the page's own map says, where it does, and to the ground's answer."""
    chance = Random(1)
    took = [
        driver.execute_async_script(CLICK, chance.uniform(0.2, 0.9), chance.uniform(0.1, 0.8)) for _ in range(clicks)
    ]
    return [float(held) for held, _ in took if held is not None], [float(answered) for _, answered in took]


def _main_thread(driver: Any, seconds: float) -> tuple[float, float]:
    """Share of a core that the page's main thread takes in that time, and the share of time that its tasks last."""
    return _task_share(driver, "threadTicks", seconds / 2), _task_share(driver, "timeTicks", seconds / 2)


def _task_share(driver: Any, clock: str, seconds: float) -> float:
    driver.execute_cdp_cmd("Performance.disable", {})  # the clock cannot be set while it is enabled
    driver.execute_cdp_cmd("Performance.enable", {"timeDomain": clock})
    began, before = time.monotonic(), _task_s(driver)
    time.sleep(seconds)
    return (_task_s(driver) - before) / (time.monotonic() - began)


def _task_s(driver: Any) -> float:
    found = driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return float(next(each["value"] for each in found if each["name"] == "TaskDuration"))


def _wait_for(seen: Callable[[], Any], what: str) -> None:
    deadline = time.monotonic() + WITHIN_S
    while not seen():
        if time.monotonic() > deadline:
            raise PeerUnreachable(f"expected {what} within {WITHIN_S:g} s")
        time.sleep(0.2)

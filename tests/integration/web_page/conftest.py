"""Fixtures of the operator's page: a mission in separate processes, its server, and a real browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from schemas.telemetry import RoverMode
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import Endpoints, free_endpoints
from services.console.launch.launcher import Launcher
from tests.integration.web_page.page import chromium_or_skip, script, shown
from tests.integration.web_page.server import RATE, Served
from tests.waiting import PATIENCE_S, until


@pytest.fixture(scope="module")
def endpoints() -> Endpoints:
    return free_endpoints()


@pytest.fixture(scope="module")
def launcher(endpoints: Endpoints, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launcher]:
    logs = tmp_path_factory.mktemp("logs")
    # Rounds of ten seconds, and so many that the mission outlasts the tests on a machine of any speed.
    quick = ("rover.drill_s_per_m=600.0", "rover.analysis_s=30.0", "rover.speed_m_s=2.0", "rounds=400")
    flags = [word for setting in quick for word in ("--set", setting)]
    scenario = Path(__file__).parents[3] / "deploy" / "scenarios" / "t1-paper.toml"
    with Launcher(scenario, endpoints, ("--rate", str(RATE), *flags), logs=logs) as launcher:
        yield launcher


@pytest.fixture(scope="module")
def mission(launcher: Launcher, endpoints: Endpoints) -> Iterator[MissionClient]:
    with MissionClient.when_up(endpoints.earth, "t1-paper", launcher.check) as client:
        yield client


@pytest.fixture(scope="module")
def served(mission: MissionClient, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    """The address of a page where commands take a login, and the one with a login that may command."""
    server = Served(mission, "--authority", "--login-file", str(tmp_path_factory.mktemp("logins") / "logins"))
    with server as where:
        yield where, server.login


@pytest.fixture(scope="module")
def address(served: tuple[str, str]) -> str:
    return served[0]


@pytest.fixture(scope="module")
def logged_in(served: tuple[str, str]) -> Iterator[Any]:
    """A browser that has logged in; it takes longer to start than most tests."""
    with chromium_or_skip(logged={"browser": "ALL", "performance": "ALL"}) as driver:
        driver.get(served[1])
        yield driver


@pytest.fixture
def browser(logged_in: Any, address: str, mission: MissionClient) -> Any:
    """The page with its map as a new browser shows it, of a mission that no earlier test holds up."""
    rover = mission.status().rover
    if rover is not None and rover.mode in (RoverMode.PAUSED, RoverMode.SAFE):
        mission.command("resume").wait("completed", PATIENCE_S)
    logged_in.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    logged_in.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    # A test that failed may leave a plan that was edited; the browser would ask whether to leave it.
    script(logged_in, "addEventListener('beforeunload', (event) => event.stopImmediatePropagation(), true)")
    logged_in.get(f"{address}static/icon.svg")
    script(logged_in, "localStorage.clear(); sessionStorage.clear()")
    for log in ("browser", "performance"):
        logged_in.get_log(log)
    logged_in.get(address)
    until(lambda: shown(logged_in).get("layer") == "mean", "the map")
    return logged_in

"""A mission whose services end with it leaves every display with its last map, and waits for none for ever."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import Endpoints, free_endpoints
from tests.integration.web_page.page import chromium_or_skip, script, shown
from tests.integration.web_page.server import Served, get
from tests.processes import he3, start
from tests.waiting import until

SHORT = ("rounds=2", "samples_per_round=3", 'ground.planner="rrt"')


class Flown:
    """A run of a short mission in lockstep, whose time stands until a test lets it go by."""

    def __init__(self, stack: ExitStack, *settings: str) -> None:
        self.ends: Endpoints = free_endpoints()
        network = (f'network.moon="{self.ends.moon}"', f'network.earth="{self.ends.earth}"')
        flags = [word for each in (*SHORT, *network, *settings) for word in ("--set", each)]
        command = he3("run", "short", "--lockstep", "--json", "--quiet", *flags)
        self.process = stack.enter_context(start(command, stdout=subprocess.PIPE, text=True))
        stack.callback(self.process.kill)
        client = MissionClient.when_up(self.ends.earth, "short", self.check)
        with client:
            client.wait_for_ground(self.check)
        self.mission = stack.enter_context(MissionClient(self.ends.earth, "short"))
        self.mission.control_time(paused=True)

    def check(self) -> None:
        assert self.process.poll() is None, "the mission has ended too early"

    def to_its_end(self) -> dict[str, Any]:
        """The report; all services are gone then."""
        self.mission.control_time(paused=False)
        said, _ = self.process.communicate()
        report: dict[str, Any] = json.loads(said)
        return report


@pytest.fixture
def flown() -> Iterator[Flown]:
    with ExitStack() as stack:
        yield Flown(stack)


def answered(url: str) -> Any:
    code, body = get(url)
    assert code == 200, body
    return json.loads(body)


def test_the_page_has_the_last_map_of_a_mission_whose_services_have_ended_with_it(flown: Flown) -> None:
    with Served(flown.mission) as own:
        report = flown.to_its_end()
        track, history = answered(f"{own}api/map/track"), answered(f"{own}api/map/history")
        assert [each["sample_id"] for each in track["samples"]] == [
            each["sample_id"] for each in report["sample_table"]
        ]
        last = history["revisions"][-1]
        assert last["samples"] == report["samples"] == 6
        box = "x_min=0&y_min=0&x_max=500&y_max=500&resolution_m=1&format=packed"
        for layer in ("mean", "std", "exceedance&threshold=8", "slope", "error"):
            for moment in ("", f"&as_of={last['revision']}"):
                assert get(f"{own}api/map/box?layer={layer}&{box}{moment}")[0] == 200, layer
        code, body = get(f"{own}api/map/point?x=10&y=20")
        assert (code, "does not answer" in json.loads(body)["error"]) == (503, True), "it is no other place's answer"


def test_a_browser_shows_every_sample_of_a_mission_whose_services_have_ended_with_it(flown: Flown) -> None:
    with chromium_or_skip(logged={"browser": "ALL"}) as driver, Served(flown.mission) as own:
        driver.get(own)
        report = flown.to_its_end()
        until(lambda: shown(driver).get("samples") == report["samples"], lambda: f"the last map, not {shown(driver)}")
        label = "return document.getElementById('time-label').textContent"
        until(lambda: script(driver, label).endswith(f"{report['samples']} samples"), lambda: script(driver, label))
        chips = "return ['liveness', 'contact', 'elapsed'].map((id) => document.getElementById(id).textContent)"
        ended = ["mission over, services ended", "contact not known", "not known"]
        until(lambda: script(driver, chips) == ended, lambda: f"the end, not {script(driver, chips)}")


def test_the_feed_is_followed_to_the_last_map_and_ends_with_the_mission(flown: Flown) -> None:
    command = he3("map", "follow", "--json", "--mission", "short", "--earth", flown.ends.earth)
    with start(command, stdout=subprocess.PIPE, text=True) as follower:
        assert follower.stdout is not None
        assert json.loads(follower.stdout.readline())["samples"] == 0
        assert flown.to_its_end()["samples"] == 6
        lines = follower.stdout.read().splitlines()
        assert (follower.wait(), json.loads(lines[-1])["samples"]) == (0, 6)


def test_a_display_that_hangs_keeps_a_run_from_its_end_for_a_moment_only(flown: Flown) -> None:
    server = Served(flown.mission)
    with server:
        server.process.send_signal(signal.SIGSTOP)
        assert flown.to_its_end()["samples"] == 6

"""What the page says and refuses when a service, its server or its mission is gone."""

from __future__ import annotations

import os
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.console.launch.launcher import Launcher
from tests.integration.web_page.page import (
    ENTER,
    checked,
    click,
    decide,
    in_module,
    proposed,
    script,
    shown,
    write,
    written,
)
from tests.integration.web_page.server import RATE, Served
from tests.waiting import until


def test_what_is_not_answered_is_asked_for_less_and_less_often_until_it_is_heard_of_again(browser: Any) -> None:
    waits = in_module(
        browser, "patience.js",
        "(() => { const patience = new it.Patience(2000), found = []; let now = 5;"
        " for (let time = 0; time < 7; time++) { patience.failed(now); found.push(patience.until - now);"
        " if (patience.mayAsk(patience.until - 1)) found.push('too early'); now = patience.until; }"
        " patience.forget(); found.push(patience.mayAsk(now)); patience.failed(now); found.push(patience.until - now);"
        " return found; })()",
    )  # fmt: skip
    assert waits == [2000, 4000, 8000, 16_000, 32_000, 60_000, 60_000, True, 2000]


def test_the_page_says_who_is_silent_and_greys_what_is_no_longer_known(browser: Any, launcher: Launcher) -> None:
    pid = launcher.pids["ground"]
    os.kill(pid, signal.SIGSTOP)
    try:
        until(lambda: written(browser, "#liveness").startswith("ground silent for"), "the silence of the ground")
        old = "return [...document.querySelectorAll('.card.old h2')].map((each) => each.textContent)"
        until(lambda: {"Map", "Commands"} <= set(script(browser, old)), "grey cards")
        assert "as of T+" in written(browser, ".map-card .as-of")
    finally:
        os.kill(pid, signal.SIGCONT)
    until(lambda: written(browser, "#liveness").startswith("live"), "the ground again")
    assert script(browser, old) == []


def test_a_page_whose_server_is_gone_says_so_and_knows_neither_time_nor_mission(
    browser: Any, mission: MissionClient, tmp_path: Path
) -> None:
    before = len(mission.commands())
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    with Served(mission, "--authority") as where:
        browser.get(where)
        until(lambda: written(browser, "#liveness").startswith("live"), "the mission")
        click(browser, "[data-command=pause]")
        until(lambda: script(browser, "return document.activeElement.id") == "preview-send", "the preview")
    until(lambda: written(browser, "#liveness").startswith("page disconnected"), "the loss of the server")
    until(lambda: written(browser, "#utc") == "not known", "the clock")
    assert (written(browser, "#pace"), written(browser, "#contact")) == ("not known", "contact not known")
    # What is decided on an old page is not kept for a server to come.
    decide(browser, ENTER)
    nothing = "the page's server does not answer: nothing was sent"
    until(lambda: nothing in written(browser, "#toast"), "the answer to Enter")
    script(browser, "document.getElementById('toast').replaceChildren()")  # it lies over what is clicked next
    write(browser, "#stack-text", "pause")
    click(browser, "#stack-check")
    until(lambda: written(browser, "#stack-failure") == nothing, "the answer to a check")
    write(browser, "#rehearsal-draws", "2" + ENTER)
    until(lambda: written(browser, "#rehearsal-failure") == nothing, "the answer to a rehearsal")
    assert len(mission.commands()) == before


@pytest.mark.exhaustive
def test_panels_say_in_a_line_what_was_killed_and_neither_lose_a_plan_nor_send_a_command(
    browser: Any, tmp_path: Path
) -> None:
    from benchmarks.journalled_mission import JournalledMission

    edit = (
        "const done = arguments[0]; import('/static/layers.js').then(({map}) => {"
        "const {x_m, y_m} = map.proposal.samples[0]; map.onStop(0, [x_m + 4, y_m + 3]); done(); })"
    )
    hidden = "return document.getElementById('stack-asks').hidden"
    port = free_endpoints().earth.rpartition(":")[2]
    with (
        JournalledMission(tmp_path, ["ground.approval=operator", f"rate={RATE}"]) as flown,
        MissionClient(flown.earth, "short") as other,
    ):
        proposal = until(other.proposed_plan, "a plan")
        with Served(other, "--authority", "--port", port) as where:
            browser.get(where)
            until(lambda: "waits for approval" in written(browser, "#plan-title"), "the plan on the page")
            until(lambda: shown(browser).get("layer") == "mean", "the map")
            write(browser, "#stack-text", "pause\nresume")
            click(browser, "#stack-check")
            until(lambda: browser.find_element("id", "stack-send").is_enabled(), "the check")
            click(browser, "#stack-step")
            click(browser, "#stack-send")
            until(lambda: not script(browser, hidden), "the question")
            flown.process("ground").kill()
            flown.process("ground").wait()
            click(browser, "#stack-yes")
            until(lambda: "0 of 2 commands sent" in written(browser, "#stack-failure"), "the end of the stack")
            browser.execute_async_script(edit)
            click(browser, "#plan-check")
            until(lambda: "the ground does not answer" in written(browser, "#plan-note"), "the line on the ground")
            assert browser.find_element("id", "plan-check").is_enabled()
            flown.start_again("ground")
            assert until(lambda: proposed(other), "the ground again").plan == proposal.plan
            assert other.commands() == ()
            until(lambda: checked(browser), "another check")
            click(browser, "#stack-send")
            until(lambda: not script(browser, hidden), "the question")
        until(lambda: written(browser, "#liveness").startswith("page disconnected"), "the loss of the server")
        with Served(other, "--authority", "--port", port):
            ended = "The stack has ended with the page's server, which was started anew; Commands has what was sent"
            until(lambda: written(browser, "#stack-failure") == ended, "the end of the stack")
            assert script(browser, hidden)
            assert browser.find_element("id", "plan-check").is_enabled()  # what was edited is still there
            assert other.commands() == ()
            click(browser, "#plan-undo")


@pytest.mark.exhaustive
def test_what_was_decided_on_one_mission_is_not_sent_to_another_at_the_same_address(
    browser: Any, tmp_path: Path
) -> None:
    port = free_endpoints().earth.rpartition(":")[2]
    scenario = Path(__file__).parents[3] / "deploy" / "scenarios" / "short.toml"
    places = "it.map.proposal?.samples.map(({x_m, y_m}) => [x_m, y_m]) ?? null"

    def planned(mission: MissionClient) -> Any:
        proposal = until(lambda: proposed(mission), "a plan")
        return proposal.proposal, [[each.x_m, each.y_m] for each in proposal.plan.samples]

    with ExitStack() as flown:
        missions = []
        for seed in ("1", "2"):
            endpoints, flags = free_endpoints(), ("--rate", str(RATE), "--seed", seed)
            approved = ("--set", "ground.approval=operator")
            (logs := tmp_path / seed).mkdir()
            launcher = flown.enter_context(Launcher(scenario, endpoints, (*flags, *approved), logs=logs))
            missions.append(flown.enter_context(MissionClient.when_up(endpoints.earth, "short", launcher.check)))
        (number, first), (same, second) = map(planned, missions)
        assert number == same, "else the number tells the plans apart"
        assert first != second
        with Served(missions[0], "--authority", "--port", port) as where:
            browser.get(where)
            until(lambda: in_module(browser, "layers.js", places) == first, "the plan of the first mission")
            click(browser, "[data-command=pause]")
            until(lambda: script(browser, "return document.activeElement.id") == "preview-send", "the preview")
        with Served(missions[1], "--authority", "--port", port):
            until(lambda: in_module(browser, "layers.js", places) == second, "the plan of the second mission")
            assert not script(browser, "return document.getElementById('preview').open")
            assert "The page has connected anew: nothing was sent" in written(browser, "#toast")
        assert [mission.commands() for mission in missions] == [(), ()]

"""Plans that wait on the page until they are approved, and rehearsals of the rest of the mission."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.console.launch.launcher import Launcher
from tests.integration.web_page.page import ENTER, barriers, click, in_module, press, script, write, written
from tests.integration.web_page.server import OUR_PAGE, RATE, Served, get
from tests.waiting import until


@pytest.mark.exhaustive
def test_a_plan_waits_on_the_page_until_it_is_approved_with_other_samples(browser: Any, tmp_path: Path) -> None:
    endpoints = free_endpoints()
    scenario = Path(__file__).parents[3] / "deploy" / "scenarios" / "short.toml"
    flags = ("--rate", str(RATE), "--set", "ground.approval=operator")
    with (
        Launcher(scenario, endpoints, flags, logs=tmp_path) as launcher,
        MissionClient.when_up(endpoints.earth, "short", launcher.check) as other,
        Served(other, "--authority") as where,
    ):
        proposal = until(other.proposed_plan, "a plan")
        browser.get(where)
        until(lambda: "waits for approval" in written(browser, "#plan-title"), "the plan on the page")
        two = "it.stopsOf({samples: [{sample_id: 'a', x_m: 10, y_m: 0}, {sample_id: 'b', x_m: 20, y_m: 0}]})"
        for change, names in (
            ("it.inserted(stops, [0, 0], [15, 1])", ["a", "new 1", "b"]),  # where it makes the way the least longer
            ("it.inserted(stops, [0, 0], [29, 1])", ["a", "b", "new 1"]),
            ("it.shifted(stops, 1, -1)", ["b", "a"]),
            ("it.taken(it.ticked(stops, 0, false))", ["b"]),
        ):
            found = in_module(browser, "planstops.js", f"((stops) => {change})({two}).map(({{name}}) => name)")
            assert found == names
        places = "it.map.proposal.samples.map(({x_m, y_m}) => [x_m, y_m])"
        before = in_module(browser, "layers.js", places)
        assert before == [pytest.approx([each.x_m, each.y_m], abs=0.05) for each in proposal.plan.samples]
        # The first one is dragged, as an operator drags; one more is set by keyboard, where the cross-hair is.
        chains = pytest.importorskip("selenium.webdriver").ActionChains(browser)
        map_ = browser.find_element("id", "map")
        script(browser, "arguments[0].scrollIntoView({block: 'center'})", map_)
        width, height = script(
            browser, "const b = arguments[0].getBoundingClientRect(); return [b.width, b.height]", map_
        )
        x, y = in_module(browser, "layers.js", f"it.map.at({before[0][0]}, {before[0][1]})")
        chains.move_to_element_with_offset(map_, round(x - width / 2), round(y - height / 2)).click_and_hold()
        chains.move_by_offset(8, -6).move_by_offset(12, -9).release().perform()
        until(lambda: in_module(browser, "layers.js", places)[0] != before[0], "the sample elsewhere")
        press(browser, "a")
        in_module(browser, "layers.js", f"(it.map.cross = [{before[1][0]}, {before[1][1]} - 1]) && null")
        press(browser, "Enter")
        until(lambda: len(in_module(browser, "layers.js", places)) == len(before) + 1, "one sample more")
        for axis, value in zip(("x", "y"), before[0], strict=True):
            write(browser, f"#plan-samples li:nth-child(1) .{axis}", f"{value + 1:.1f}")
            browser.switch_to.active_element.send_keys(ENTER)
        assert not browser.find_element("id", "plan-approve").is_enabled()
        assert barriers(browser) == []
        wanted = in_module(browser, "layers.js", places)
        click(browser, "#plan-check")
        until(lambda: written(browser, "#plan-note").startswith("Checked"), "the ways that the ground has found")
        revised = other.proposed_plan()
        assert revised is not None
        assert [[each.x_m, each.y_m] for each in revised.plan.samples] == wanted
        assert ", was " in written(browser, "#plan-facts")
        assert other.commands() == ()
        proposal = revised
        click(browser, "#plan-samples li:nth-child(2) input")
        click(browser, "#plan-approve")
        until(lambda: other.proposed_plan() is None, "the decision")
        until(lambda: script(browser, "return document.getElementById('plan-card').hidden"), "the end of the review")
        dropped = proposal.plan.samples[1].sample_id
        assert f"Plan approved without {dropped}" in written(browser, "#toast")


@pytest.mark.exhaustive
def test_the_rest_of_the_mission_is_rehearsed_on_the_page_against_an_alternative(browser: Any, tmp_path: Path) -> None:
    endpoints, port = free_endpoints(), free_endpoints().earth.rpartition(":")[2]
    scenario = Path(__file__).parents[3] / "deploy" / "scenarios" / "short.toml"
    with (
        Launcher(scenario, endpoints, ("--rate", "5"), logs=tmp_path) as launcher,
        MissionClient.when_up(endpoints.earth, "short", launcher.check) as other,
    ):
        with Served(other, "--port", port) as where:
            browser.get(where)
            until(lambda: "no status yet" not in written(browser, "#phase"), "the mission on the page")
            write(browser, "#rehearsal-draws", "2" + ENTER)
            until(lambda: "Samples" in written(browser, "#rehearsal-table"), "the forecast")
            assert len(browser.find_elements("css selector", "#rehearsal-table thead th")) == 1
            browser.find_element("id", "rehearsal-against").send_keys("in words")
            write(browser, "#rehearsal-words", "planner informative; abort-round" + ENTER)
            until(lambda: "Difference" in written(browser, "#rehearsal-table"), "the two forecasts")
            assert "planner informative; abort-round" in written(browser, "#rehearsal-table thead")
            assert re.search(r"Samples.*9", written(browser, "#rehearsal-table")), written(browser, "#rehearsal-table")
            assert len(browser.find_elements("css selector", "#rehearsal-charts svg[aria-label]")) == 2
            size = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            assert script(browser, "return document.documentElement.scrollWidth") <= 390
            assert barriers(browser) == []
            browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
            write(browser, "#rehearsal-draws", "100" + ENTER)
            until(lambda: not script(browser, "return document.getElementById('rehearsal-stop').hidden"), "its begin")
            browser.find_element("id", "rehearsal-stop").send_keys(ENTER)
            until(lambda: "it was stopped" in written(browser, "#rehearsal-failure"), "its end")
            until(lambda: browser.find_element("id", "rehearsal-start").is_enabled(), "the page to allow another")
            write(browser, "#rehearsal-draws", "100" + ENTER)
            until(lambda: "begun by local" in written(browser, "#rehearsal-note"), "another one")
        until(lambda: written(browser, "#liveness").startswith("page disconnected"), "the loss of the server")
        # A server that is started anew has other numbers, and another reader's rehearsal is not this page's.
        with Served(other, "--port", port) as where:
            until(lambda: "which was started anew" in written(browser, "#rehearsal-failure"), "the end with the server")
            assert "Difference" in written(browser, "#rehearsal-table")
            # Until its stream is open again, the page sends nothing.
            until(lambda: not written(browser, "#liveness").startswith("page disconnected"), "the page's connection")
            own = where.rstrip("/")
            code, body = get(f"{own}/api/rehearsal", {**OUR_PAGE, "origin": own}, {"draws": 100})
            assert code == 200
            number = json.loads(body)["number"]
            # Its button may be off by now, for the page may know already.
            script(browser, "document.getElementById('rehearsal-form').requestSubmit()")
            until(lambda: "a rehearsal of local is under way" in written(browser, "#rehearsal-failure"), "the refusal")
            until(
                lambda: not script(browser, "return document.getElementById('rehearsal-stop').hidden"), "its progress"
            )
            assert get(f"{own}/api/rehearsal/stop", {**OUR_PAGE, "origin": own}, {"number": number + 1})[0] == 400
            browser.find_element("id", "rehearsal-stop").send_keys(ENTER)
            until(lambda: script(browser, "return document.getElementById('rehearsal-stop').hidden"), "its end")

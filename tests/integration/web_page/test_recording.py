"""The operator's page over a recording, in a real browser: by keyboard, at any time, and without a way to command."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from services.console.__main__ import main
from tests.integration.web_page.page import barriers, chromium_or_skip, script, shown, written
from tests.processes import he3, start
from tests.waiting import until

pytestmark = pytest.mark.exhaustive

LEFT, END, HOME, PAGE_DOWN = "\ue012", "\ue010", "\ue011", "\ue00f"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("recorded")
    assert main(["run", "short", "--in-process", "--quiet", "--out", str(out)]) == 0
    return out / "mission.mcap"


@pytest.fixture(scope="module")
def browser(recording: Path) -> Iterator[Any]:
    command = he3("web", "--port", "0", "--recording", str(recording))
    with (
        chromium_or_skip(logged={"browser": "ALL"}) as driver,
        start(command, stderr=subprocess.PIPE, text=True) as server,
    ):
        assert server.stderr is not None
        line = server.stderr.readline()
        found = re.search(r"recording of mission 'short' at (http://\S+) \(read-only\)", line)
        assert found is not None, line
        driver.get(found[1])
        yield driver
        server.kill()


def press(driver: Any, key: str) -> None:
    driver.find_element("id", "replay-time").send_keys(key)


def at_s(driver: Any) -> int:
    return int(script(driver, "return document.getElementById('replay-time').value"))


def test_a_recorded_mission_is_seen_at_any_time_by_keyboard_and_says_that_it_is_a_recording(browser: Any) -> None:
    until(lambda: written(browser, "#liveness").startswith("recording; then"), "the recording")
    until(lambda: (written(browser, "#authority"), written(browser, "#pace")) == ("recording", "paused"), "the pause")
    press(browser, END)
    until(lambda: "completed" in written(browser, "#phase"), "the end")
    samples = until(lambda: shown(browser).get("samples"), "the last map")
    for _ in range(3):
        press(browser, PAGE_DOWN)
    until(lambda: 0 < shown(browser).get("samples", 0) < samples, "an earlier map")
    assert "completed" not in written(browser, "#phase")
    earlier, events = at_s(browser), len(browser.find_elements("css selector", "#log li"))
    press(browser, LEFT)
    until(lambda: at_s(browser) == earlier - 60, "a minute before")
    press(browser, HOME)
    until(lambda: len(browser.find_elements("css selector", "#log li")) < events, "the log of the beginning")


def test_it_goes_on_at_its_pace_and_stands_still(browser: Any) -> None:
    before = at_s(browser)
    browser.find_element("id", "replay-play").click()
    until(lambda: written(browser, "#replay-play") == "Pause" and at_s(browser) > before + 60, "a minute")
    browser.find_element("id", "replay-play").click()
    until(lambda: written(browser, "#replay-play") == "Play", "the pause")


def test_nothing_on_it_can_be_sent_and_no_view_has_a_serious_barrier(browser: Any) -> None:
    seen = ".command-only button, .control-only button, button.acts-only, .commanders button"
    assert [each.text for each in browser.find_elements("css selector", seen) if each.is_displayed()] == []
    for theme, width in (("dark", 1440), ("light", 390)):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        script(browser, "document.documentElement.dataset.theme = arguments[0]", theme)
        assert barriers(browser) == [], (theme, width)
        assert script(browser, "return document.documentElement.scrollWidth") <= width
    assert [json.dumps(entry) for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []

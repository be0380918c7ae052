"""The page's timeline: plan and flight, one cursor with plots and map, and which of two facts is the newer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from services.console.client.mission_client import MissionClient
from tests.integration.web_page.page import ENTER, ESCAPE, click, in_module, script, written
from tests.waiting import until

FACTS = Path(__file__).parent / "timeline_facts.js"


def test_the_timeline_tells_plan_from_flight_and_what_is_known_from_what_is_not(browser: Any) -> None:
    found = browser.execute_async_script(FACTS.read_text())
    assert found["rounds"] == [
        ["planned", 0, 60, 0], ["planned", 65, 125, 0],  # the newest plan of a round counts
        ["good", 5, 70, 1], ["good", 70, 95, 1],  # flown as far as word has come
    ]  # fmt: skip
    assert found["rover"] == [["good", 1, 50, 0], ["accent", 90, 95, 0], ["unknown", 50, 90, 0]]
    assert found["rows"] == [0, 1]  # they overlap
    assert found["contact"] == [[None, 20, 20, 0], ["contact", 0, 20, 0], ["none", 20, 100, 0], ["ahead", 200, 260, 0]]
    # As late as it began, as it ended, as the next one began; overdue by what light has brought, not by the clock.
    assert found["deviations"] == [5, 10, 5, 15]
    assert found["text"] == "round 2: 15 min 00 s behind plan, as of T+ 0 d 02:20:00"
    assert found["next"] == "next contact in 1 h 40 min, at T+ 0 d 03:20:00"
    assert "no report of what the rover did for 40 min 00 s" in found["said"]
    assert found["edges"] == [0, 1, 5, 10]
    assert found["places"] == [None, 5, 70, 70]
    # What is not decided yet: a plan that waits comes after those that were sent, a previewed command now.
    assert found["proposed"] == [["3", 125, 155], ["go to?", 100, 104]]
    # A label stands where no line crosses it: at its item's beginning, in its first gap, behind it, or nowhere.
    assert found["labels"] == [[100, True], [120, True], [120, False], None, None, [150, True], [0, True], None]


def test_one_cursor_goes_over_timeline_plots_and_map_by_keyboard(browser: Any, mission: MissionClient) -> None:
    until(lambda: mission.status().round >= 1, "a round")
    until(lambda: "round" in written(browser, "#timeline-says"), "the round on the timeline")
    strip = browser.find_element("id", "timeline")
    script(browser, "document.getElementById('timeline').focus()")
    label = "return document.querySelector('#chart-energy .plot').getAttribute('aria-label')"
    strip.send_keys("0", "\ue012")  # the whole mission; left
    until(lambda: " at T+" in script(browser, label), "the cursor on the plot")
    at = str(script(browser, label)).rpartition(" at ")[2]
    assert written(browser, "#timeline-says").startswith(at), "one time on the plot and in the timeline"
    for _ in range(4):
        strip.send_keys("p")
    strip.send_keys("+")
    until(lambda: "span=" in browser.current_url, "what is seen in the address")
    strip.send_keys(ENTER)
    until(lambda: not script(browser, "return document.getElementById('past').hidden"), "the map of that moment")
    strip.send_keys(ESCAPE, "0")
    until(lambda: " at T+" not in script(browser, label) and "span=" not in browser.current_url, "the present")
    click(browser, "#live")
    script(browser, "document.getElementById('timeline-list').open = true")
    until(lambda: "as planned" in written(browser, "#timeline-rows"), "the rows in words")
    script(browser, "document.getElementById('timeline-list').open = false")
    assert "contact" in written(browser, "#timeline-contact")


def test_newer_facts_win_and_numbers_are_as_people_write_them(browser: Any) -> None:
    """The reply to a command may come after reports of later stages."""
    stages = [{"stage": stage, "at": at, "why": ""} for at, stage in enumerate(("queued", "released", "rejected"))]
    told = {"command": {"command_id": "overtaken", "kind": "pause"}, "by": "", "end": "rejected", "stages": stages}
    early = told | {"end": None, "stages": stages[:1]}
    kept = in_module(
        browser,
        "commands.js",
        f"(it.takeCommand({json.dumps(told)}), it.takeCommand({json.dumps(early)}), "
        "document.querySelector('#commands > li[data-id=overtaken]').dataset.stages)",
    )
    assert json.loads(kept) == stages
    in_module(browser, "state.js", "it.state.commands.delete('overtaken')")
    in_module(browser, "commands.js", "it.showCommands() ?? null")
    assert in_module(browser, "words.js", "[it.grouped(12345.678, 1), it.grouped(1234567)]") == [
        "12,345.7",
        "1,234,567",
    ]
    # A browser reads the pattern of a field in its strictest way, and ignores one that it cannot read.
    patterns = "return [...document.querySelectorAll('[pattern]')].map((each) => new RegExp(each.pattern, 'v').source)"
    assert len(script(browser, patterns)) >= 1

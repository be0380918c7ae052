"""The page on screens of any width, in light and dark, and without barriers."""

from __future__ import annotations

import json
from typing import Any

import pytest

from services.console.client.mission_client import MissionClient
from tests.integration.web_page.page import ESCAPE, barriers, click, in_module, press, script, shown, written
from tests.waiting import until


def test_a_long_name_of_an_area_is_shortened_on_the_map_and_whole_under_the_pointer(browser: Any) -> None:
    assert in_module(
        browser, "marks.js", "[it.shortened('crater', 6, (t) => t.length), it.shortened('craters', 6, (t) => t.length),"
        " it.shortened('crater', 0, (t) => t.length)]"
    ) == ["crater", "crate…", "c…"]  # fmt: skip
    name = "Boulder-field-below-the-western-scarp-1"
    hovered = in_module(
        browser, "layers.js",
        f"it.map.areas = [{{kind: 'keepout', name: '{name}', note: '',"
        " corners: [[100, 100], [200, 100], [200, 200]]}],"
        "[[180, 120], [120, 180]].map((place) => { it.map.onHover(place, [9, 9]);"
        f" return document.getElementById('hover').textContent.includes('keep-out {name}'); }})",
    )  # fmt: skip
    assert hovered == [True, False]


def test_no_name_of_an_area_makes_the_page_wider_than_a_phone(browser: Any) -> None:
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    wide = {"area_id": "W" * 40, "polygon_m": [[1, 1], [9, 1], [9, 9]], "weight": 2}
    in_module(browser, "areas.js", f"it.takeInterests({{areas: [{json.dumps(wide)}]}})")
    entry = {"number": 9999, "at": 1, "kind": "interest", "text": f"area of interest {'W' * 40} set", "by": "anna"}
    in_module(browser, "state.js", f"it.state.entries.push({json.dumps(entry)})")
    in_module(browser, "log.js", "it.showLog()")
    until(lambda: "W" * 40 in script(browser, "return document.getElementById('log').textContent"), "the log")
    assert script(browser, "return document.documentElement.scrollWidth") <= 390


def test_the_page_fits_a_phone_in_light_and_dark(browser: Any, address: str) -> None:
    browser.get(address)
    until(lambda: shown(browser).get("layer") == "mean", "the map")
    for scheme in ("light", "dark"):
        browser.execute_cdp_cmd(
            "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
        )
        browser.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride", {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
        )
        assert script(browser, "return getComputedStyle(document.documentElement).colorScheme") == scheme
        assert script(browser, "return document.documentElement.scrollWidth") <= 390
    # The answer to a tap is where the eyes are: on the map, which is above its panel.
    script(browser, "document.getElementById('map').scrollIntoView({block: 'center'})")
    browser.find_element("id", "map").click()
    until(lambda: " ppb" in written(browser, "#answer"), "the answer to the tap")
    seen = "const {top, bottom} = document.getElementById('answer').getBoundingClientRect();"
    assert script(browser, f"{seen} return bottom > top && top >= 0 && bottom <= innerHeight")


@pytest.mark.exhaustive
def test_no_view_of_the_page_has_a_serious_barrier(browser: Any, address: str, mission: MissionClient) -> None:
    size = {"width": 1440, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    past = until(lambda: mission.history().revisions[1:], "a second map")[0].revision
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get("about:blank")
    browser.get(
        f"{address}#compare=swipe&with=error&relief=1&zoom=2&draw=50,50,90,50,90,90&measure=10,10,40,60&revision={past}"
    )
    until(lambda: shown(browser).get("other") == "error", "the map")
    script(browser, "for (const each of document.querySelectorAll('details')) each.open = true")
    script(
        browser,
        "const t = document.getElementById('stack-text'); t.value = 'safe\\nresume';"
        "t.dispatchEvent(new Event('input')); document.getElementById('stack-check').click()",
    )
    until(lambda: script(browser, "return document.getElementById('stack-lines').children.length") == 2, "the check")
    press(browser, "Escape", "n")
    until(lambda: browser.find_elements("id", "sample-facts"), "a sample")
    for theme, width in (("dark", 1440), ("light", 390)):
        script(browser, "document.documentElement.dataset.theme = arguments[0]", theme)
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size | {"width": width})
        assert barriers(browser) == [], (theme, width)
    click(browser, "[data-command=pause]")
    until(lambda: "word back" in written(browser, "#preview"), "the preview")
    assert barriers(browser) == []
    browser.switch_to.active_element.send_keys(ESCAPE)

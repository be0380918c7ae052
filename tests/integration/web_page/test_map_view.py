"""The page's map: layers, zoom, measures, places and areas, by pointer, touch and keyboard."""

from __future__ import annotations

import base64
import io
import json
from typing import Any

import numpy as np
import pytest
from PIL import Image

from services.console.client.mission_client import MissionClient
from tests.integration.web_page.page import click, in_address, in_module, pinch, press, script, shown, write, written
from tests.waiting import until


def test_the_view_is_in_the_address_and_a_reload_forgets_nothing(
    browser: Any, address: str, mission: MissionClient
) -> None:
    until(lambda: len(mission.history().revisions) >= 3, "a past to go to")
    past = mission.history().revisions[1].revision
    browser.get("about:blank")
    browser.get(f"{address}#layer=exceedance&threshold=7&revision={past}&at=120,340")

    def seen() -> tuple[Any, ...]:
        layer = shown(browser)
        return layer.get("layer"), layer.get("revision"), "(120, 340) m" in written(browser, "#place-hint")

    until(lambda: seen() == ("exceedance", past, True), "what the address asks for")
    click(browser, "input[value=std] + span")
    click(browser, "#live")
    until(lambda: browser.current_url == f"{address}#layer=std&at=120,340", "the new view in the address")
    browser.refresh()
    until(lambda: seen()[0] == "std" and seen()[2], "the view after a reload")
    assert browser.current_url == f"{address}#layer=std&at=120,340"
    browser.get("about:blank")
    browser.get(address)


def test_the_map_is_zoomed_and_panned_in_every_way_and_a_drag_is_no_click(browser: Any, mission: MissionClient) -> None:
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    canvas = browser.find_element("id", "map")
    script(browser, "arguments[0].scrollIntoView({block: 'center'})", canvas)
    until(lambda: shown(browser).get("layer") == "mean", "the map")
    browser.get_log("performance")
    place, before = in_address(browser).get("at"), (len(mission.commands()), mission.set_interest())

    def zoom() -> float:
        return float(in_module(browser, "layers.js", "it.map.projection.zoom"))

    def west() -> float:
        return float(in_module(browser, "layers.js", "it.map.projection.window.west"))

    ActionChains(browser).scroll_from_origin(ScrollOrigin.from_element(canvas), 0, -700).perform()
    until(lambda: zoom() > 2.0, "the zoom of the wheel")
    began = west()
    ActionChains(browser).drag_and_drop_by_offset(canvas, 60, 20).perform()
    until(lambda: west() < began, "the map to follow the pointer")
    dragged = west()
    script(browser, "document.getElementById('map').focus()")
    ActionChains(browser).key_down("\ue009").send_keys("\ue014").key_up("\ue009").perform()  # Control and right
    assert west() > dragged
    for keys, buttons, check in (
        ("0", "", lambda now, _: now == 1.0), ("+", "", lambda now, last: now > last),
        ("-", "", lambda now, _: now == 1.0), ("", "zoom-in", lambda now, last: now > last),
        ("", "zoom-out", lambda now, _: now == 1.0), ("", "zoom-in", lambda now, last: now > last),
        ("", "zoom-fit", lambda now, _: now == 1.0),
    ):  # fmt: skip
        last = zoom()
        press(browser, *keys)
        if buttons:
            browser.find_element("id", buttons).click()
        assert check(zoom(), last), (keys, buttons)
    box = script(
        browser, "const b = arguments[0].getBoundingClientRect(); return [b.left + b.width / 2, b.top + 200]", canvas
    )
    pinch(browser, *box)
    until(lambda: zoom() > 1.5, "the zoom of two fingers")
    until(lambda: float(in_address(browser).get("zoom", 1.0)) > 1.5, "the zoom in the address")
    assert in_address(browser).get("at") == place
    assert (len(mission.commands()), mission.set_interest()) == before
    sent = [
        message["params"]["request"]["method"]
        for entry in browser.get_log("performance")
        if (message := json.loads(entry["message"])["message"])["method"] == "Network.requestWillBeSent"
    ]
    assert set(sent) <= {"GET"}
    press(browser, "0")


def test_lines_are_measured_and_samples_compared_with_the_map_by_keyboard(browser: Any, mission: MissionClient) -> None:
    press(browser, "m", "Enter")
    press(browser, "ArrowRight", shift=True)
    press(browser, "Enter")
    assert written(browser, "#measured") == "25.0 m towards 90°"
    press(browser, "ArrowUp", shift=True)
    press(browser, "Enter")
    assert written(browser, "#measured") == "50.0 m along 2 legs, the last 25.0 m towards 0°"
    press(browser, "Escape", "n")
    first = mission.samples()[0]
    until(lambda: browser.find_elements("id", "sample-facts"), "the sample")
    told = (
        "const [facts, place] = ['sample-facts', 'place'].map((id) => document.getElementById(id));"
        "return [facts.textContent, place.dataset.point]"
    )
    text, point = script(browser, told)  # both of one moment
    point = json.loads(point)
    assert f"{first.helium3_ppb:.3f} ± {first.noise_std_ppb:.3f} ppb" in text
    residual = first.helium3_ppb - mission.point(first.x_m, first.y_m, as_of=point["revision"]).mean_ppb
    assert f"{abs(residual):.3f} ppb" in text
    assert f"{first.depth_m:.2f} m" in text
    until(lambda: in_address(browser).get("sample") == first.sample_id, "the sample in the address")


def test_what_the_map_shows_is_what_the_ground_answers_for_differences_and_layers_of_terrain(
    browser: Any, address: str, mission: MissionClient
) -> None:
    until(lambda: len(mission.history().revisions) > 2, "three revisions of the map")
    past = mission.history().revisions
    now, then = past[-1].revision, past[1].revision
    browser.get("about:blank")
    browser.get(
        f"{address}#revision={now}&compare=difference&than={then}&range=-2,2&relief=1&zoom=3&centre=200,300&at=120,340"
    )
    until(lambda: shown(browser).get("mode") == "difference", "the difference")
    seen = in_module(browser, "layers.js", "it.map.panes[0].source.valueAt([120.5, 340.5]).value")
    layers = [mission.layer("mean", as_of=revision).values for revision in (now, then)]
    assert seen == pytest.approx(
        float(layers[0][340, 120] - layers[1][340, 120]), abs=2 * float(np.ptp(layers[0])) / 65535
    )
    assert in_module(browser, "layers.js", "it.map.panes[0].range") == [-2, 2]
    # The exported picture is the view, with its title, its legend and where it comes from.
    click(browser, "#picture")
    made = json.loads(
        until(lambda: script(browser, "return document.getElementById('picture').dataset.made"), "the picture")
    )
    assert made["name"] == f"{mission.mission}-mean-{now}.png"
    packed = in_module(browser, "picture.js", "it.picture().toDataURL('image/png').split(',')[1]")
    with Image.open(io.BytesIO(base64.b64decode(packed))) as picture:
        assert picture.size == (made["width"], made["height"])
        assert len(picture.convert("RGB").getcolors(2**24) or ()) > 50
    # A reload forgets nothing; the layer beside it in the swipe is the region's.
    script(
        browser,
        "const s = document.getElementById('compare'); s.value = 'swipe'; s.dispatchEvent(new Event('change'));"
        "const o = document.getElementById('other-layer'); o.value = 'slope'; o.dispatchEvent(new Event('change'))",
    )
    until(lambda: shown(browser).get("other") == "slope", "the slope beside the mean")
    wanted = f"#revision={now}&compare=swipe&with=slope&than={then}&relief=1&zoom=3&centre=200.0,300.0&at=120,340"
    until(lambda: browser.current_url.endswith(wanted), "the view in the address")
    browser.refresh()
    until(lambda: shown(browser).get("other") == "slope", "the view after a reload")
    assert browser.current_url.endswith(wanted)
    value = in_module(browser, "layers.js", "it.map.panes[1].source.valueAt([200.5, 300.5]).value")
    assert value == pytest.approx(float(mission.layer("slope").values[300, 200]), abs=1e-3)
    # Of 4 million cells a view takes the tiles that it shows, at the level of its pixels.
    site, parts = "{rows: 2000, columns: 2000, resolution_m: 1}", ((0, 2000, 0.4), (700, 1100, 2.0), (900, 910, 80.0))
    counts = [
        in_module(
            browser,
            "raster.js",
            f"new it.TileSource({site}, {{layer: 'mean'}})"
            f".needed({{west: {low}, south: {low}, east: {high}, north: {high}}}, {scale}).map(([level]) => level)",
        )
        for low, high, scale in parts
    ]
    assert counts == [[1] * 4, [0] * 4, [0]]
    browser.get("about:blank")
    browser.get(address)


def test_what_is_said_of_a_place_and_of_an_area_follows_the_map_or_says_that_it_is_outdated(
    browser: Any, address: str, mission: MissionClient
) -> None:
    browser.get("about:blank")
    browser.get(f"{address}#at=120,340&draw=50,50,90,50,90,90")

    def shown_revision() -> int:
        point = script(browser, "return document.getElementById('place').dataset.point")
        return 0 if point is None else int(json.loads(point)["revision"])

    before = until(shown_revision, "the posterior at the place")
    click(browser, "#estimate")
    until(lambda: browser.find_elements("css selector", "#estimate-result td"), "the estimate")
    corner = ((480.0, 480.0), (490.0, 480.0), (490.0, 490.0))
    mission.command("set_keep_out", area_id="far-away", polygon_m=corner)  # closed ground is another map
    until(lambda: shown_revision() > before, "the place on the new map")
    until(lambda: "Outdated: of revision" in written(browser, "#estimate-result"), "the note on the estimate")
    write(browser, "#cutoff", "9")
    assert "for a cut-off of 8 ppb" in written(browser, "#estimate-result .outdated")
    # What cannot be is not shown: an abundance below zero.
    script(
        browser,
        "const real = window.fetch; window.fetch = async (url, options) => {"
        "if (!String(url).startsWith('/api/map/point')) return real(url, options);"
        "const told = await (await real(url, options)).json();"
        "return new Response(JSON.stringify({...told, low_95_ppb: -1.9, high_95_ppb: 2.06}));};"
        "window.giveBack = () => { window.fetch = real; }",
    )
    script(browser, "document.getElementById('threshold').dispatchEvent(new Event('change'))")
    until(lambda: "0.00 to 2.06 ppb" in written(browser, "#place"), "an interval that begins at zero")
    script(browser, "window.giveBack()")


def test_a_chosen_place_is_answered_at_once_from_the_pages_own_map_as_the_ground_then_answers_it(
    browser: Any, address: str
) -> None:
    browser.get("about:blank")
    browser.get(address)
    until(lambda: in_module(browser, "layers.js", "it.heldAt([201.5, 304.5])"), "mean and deviation on the page")
    told = browser.execute_async_script(
        "const done = arguments[0], place = document.getElementById('place'), said = {};"
        "new MutationObserver((_, watch) => {"
        "  if (place.dataset.held) Object.assign(said, {held: JSON.parse(place.dataset.held), text: place.textContent,"
        "    hint: document.getElementById('place-hint').textContent});"
        "  if (!place.dataset.point) return;"
        "  watch.disconnect();"
        "  done({...said, point: JSON.parse(place.dataset.point), after: place.dataset.held ?? null});"
        "}).observe(place, {attributeFilter: ['data-held', 'data-point']});"
        "import('/static/layers.js').then(({map}) => map.choose([201.5, 304.5]))"
    )
    held, point = told["held"], told["point"]
    assert "read off this page's map; asking the ground" in told["hint"]
    assert f"{held['mean_ppb']:.2f} ± {held['std_ppb']:.2f} ppb" in told["text"]
    assert told["after"] is None
    assert held["exact"] is True
    if held["revision"] == point["revision"]:  # the mission goes on
        step = 40.0 / 65535  # ppb: a map is sent in 65,536 steps from its lowest to its highest value
        assert held["mean_ppb"] == pytest.approx(point["mean_ppb"], abs=step)
        assert held["std_ppb"] == pytest.approx(point["std_ppb"], abs=step)


def test_a_place_without_an_answer_shows_nothing_of_the_place_before(browser: Any) -> None:
    click(browser, "input[value=traversable] + span")  # of this layer the page holds neither mean nor deviation
    until(lambda: shown(browser).get("layer") == "traversable", "the layer")
    in_module(browser, "layers.js", "it.map.choose([120.5, 340.5]) ?? null")
    until(lambda: " ppb" in written(browser, "#place"), "the answer")
    script(
        browser,
        "const real = window.fetch; window.fetch = (url, options) => String(url).startsWith('/api/map/point')"
        " ? Promise.reject(new TypeError('gone')) : real(url, options)",
    )
    in_module(browser, "layers.js", "it.map.choose([201.5, 304.5]) ?? null")
    until(lambda: written(browser, "#place-hint") == "(201.5, 304.5) m, the ground did not answer", "what is known")
    assert (written(browser, "#place"), "201.5" in written(browser, "#answer")) == ("", True)


def test_a_page_that_is_not_seen_draws_nothing_and_shows_the_present_when_it_is_seen_again(
    browser: Any, address: str
) -> None:
    browser.get(address)
    until(lambda: shown(browser).get("layer") == "mean", "the map")
    script(
        browser,
        "window.kept = []; window.real = requestAnimationFrame;"
        "window.requestAnimationFrame = (draw) => window.kept.push(draw)",  # a browser does so with a hidden page
    )
    until(lambda: script(browser, "return kept.length") > 0, "the frame that the page waits for")
    before, heard = written(browser, "#elapsed"), "it.state.clock.now"
    began = in_module(browser, "state.js", heard)
    until(lambda: in_module(browser, "state.js", heard) > began + 100e9, "what the server sends")
    assert written(browser, "#elapsed") == before
    assert script(browser, "return kept.length") <= 2  # the page's, and that of the map, each asked for once
    script(browser, "window.requestAnimationFrame = real; for (const draw of kept) real(draw)")
    until(lambda: written(browser, "#elapsed") != before, "the present")

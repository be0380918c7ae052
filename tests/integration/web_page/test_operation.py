"""An operator commands a mission on the page: previews, stacks, areas, the link."""

from __future__ import annotations

import io
import json
from csv import DictReader
from pathlib import Path
from typing import Any

from services.console.__main__ import main
from services.console.client.areas import AreaKind
from services.console.client.mission_client import MissionClient
from tests.integration.web_page.page import (
    ENTER,
    ESCAPE,
    click,
    decide,
    deliberately,
    draw_area,
    in_module,
    order,
    script,
    shown,
    still,
    write,
    written,
)
from tests.integration.web_page.server import RATE, Served
from tests.waiting import expect_within, until

LIGHT_TIME_S = 1.282


def test_an_operator_sees_the_mission_commands_it_and_goes_back_in_time(
    browser: Any, address: str, mission: MissionClient
) -> None:
    # Samples come in, and every layer can be looked at.
    until(lambda: shown(browser).get("samples", 0) >= 2, "two samples on the page")
    for layer in ("std", "information", "exceedance", "traversable", "mean"):
        click(browser, f"input[value={layer}] + span")
        until(lambda layer=layer: shown(browser).get("layer") == layer, f"layer {layer}")
    pale = "return document.getElementById('map').classList.contains('another')"
    assert not script(browser, pale)
    assert script(browser, f"document.querySelector('input[value=std]').click(); {pale}")
    until(lambda: shown(browser).get("layer") == "std" and not script(browser, pale), "the layer that was chosen")
    click(browser, "input[value=mean] + span")
    until(lambda: shown(browser).get("layer") == "mean", "layer mean")

    # A place that is clicked: the page says what a Zenoh query says.
    script(
        browser,
        "const map = document.getElementById('map'), box = map.getBoundingClientRect();"
        "map.dispatchEvent(new MouseEvent('click', "
        "{clientX: box.left + box.width * 0.4, clientY: box.top + box.height * 0.5, bubbles: true}))",
    )
    # Both of one moment: with the next sample the page says something else.
    told = "const {dataset, textContent} = document.getElementById('place'); return [textContent, dataset.point]"
    said, text = until(lambda: (it := script(browser, told))[1] and it, "the posterior at the place")
    point = json.loads(text)
    asked = mission.point(point["x_m"], point["y_m"], threshold=8.0, as_of=point["revision"])
    # JavaScript's numbers hold times to a quarter of a microsecond; everything else is equal to the digit.
    inexact = {"mission_time_ns"}
    assert asked.model_dump(exclude=inexact) == {key: point[key] for key in point.keys() - inexact}
    assert f"{point['mean_ppb']:.3f}" in said

    # A command goes up, and its stages come back with the light time in them.
    order(browser, "button[data-command=pause]")

    def stages() -> dict[str, int]:
        found = script(browser, "return document.querySelector('#commands > li')?.dataset.stages || '[]'")
        return {stage["stage"]: stage["at"] for stage in json.loads(found)}

    until(lambda: "completed" in stages(), "the pause to be completed")
    passed = stages()
    assert list(passed)[:3] == ["queued", "released", "radiated"]
    on_the_way_s = (passed["received"] - passed["radiated"]) / 1e9
    assert on_the_way_s >= LIGHT_TIME_S - 1e-6
    expect_within(0.5, (on_the_way_s - LIGHT_TIME_S) / RATE, "the processing of a telecommand beside its light time")
    assert passed["accepted"] >= passed["received"]
    assert passed["completed"] >= passed["started"]
    until(lambda: script(browser, "return document.getElementById('rover-mode').textContent") == "paused", "paused")

    # The sender of the command has a name, which nothing proves without keys.
    assert written(browser, "#commands > li .by").startswith("by ")
    assert written(browser, "#commands > li .by").endswith(" (unverified)")

    # An alarm stays until an operator has acknowledged it.
    order(browser, "button[data-command=safe]")
    alarm = ".alarm[data-kind=safe_mode]"
    until(lambda: browser.find_elements("css selector", f"{alarm}.critical .acknowledge"), "the alarm")
    click(browser, f"{alarm} .acknowledge")
    until(lambda: "acknowledged" in written(browser, f"{alarm} .seen-by"), "the acknowledgement")
    assert mission.log().entries[-1].text == "safe-mode acknowledged"

    # Everything is in the log: what is chosen is what is shown, and what becomes a file.
    until(lambda: "pause op-" in written(browser, "#log"), "the command in the log")
    write(browser, "#log-text", "acknowledged")
    until(lambda: len(browser.find_elements("css selector", "#log li")) == 1, "one line")
    csv = script(
        browser,
        "return import('/static/loglines.js').then(async (log) => {"
        "const { state } = await import('/static/state.js');"
        "const all = log.logLines({ ...state, commands: state.commands.values() });"
        "return log.asCsv(log.chosen(all, new Set(['alarm']), 'acknowledged')) })",
    )
    assert [row["name"] for row in DictReader(io.StringIO(csv))] == ["alarm"]
    write(browser, "#log-text", "")

    # Back through time, and forth again.
    until(lambda: int(script(browser, "return document.getElementById('time').max")) >= 2, "a past to go to")
    script(
        browser,
        "const time = document.getElementById('time'); time.value = 1; time.dispatchEvent(new Event('input'))",
    )
    first = mission.history().revisions[1]
    until(lambda: shown(browser).get("revision") == first.revision, "the map as it was")
    assert shown(browser)["samples"] == first.samples
    assert not script(browser, "return document.getElementById('past').hidden")
    click(browser, "#live")
    until(lambda: shown(browser).get("revision", 0) > first.revision, "the map as it is")

    # An area drawn with the keyboard: estimated, and sent as a keep-out.
    draw_area(browser)
    click(browser, "#estimate")
    until(lambda: browser.find_elements("css selector", "#estimate-result td"), "the estimate")
    order(browser, "#send-keepout")
    until(lambda: any(c.command.area_id == "area-1" for c in mission.commands()), "the keep-out at the ground")

    assert [entry for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")] == []
    requests = [
        message["params"]["request"]["url"]
        for entry in browser.get_log("performance")
        if (message := json.loads(entry["message"])["message"])["method"] == "Network.requestWillBeSent"
    ]
    ours = [url for url in requests if url.startswith(address)]
    # What the browser shows of itself (chrome:) and what the page made (data:, blob:) goes nowhere.
    elsewhere = [url for url in requests if not url.startswith((address, "data:", "blob:", "chrome"))]
    assert (bool(ours), elsewhere) == (True, [])


def test_a_double_click_sends_once_and_reaches_no_control_that_moves_under_the_pointer(
    browser: Any, mission: MissionClient
) -> None:
    from selenium.webdriver import ActionChains

    before = {each.command.command_id for each in mission.commands()}

    def new() -> list[str]:
        return [each.command.kind.value for each in mission.commands() if each.command.command_id not in before]

    draw_area(browser)
    write(browser, "#area-name", "double")
    keep_out = browser.find_element("id", "send-keepout")
    deliberately(browser, ActionChains(browser).double_click(keep_out).perform)
    decide(browser, ENTER)
    until(lambda: new() == ["set_keep_out"], "the keep-out at the ground")
    # Nor does the second click close the preview where its control not to send lies under the pointer.
    script(
        browser,
        "const box = document.querySelector('[data-command=pause]').getBoundingClientRect();"
        "const close = document.getElementById('preview-close');"
        "close.style = `position: fixed; left: ${box.left}px; top: ${box.top}px; width: ${box.width}px;`",
    )
    pause = browser.find_element("css selector", "[data-command=pause]")
    deliberately(browser, ActionChains(browser).double_click(pause).perform)
    decide(browser, ENTER)
    until(lambda: new() == ["set_keep_out", "pause"], "one pause")
    script(browser, "document.getElementById('preview-close').style = ''")
    # A click comes at a control that was moved in that moment: it is not sent, and the page says so.
    still(browser)
    text = script(
        browser,
        "document.getElementById('place').style.paddingTop = '60px';"
        "const abort = document.querySelector('[data-command=abort_round]');"
        "abort.dispatchEvent(new MouseEvent('click', {bubbles: true, cancelable: true, detail: 1}));"
        "const said = document.getElementById('toast').textContent;"
        "document.getElementById('place').style.paddingTop = '';"
        "return said",
    )
    assert "“Abort round” had just moved under the pointer: nothing was sent" in text
    order(browser, "[data-command=resume]")
    until(lambda: new() == ["set_keep_out", "pause", "resume"], "the resume, and nothing else")


def test_a_command_is_sent_only_when_its_preview_was_read_and_enter_pressed(
    browser: Any, mission: MissionClient
) -> None:
    before = len(mission.commands())
    script(browser, "document.activeElement.blur()")
    # The answer is held, so that the key comes before it however long the browser takes.
    script(
        browser,
        "const given = window.fetch;"
        "const held = new Promise((release) => {"
        "  window.letGo = () => { window.fetch = given; release(); };"
        "});"
        "window.fetch = async (...words) => { await held; return given(...words); };",
    )
    click(browser, "[data-command=return_to_start]")
    assert written(browser, "#preview-said") == "Asking the ground …"
    browser.switch_to.active_element.send_keys(ENTER)  # too early: it was not read yet
    assert script(browser, "return document.getElementById('preview-send').disabled")
    assert script(browser, "return document.getElementById('preview').open")
    script(browser, "letGo()")
    text = until(lambda: "word back" in written(browser, "#preview") and written(browser, "#preview"), "the preview")
    assert all(word in text for word in ("the rover drives back", "drive", "energy", "rounds", "on rover"))
    where = "return JSON.stringify(document.getElementById('preview-send').getBoundingClientRect())"
    stands = script(browser, where)
    until(lambda: script(browser, "return document.activeElement.id") == "preview-send", "the control to send")
    assert script(browser, where) == stands
    decide(browser, ESCAPE)
    until(lambda: not script(browser, "return document.getElementById('preview').open"), "the end of the preview")
    assert len(mission.commands()) == before


def test_a_command_stack_is_checked_then_sent_step_by_step_and_outlives_a_reload(
    browser: Any, address: str, mission: MissionClient
) -> None:
    before = len(mission.commands())
    write(browser, "#stack-text", "pause\nresume\nresume")
    click(browser, "#stack-check")
    refused = "line 3 (resume): expected a rover that is paused or in safe mode by then"
    until(lambda: refused in written(browser, "#stack-failure"), "the rule that it breaks")
    assert not browser.find_element("id", "stack-send").is_enabled()
    write(browser, "#stack-text", "pause\nafter completed: resume")
    click(browser, "#stack-check")
    until(lambda: "stops at its next safe point" in written(browser, "#stack-lines"), "what it would do")
    click(browser, "#stack-step")
    click(browser, "#stack-send")
    until(lambda: written(browser, "#stack-asks-title") == "Line 1 waits for your answer: pause", "the question")
    assert len(mission.commands()) == before
    click(browser, "#stack-yes")
    until(lambda: "Line 2 waits" in written(browser, "#stack-asks-title"), "the next question")
    browser.refresh()
    until(lambda: "Line 2 waits" in written(browser, "#stack-asks-title"), "the question after a reload")
    click(browser, "#stack-yes")
    until(lambda: written(browser, "#stack-note") == "done, 2 of 2 completed", "the end of the stack")
    sent = [status.command.kind.value for status in mission.commands()[before:]]
    assert sent == ["pause", "resume"]
    # A reply that comes after what the stream has told of later is not taken.
    in_module(
        browser,
        "stacks.js",
        "import('/static/state.js').then(({state: {stack}}) =>"
        " it.takeStack({...stack, serial: stack.serial - 1, ended: false}) ?? null)",
    )
    assert written(browser, "#stack-note") == "done, 2 of 2 completed"


def test_a_field_that_is_empty_or_out_of_range_sends_nothing(browser: Any, mission: MissionClient) -> None:
    before = mission.set_interest()
    draw_area(browser)
    write(browser, "#area-name", "empty")
    for text, complaint in (("", "weight: expected a number from 0 to 1000, got nothing"), ("-3", "got -3")):
        write(browser, "#weight", text)
        click(browser, "#send-interest")
        until(lambda complaint=complaint: complaint in written(browser, "#toast"), complaint)
    write(browser, "#weight", "3 ")  # a space bar in the field presses no button
    assert script(browser, "return document.querySelectorAll('button :is(input, select, button)').length") == 0
    assert mission.set_interest() == before
    click(browser, "#send-interest")
    until(lambda: {area.area_id for area in mission.set_interest()} > {area.area_id for area in before}, "the area")


def test_an_area_is_replaced_only_when_that_is_asked_for(browser: Any, mission: MissionClient) -> None:
    before = mission.set_interest("taken", [(10, 10), (20, 10), (20, 20)], 4.0)
    draw_area(browser)
    write(browser, "#area-name", "taken")
    write(browser, "#weight", "7")
    click(browser, "#send-interest")
    until(lambda: "Replace taken" in written(browser, "#send-interest"), "the question")
    assert mission.set_interest() == before
    click(browser, "#send-interest")
    until(lambda: [a.weight for a in mission.set_interest() if a.area_id == "taken"] == [7.0], "the other weight")
    until(lambda: written(browser, "#send-interest") == "Set interest", "the end of the question")


def test_the_link_form_sends_only_what_was_edited_and_tells_what_others_changed_meanwhile(
    browser: Any, mission: MissionClient
) -> None:
    assert script(browser, "return document.getElementById('link-submit').disabled")
    mission.set_link(direction="up", rate_bit_s=125_000.0)
    write(browser, "[name=loss]", "0.001")
    mission.set_link(contact=False, loss=0.002)
    until(lambda: "loss is now 0.002" in written(browser, "#link-note"), "the change by another")
    contact = "return document.querySelector('[name=contact]').value"
    until(lambda: script(browser, contact) == "off", "the field that was not edited to show what is")
    click(browser, "#link-submit")
    until(lambda: mission.link().conditions.up.loss == 0.001, "the loss")
    link = mission.link()
    assert (link.contact_forced, link.conditions.up.rate_bit_s) == (False, 125_000.0)
    assert link.conditions.down.rate_bit_s is None
    # The rates differ: the field is empty and says both; what is left untouched stays.
    until(lambda: script(browser, "return document.querySelector('[name=rate_bit_s]').value") == "", "two rates")
    until(lambda: written(browser, "#liveness").startswith("out of contact"), "no contact")
    assert "old" in script(browser, "return document.querySelector('[data-known-by=rover]').className")
    mission.set_link(contact_as_scheduled=True, unlimited_rate=True, loss=0.0)
    until(lambda: written(browser, "#liveness").startswith("live"), "contact")


def test_areas_are_renamed_and_removed_from_their_list_and_nothing_is_sent_before(
    browser: Any, mission: MissionClient
) -> None:
    mission.set_interest("old", [(10, 10), (20, 10), (20, 20)], 4.0)
    mission.set_interest("gone", [(30, 10), (40, 10), (40, 20)], 4.0)
    mission.set_interest("stays", [(50, 10), (60, 10), (60, 20)], 4.0)
    browser.refresh()
    until(lambda: browser.find_elements("css selector", "[aria-label='Rename old']"), "the list of areas")
    before = mission.areas()
    click(browser, "[aria-label='Rename old']")
    until(lambda: script(browser, "return document.activeElement.ariaLabel") == "New name of old", "the field")
    browser.switch_to.active_element.send_keys(f"gone{ENTER}")
    until(
        lambda: "expected a new one, got that of an area that is set: gone" in written(browser, "#toast"), "the refusal"
    )
    browser.switch_to.active_element.send_keys(f"\ue009a\ue000new{ENTER}")
    click(browser, "[aria-label='Remove gone']")
    click(browser, "[aria-label='Remove stays']")
    assert script(browser, "return document.activeElement.id") == "undo-area"  # where the keyboard goes on
    click(browser, "#undo-area")
    assert written(browser, "#area-changes-note") == "2 changes are not sent"
    assert mission.areas() == before
    click(browser, "#send-areas")

    def names() -> set[str]:
        return {area.name for area in mission.areas_of(AreaKind.INTEREST)}

    kept = {area.name for area in before if area.kind is AreaKind.INTEREST} - {"old", "gone"}
    until(lambda: names() == kept | {"new"}, "the new names at the ground")
    assert [area.weight for area in mission.areas_of(AreaKind.INTEREST) if area.name == "new"] == [4.0]
    # The same in the command line, which refuses a name that is in use.
    where = ["--mission", mission.mission, "--earth", mission.earth]
    assert main(["area", "rename", "new", "newer", *where]) == 0
    assert main(["area", "add", "newer", "10,10", "20,10", "20,20", "--interest", *where]) == 2
    assert main(["area", "remove", "newer", *where]) == 0
    mission.command("set-keep-out", area_id="closed", polygon_m=[(480, 10), (490, 10), (490, 20)])
    assert main(["command", "keep-out", "closed", "480,10", "495,10", "490,20", *where]) == 2
    assert main(["area", "remove", "closed", *where]) == 0
    assert names() == kept


def test_who_logs_out_on_the_page_reads_on_and_has_no_controls_any_more(
    browser: Any, mission: MissionClient, tmp_path: Path
) -> None:
    who = "return [document.getElementById('authority').title, document.getElementById('log-out').hidden]"
    server = Served(mission, "--authority", "--login-file", str(tmp_path / "logins"))
    with server:
        browser.get(server.login)
        until(lambda: written(browser, "#authority") == "command authority", "the rights of the login")
        assert script(browser, who)[1] is False
        click(browser, "#log-out")
        until(lambda: script(browser, who) == ["local", True], "a page without the login")
        assert written(browser, "#authority") == "read-only"
        assert not script(browser, "return document.body.classList.contains('commanding')")
        until(lambda: shown(browser).get("layer") == "mean", "the map all the same")

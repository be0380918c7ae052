"""What tests do with the operator's page in a browser: press, click, write, draw, read."""

from __future__ import annotations

import json
import shutil
import urllib.parse
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from benchmarks.browser import chromium
from he3.errors import PeerUnreachable
from services.console.client.mission_client import MissionClient
from tests.waiting import PATIENCE_S, until

AXE = Path(__file__).parents[2] / "vendor" / "axe-core" / "axe.min.js"
ENTER, ESCAPE = "\ue007", "\ue00c"


@contextmanager
def chromium_or_skip(*flags: str, logged: dict[str, str]) -> Iterator[Any]:
    """A browser; the test is skipped, and says so, where there is none."""
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        pytest.skip("no browser: apt-get install chromium chromium-driver")
    pytest.importorskip("selenium.webdriver", reason="no selenium: pip install selenium")
    with chromium("--window-size=1440,900", *flags, logged=logged) as driver:
        yield driver


def script(driver: Any, text: str, *arguments: Any) -> Any:
    return driver.execute_script(text, *arguments)


def shown(driver: Any) -> dict[str, Any]:
    return json.loads(script(driver, "return document.getElementById('map').dataset.shown || '{}'"))


def click(driver: Any, css: str) -> None:
    """Click as an operator does."""
    deliberately(driver, lambda: driver.find_element("css selector", css).click())


def deliberately(driver: Any, act: Callable[[], object]) -> None:
    """Do it once the page stands still; once more if a control moved under the pointer in that very moment."""
    dropped = "return document.body.dataset.dropped ?? '0'"
    while True:
        still(driver)
        before = script(driver, dropped)
        act()
        if script(driver, dropped) == before:
            return


def still(driver: Any) -> None:
    """Return when nothing has moved for a while, what the browser has not drawn yet included."""
    drawn = (
        "const done = arguments[0];"
        "requestAnimationFrame(() => requestAnimationFrame(() => done(document.body.dataset.moving === undefined)))"
    )
    until(lambda: driver.execute_async_script(drawn), "the page to stand still")


def decide(driver: Any, key: str) -> None:
    """Press that key once the preview of a command can be sent."""
    until(
        lambda: script(driver, "return document.activeElement.id") == "preview-send",
        lambda: f"Send; the preview says {written(driver, '#preview')!r}, the page {written(driver, '#toast')!r}",
    )
    driver.switch_to.active_element.send_keys(key)


def order(driver: Any, css: str) -> None:
    """Click that command, and send it by Enter."""
    click(driver, css)
    decide(driver, ENTER)


def written(driver: Any, css: str) -> str:
    return str(script(driver, "return document.querySelector(arguments[0]).textContent", css))


def write(driver: Any, css: str, text: str) -> None:
    """Replace what is written in a field, key by key."""
    field = driver.find_element("css selector", css)
    field.click()
    field.send_keys("\ue009" + "a\ue000" + "\ue017" + text)  # Control+A, Delete


def draw_area(driver: Any) -> None:
    """Draw three corners with the keyboard, from the middle of the map."""
    driver.find_element("id", "map").send_keys("d")
    script(
        driver,
        "const map = document.getElementById('map');"
        "const press = (key) => map.dispatchEvent(new KeyboardEvent('keydown', {key, shiftKey: true, bubbles: true}));"
        "for (const key of ['Enter', 'ArrowRight', 'Enter', 'ArrowUp', 'Enter']) press(key)",
    )


def in_address(driver: Any) -> dict[str, str]:
    """What the address says of the view."""
    return dict(urllib.parse.parse_qsl(driver.current_url.partition("#")[2]))


def in_module(driver: Any, module: str, expression: str) -> Any:
    """The value of an expression over the names of a module of the page; it may be a promise."""
    return driver.execute_async_script(
        f"const done = arguments[0]; import('/static/{module}').then(async (it) => done(await ({expression})))"
    )


def press(driver: Any, *keys: str, shift: bool = False) -> None:
    """Press these keys on the map."""
    script(
        driver,
        "const [keys, shiftKey] = arguments;"
        "for (const key of keys) document.getElementById('map').dispatchEvent("
        "new KeyboardEvent('keydown', {key, shiftKey, bubbles: true, cancelable: true}))",
        keys,
        shift,
    )


def pinch(driver: Any, x: float, y: float) -> None:
    """Spread two fingers at a place of the window."""
    for kind, apart in (("touchStart", 20), ("touchMove", 30), ("touchMove", 60), ("touchEnd", 0)):
        points = [{"x": x - apart, "y": y, "id": 1}, {"x": x + apart, "y": y, "id": 2}] if apart else []
        driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


def barriers(driver: Any) -> list[tuple[str, str]]:
    """What axe-core finds on the page that is serious or worse: the rule, and the first element that breaks it."""
    driver.execute_script(AXE.read_text())
    driver.set_script_timeout(PATIENCE_S)
    return [
        (found["id"], found["nodes"][0]["html"][:200])
        for found in driver.execute_async_script(
            "const done = arguments[0]; axe.run({resultTypes: ['violations']}).then((it) => done(it.violations))"
        )
        if found["impact"] in ("serious", "critical")
    ]


def proposed(client: MissionClient) -> Any:
    """The plan that waits; None while the ground does not answer."""
    with suppress(PeerUnreachable):
        return client.proposed_plan()
    return None


def checked(driver: Any) -> bool:
    """Have the stack checked; whether it may be sent."""
    click(driver, "#stack-check")
    until(lambda: written(driver, "#stack-note") or written(driver, "#stack-failure"), "an answer")
    return bool(driver.find_element("id", "stack-send").is_enabled())

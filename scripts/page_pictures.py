"""Take the pictures of the operator's page in docs/images: `.venv/bin/python scripts/page_pictures.py [NAME ...]`.

Runs the mission t1 in lockstep to its 75th sample, sends a few telecommands, and takes the page on a laptop and on a
phone, dark and light, with a command stack and a rehearsal; then t1 with approval by an operator, for the review of a
plan; then a recording of t1-lossy. Everything flies in virtual time, so a busy machine makes no late reports. NAME is
one of live, review and recording; without one, all are taken. Needs a Chromium and its driver (Debian: chromium,
chromium-driver).
"""

from __future__ import annotations

import base64
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from PIL import Image
from selenium import webdriver

from benchmarks.browser import chromium

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
SAMPLES = 75
SPEED = 20
WITHIN_S = 900.0
LAPTOP = {"width": 1440, "height": 900, "deviceScaleFactor": 1, "mobile": False}
PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
LAPTOP_PIXELS, PHONE_PIXELS = 1800, 2200
"""Height of a picture at most [pixels]."""
HE3 = (sys.executable, "-m", "services.console")


def he3(*words: str) -> str:
    """What the command prints; ends the script if it fails."""
    return subprocess.run(
        [*HE3, *words], cwd=ROOT, check=True, stdin=subprocess.DEVNULL, capture_output=True, text=True
    ).stdout


@contextmanager
def running(*words: str) -> Iterator[subprocess.Popen[str]]:
    """A command that stays, until the end of the `with` statement."""
    process = subprocess.Popen([*HE3, *words], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate()


def wait_for(true: Callable[[], Any], what: str) -> Any:
    """The first true value; ends the script if there is none in time."""
    deadline = time.monotonic() + WITHIN_S
    while time.monotonic() < deadline:
        try:
            if found := true():
                return found
        except subprocess.CalledProcessError:  # nothing answers yet
            pass
        time.sleep(0.2)
    raise SystemExit(f"page_pictures: expected {what} within {WITHIN_S:g} s")


def samples() -> int:
    """Samples in the map of the mission that runs."""
    status: dict[str, Any] = json.loads(he3("status", "--json"))
    return 0 if status["ground"] is None else int(status["ground"]["samples"])


def fly() -> None:
    """Bring the mission to its 75th sample, with telecommands shortly before, and slow it down."""
    wait_for(lambda: samples() >= SAMPLES - 3, "samples")
    he3("time", "rate", "500")
    he3("area", "add", "ridge", "60,330", "150,345", "170,270", "80,250", "--interest", "--weight", "3")
    he3("command", "keep-out", "boulders", "400,420", "450,440", "460,390", "410,380", "--wait", "completed")
    he3("command", "pause", "--wait", "completed", "--timeout", "120")
    he3("command", "resume", "--wait", "completed", "--timeout", "120")
    wait_for(lambda: samples() >= SAMPLES, "samples")
    he3("time", "rate", f"{SPEED}")


def take(
    driver: Any, name: str, metrics: dict[str, Any], theme: str, view: str, most_pixels: int, part: str = "body"
) -> None:
    """One picture of a part of the page, cut off below `most_pixels`; view: as the page's address has it."""
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    driver.execute_script(
        "document.documentElement.dataset.theme = arguments[0]; location.hash = arguments[1];"
        "document.getElementById('view-options').open = arguments[1].includes('compare')",
        theme,
        view,
    )
    wait_for(lambda: is_shown(driver, view), f"the map of '{view}'")
    time.sleep(3.0)  # for the tiles to be drawn, and a message or two to cross the link
    box = driver.execute_script(
        "const b = document.querySelector(arguments[0]).getBoundingClientRect();"
        "return {x: b.left + scrollX, y: b.top + scrollY, width: b.width, height: b.height}",
        part,
    )
    clip = {**box, "height": min(box["height"], most_pixels / metrics["deviceScaleFactor"]), "scale": 1}
    taken = driver.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True, "clip": clip})
    path = IMAGES / f"{name}.webp"
    with Image.open(io.BytesIO(base64.b64decode(taken["data"]))) as whole:
        whole.convert("RGB").save(path, quality=82, method=6)
        print(path.relative_to(ROOT), f"{whole.width} x {whole.height}", file=sys.stderr)


def is_shown(driver: Any, view: str) -> bool:
    """Whether the map shows the layers that the view names."""
    wanted = {name: values[0] for name, values in parse_qs(view).items()}
    shown = json.loads(driver.execute_script("return document.getElementById('map').dataset.shown || '{}'"))
    mode = wanted.get("compare", "")
    found = shown.get("layer"), shown.get("mode"), shown.get("other") if mode == "swipe" else None
    return found == (wanted.get("layer", "mean"), mode, wanted.get("with"))


@contextmanager
def page(*mission: str, fly: Callable[[], None]) -> Iterator[webdriver.Chrome]:
    """The page of that mission in a browser, once it is flown."""
    with running("up", *mission, "--quiet"):
        wait_for(lambda: samples() >= 0, "a mission")
        with served("--authority", fly=fly) as driver:
            yield driver


@contextmanager
def served(*flags: str, fly: Callable[[], None] = lambda: None) -> Iterator[webdriver.Chrome]:
    """A page in a browser. flags: of ``he3 web``. fly: what is done before it is opened."""
    with running("web", "--port", "0", *flags) as server:
        assert server.stderr is not None
        address = re.search(r"http://[^\s,]+", server.stderr.readline())
        assert address is not None
        fly()
        with chromium("--hide-scrollbars") as driver:
            driver.get(address[0])
            wait_for(lambda: driver.find_element("id", "map").get_attribute("data-shown"), "the page")
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", LAPTOP)
            yield driver


STACK = """# The boulders are closed before the rover drives on.
pause
after accepted: keep-out boulders-2 420,380 450,390 430,410
at next contact: resume
"""


def fly_under_review() -> None:
    """Approve plans until the map has some samples; the next plan then waits."""
    wait_for(lambda: approved_until(12), "samples")
    wait_for(lambda: "proposal" in he3("plan", "show"), "a plan that waits")
    he3("time", "rate", f"{SPEED}")


def approved_until(count: int) -> bool:
    """Approve the plan that waits, if one does; returns whether the map has that many samples."""
    if "proposal" in he3("plan", "show"):
        he3("plan", "approve")
    return samples() >= count


EDIT = """
const done = arguments[0];
import('/static/layers.js').then(async ({map}) => {
  const [x, y] = [map.proposal.samples[1].x_m, map.proposal.samples[1].y_m];
  map.onStop(1, [x - 3, y + 3]);
  document.getElementById('plan-add').click();
  map.choose([x - 20, y - 12]);
  document.getElementById('plan-add').click();
  done();
});
"""


PLAY_FROM = """
return fetch('/api/recording', {method: 'POST', headers: {'content-type': 'application/json', 'x-he3-console': '1'},
  body: JSON.stringify({at_s: arguments[0], pace: 0})}).then((it) => it.ok);
"""


def main() -> None:
    """Fly, serve, take the pictures."""
    names = sys.argv[1:] or list(TAKEN)
    if not set(names) <= TAKEN.keys():
        raise SystemExit(f"page_pictures: expected some of {', '.join(TAKEN)}; got {' '.join(names)}")
    with tempfile.TemporaryDirectory() as runs:
        os.environ["XDG_RUNTIME_DIR"] = runs  # another mission of this machine is not meant
        for name in names:
            TAKEN[name]()


def take_live() -> None:
    """A mission under way."""
    with page("t1", "--lockstep", fly=fly) as driver:
        views(driver)


def take_review() -> None:
    """A plan that waits for approval, and a command stack."""
    reviewed = "t1", "--lockstep", "--rate", "300", "--set", "ground.approval=operator"
    with page(*reviewed, fly=fly_under_review) as driver:
        wait_for(lambda: driver.find_element("id", "plan-samples").text, "the plan on the page")
        driver.execute_async_script(EDIT)
        take(driver, "web-plan-review", LAPTOP, "dark", "", 1000)
        check_stack(driver)
        driver.execute_script("document.getElementById('stack-lines').style.maxHeight = 'none'")
        take(driver, "web-stack", LAPTOP, "light", "", LAPTOP_PIXELS, "section:has(#stack-text)")


def take_recording() -> None:
    """A recorded mission."""
    with tempfile.TemporaryDirectory() as folder:
        he3("run", "t1-lossy", "--in-process", "--quiet", "--out", f"{folder}/flown")
        with served("--recording", f"{folder}/flown/mission.mcap") as driver:
            driver.execute_script(PLAY_FROM, 20.0 * 3600.0)
            take(driver, "web-recording", LAPTOP, "light", "", 900)


TAKEN = {"live": take_live, "review": take_review, "recording": take_recording}


def check_stack(driver: webdriver.Chrome) -> None:
    """Write a command stack and have it checked."""
    driver.execute_script(
        "const t = document.getElementById('stack-text'); t.value = arguments[0];"
        "t.dispatchEvent(new Event('input')); document.getElementById('stack-check').click()",
        STACK,
    )


def rehearse(driver: webdriver.Chrome) -> None:
    """Rehearse the rest of the mission on the page, against another planner."""
    driver.execute_script(
        "document.getElementById('rehearsal-draws').value = 10;"
        "document.getElementById('rehearsal-against').value = 'planner rrtstar';"
        "document.getElementById('rehearsal-form').requestSubmit()"
    )
    wait_for(lambda: "Difference" in driver.find_element("id", "rehearsal-table").text, "the rehearsal")


def views(driver: webdriver.Chrome) -> None:
    """The page's views of a mission under way."""
    check_stack(driver)
    take(driver, "web-laptop-dark", LAPTOP, "dark", "sample=r08s2", LAPTOP_PIXELS)
    take(driver, "web-laptop-light", LAPTOP, "light", "layer=std&at=330,120", LAPTOP_PIXELS)
    with Image.open(IMAGES / "web-laptop-light.webp") as whole:  # for the first page of the documentation
        top = whole.crop((0, 0, whole.width, 1110)).resize((1080, 832), Image.Resampling.LANCZOS)
        top.save(IMAGES / "web-page.webp", quality=82, method=6)
    swipe, measured = (
        "compare=swipe&with=error&relief=1",
        "zoom=2.6&centre=130,240&measure=60,190,90,300,190,320",
    )
    take(driver, "web-map-swipe", LAPTOP, "dark", swipe, LAPTOP_PIXELS, ".map-card")
    take(driver, "web-map-zoom", LAPTOP, "light", f"{measured}&relief=1", LAPTOP_PIXELS, ".map-card")
    rehearse(driver)
    take(driver, "web-rehearsal", LAPTOP, "light", "", LAPTOP_PIXELS, "#rehearsal-card")
    driver.execute_script("document.getElementById('rehearsal-on-map').click()")
    take(driver, "web-phone-dark", PHONE, "dark", "zoom=2&centre=150,250&sample=r08s2", PHONE_PIXELS)
    take(driver, "web-phone-light", PHONE, "light", "layer=exceedance&threshold=8.5", PHONE_PIXELS)


if __name__ == "__main__":
    main()

"""The operator's page in a real browser, over a mission in separate processes."""

from __future__ import annotations

import base64
import io
import json
import os
import re
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from csv import DictReader
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.browser import chromium
from he3.errors import PeerUnreachable
from schemas.telemetry import RoverMode
from services.console.__main__ import main
from services.console.client.areas import AreaKind
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import Endpoints, free_endpoints
from services.console.launch.launcher import Launcher
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import subject as subject_of
from tests.processes import he3, run, start
from tests.waiting import PATIENCE_S, expect_within, until

IPV6 = Path("/proc/net/if_inet6").exists() and Path("/proc/net/if_inet6").read_text() != ""
FACTS = Path(__file__).parent / "timeline_facts.js"
AXE = Path(__file__).parents[1] / "vendor" / "axe-core" / "axe.min.js"
ENTER, ESCAPE = "\ue007", "\ue00c"
RATE = 60.0
LIGHT_TIME_S = 1.282


@pytest.fixture(scope="module")
def endpoints() -> Endpoints:
    return free_endpoints()


@pytest.fixture(scope="module")
def launcher(endpoints: Endpoints, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launcher]:
    logs = tmp_path_factory.mktemp("logs")
    # Rounds of ten seconds, and so many that the mission outlasts the tests on a machine of any speed.
    quick = ("rover.drill_s_per_m=600.0", "rover.analysis_s=30.0", "rover.speed_m_s=2.0", "rounds=400")
    flags = [word for setting in quick for word in ("--set", setting)]
    scenario = Path(__file__).parents[2] / "deploy" / "scenarios" / "t1-paper.toml"
    with Launcher(scenario, endpoints, ("--rate", str(RATE), *flags), logs=logs) as launcher:
        yield launcher


@pytest.fixture(scope="module")
def mission(launcher: Launcher, endpoints: Endpoints) -> Iterator[MissionClient]:
    with MissionClient.when_up(endpoints.earth, "t1-paper", launcher.check) as client:
        yield client


@pytest.fixture(scope="module")
def served(mission: MissionClient, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    """The address of a page where commands take a login, and the one with a login that may command."""
    server = Served(mission, "--authority", "--login-file", str(tmp_path_factory.mktemp("logins") / "logins"))
    with server as where:
        yield where, server.login


@pytest.fixture(scope="module")
def address(served: tuple[str, str]) -> str:
    return served[0]


class Served:
    """The page's server as a process; gives its address."""

    def __init__(self, mission: MissionClient, *flags: str) -> None:
        self._login_file = Path(flags[flags.index("--login-file") + 1]) if "--login-file" in flags else None
        self._command = [
            sys.executable, "-m", "services.console", "web", "--port", "0", *flags,
            "--mission", mission.mission, "--earth", mission.earth,
        ]  # fmt: skip

    def __enter__(self) -> str:
        self.process = start(self._command, stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        line = self.process.stderr.readline()
        if "INSECURE" in line:
            line = self.process.stderr.readline()
        if self._login_file is not None:
            line = self._login_file.read_text()
        found = re.search(r"(https?://[^/]+/)(login[^\s,]+)?", line)
        assert found is not None, line
        self.login = found[0]
        if found[2] is not None and found[1].startswith("http:"):
            get(self.login)
        if found[1].startswith("http:"):
            until(lambda: get(f"{found[1]}api/map/point?x=1&y=1")[0] == 200, "an answer from the ground")
        return found[1]

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        if self.process.stderr is not None:
            self.process.stderr.close()


def get(url: str, headers: dict[str, str] | None = None, document: object = None) -> tuple[int, bytes]:
    body = None if document is None else json.dumps(document).encode()
    request = urllib.request.Request(url, data=body, headers=headers or {})
    try:
        with BROWSER.open(request, timeout=PATIENCE_S) as response:
            return response.status, response.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()
    except urllib.error.URLError:
        return 0, b""


BROWSER = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
"""Keeps the session of each server that was logged in to."""
OUR_PAGE = {"content-type": "application/json", "x-he3-console": "1"}


def test_only_requests_of_this_page_under_its_own_name_are_served(address: str) -> None:
    own = address.rstrip("/")
    ours = {**OUR_PAGE, "origin": own}
    assert get(f"{own}/api/map/history", {"host": "evil.example"})[0] == 403
    assert get(f"{own}/api/map/history", {"sec-fetch-site": "cross-site"})[0] == 403
    acknowledged = {"kind": "defect", "action": "acknowledge"}
    assert get(f"{own}/api/alarm", ours, acknowledged) == (200, b'{"done":false}')
    assert get(f"{own}/api/alarm", {**ours, "origin": "http://evil.example"}, acknowledged)[0] == 403
    assert get(f"{own}/api/alarm", OUR_PAGE, acknowledged)[0] == 403
    assert get(f"{own}/api/alarm", {**ours, "content-type": "text/plain"}, acknowledged)[0] == 403


def test_without_authority_nothing_is_commanded_and_the_reason_is_said(mission: MissionClient) -> None:
    with Served(mission) as where:
        own = where.rstrip("/")
        before = len(mission.commands())
        commanding = (
            ("command", {"kind": "pause"}),
            ("stack", {"text": "pause"}),
            ("link", {"loss": 0.5}),
            ("interest", {}),
        )
        for path, document in commanding:
            code, body = get(f"{own}/api/{path}", {**OUR_PAGE, "origin": own}, document)
            assert (code, b"--authority" in body) == (403, True)
        assert len(mission.commands()) == before


def test_the_server_ends_at_once_and_quietly_while_a_browser_is_connected(mission: MissionClient) -> None:
    server = Served(mission)
    with server as where, urllib.request.urlopen(f"{where}api/stream", timeout=PATIENCE_S) as stream:
        assert stream.readline() == b"retry: 1000\n"
        told_at = time.monotonic()
        server.process.terminate()
        assert stream.read().endswith(b"\n\n")
        assert server.process.wait() != 0
        expect_within(3.0, time.monotonic() - told_at, "the end of the server")
        assert server.process.stderr is not None
        assert server.process.stderr.read() == "he3: terminated\n"


def test_bad_queries_are_answered_with_one_line_that_says_why(address: str) -> None:
    own = address.rstrip("/")
    for query, why in (
        ("map/point?x=900&y=1", "expected a place within"),
        ("map/layer?layer=gold", "input should be"),
        ("map/point?x=1;y=2&y=3", "without ';'"),
        ("map/point?x;y=1&y=2", "expected parameters such as x"),
        ("map/point", "x"),
        ("map/point?x=nan&y=1", "x"),
        ("map/point?x=%00&y=%ff", "x"),
        ("map/layer?layer=mean&as_of=yesterday", "as_of"),
        ("map/layer?layer=mean&step=0", "step"),
        ("map/layer?layer=mean&format=exe", "format"),
        ("map/resource?polygon=1,1,2,2", "3 to 256 corners"),
        ("map/track?colour=red", "colour"),
    ):
        code, body = get(f"{own}/api/{query}")
        assert code == 400
        assert why in json.loads(body)["error"]


def test_bad_requests_are_answered_with_one_line_and_change_nothing(address: str, mission: MissionClient) -> None:
    own = address.rstrip("/")
    ours = {**OUR_PAGE, "origin": own}
    before = mission.link().conditions, len(mission.commands()), mission.set_interest()
    for path, document, why in (
        ("command", {"kind": "pause", "expires_in_s": "soon"}, "expires_in_s"),
        ("command", {"kind": "go_to", "target_m": "there"}, "target_m"),
        ("command", {"kind": "pause", "expires_in_s": float("nan")}, "expected a JSON object"),
        ("command", ["pause"], "expected a JSON object"),
        ("link", {"loss": "much"}, "loss"),
        ("link", {"direction": 7}, "direction"),
        ("link", {"conditions": {}}, "expected some of"),
        ("interest", {"weight": None}, "weight"),
        ("interest", {"area_id": "a", "polygon_m": 3}, "polygon_m"),
        ("alarm", {"kind": {"a": 1}, "action": "acknowledge"}, "kind"),
        ("alarm", {"kind": "stale", "action": "shelve"}, "shelve_s"),
        ("rehearsal", {"draws": 1}, "draws"),
        ("rehearsal", {"draws": 2, "against": "pause"}, "expected a command after which the mission goes on"),
    ):
        code, body = get(f"{own}/api/{path}", ours, document)
        assert (code, why in json.loads(body)["error"]) == (400, True), (path, document, body)
    for path, code in (("nothing", 404), ("stream/x", 404)):
        assert get(f"{own}/api/{path}")[0] == code
    assert get(f"{own}/api/map/point", ours, {})[0] == 405
    assert (mission.link().conditions, len(mission.commands()), mission.set_interest()) == before


def test_the_page_is_reached_by_every_name_that_was_allowed_however_it_is_spelled(mission: MissionClient) -> None:
    with Served(mission, "--allow-host", "MoonBase.lan.:8030") as where:
        for host, code in (("moonbase.lan:8030", 200), ("MOONBASE.LAN.", 200), ("127.0.0.1", 200), ("moon.lan", 403)):
            assert get(where, {"host": host})[0] == code


@pytest.mark.skipif(not IPV6, reason="this machine has no IPv6")
@pytest.mark.parametrize("bind", ["::1", "::"])
def test_the_page_is_served_over_ipv6(mission: MissionClient, bind: str) -> None:
    with Served(mission, "--bind", bind, "--insecure") as where:
        assert where.startswith("http://[::1]:")
        assert get(f"{where}api/map/history", {"host": "[0::1]:1"})[0] == 200
        warning = json.loads(get(f"{where}api/session")[1])["warning"]
        assert (warning or "").startswith("INSECURE") == (bind == "::")


# --- who may do what ------------------------------------------------------------------------------------------------


def test_the_page_of_a_mission_without_keys_commands_on_loopback_when_it_is_asked_to(mission: MissionClient) -> None:
    stranger = urllib.request.build_opener()
    for flags, status in (((), 403), (("--authority",), 400)):
        with Served(mission, *flags) as where:
            assert post(stranger, where.rstrip("/"), "command", {"kind": "pause", "expires_in_s": "soon"}) == status


def test_with_a_file_of_logins_reading_needs_none_on_this_machine_and_commanding_does(
    address: str, mission: MissionClient
) -> None:
    own, before = address.rstrip("/"), len(mission.commands())
    stranger = urllib.request.build_opener()
    assert opened(stranger, f"{own}/api/map/history")[0] == 200
    assert json.loads(opened(stranger, f"{own}/api/session")[1])["roles"] == ["viewer"]
    for path, document in (("command", {"kind": "pause"}), ("link", {"loss": 0.5}), ("alarm", {})):
        assert post(stranger, own, path, document) == 403
    for login in ("", "?token=", "?token=wrong"):
        assert get(f"{own}/login{login}")[0] == 403
    assert len(mission.commands()) == before
    assert json.loads(get(f"{own}/api/session")[1])["roles"] == ["controller", "operator", "viewer"]


def post(opener: urllib.request.OpenerDirector, own: str, path: str, document: object) -> int:
    request = urllib.request.Request(
        f"{own}/api/{path}", data=json.dumps(document).encode(), headers={**OUR_PAGE, "origin": own}
    )
    return opened(opener, request)[0]


def opened(opener: urllib.request.OpenerDirector, what: str | urllib.request.Request) -> tuple[int, bytes]:
    """Status and body of the answer; of a stream, what has come so far."""
    try:
        with opener.open(what, timeout=PATIENCE_S) as response:
            return response.status, response.read(100_000)
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


def test_a_session_cookie_is_for_this_page_alone(served: tuple[str, str]) -> None:
    class Stay(urllib.request.HTTPRedirectHandler):
        def redirect_request(self, *_: Any) -> None:
            return None

    with pytest.raises(urllib.error.HTTPError) as redirect:
        urllib.request.build_opener(Stay()).open(served[1], timeout=PATIENCE_S)
    with redirect.value:
        cookie = redirect.value.headers["set-cookie"]
        assert redirect.value.headers["location"] == "/"
    assert all(word in cookie for word in ("HttpOnly", "SameSite=Strict", "Path=/"))
    assert "token" not in cookie


def test_off_loopback_the_page_is_not_served_without_tls(mission: MissionClient) -> None:
    command = he3("web", "--port", "0", "--bind", "0.0.0.0", "--mission", mission.mission, "--earth", mission.earth)
    done = run(command)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("he3: --bind 0.0.0.0: expected TLS off loopback: --identity")
    assert len(done.stderr.splitlines()) == 1


PEOPLE = {
    "viewer": {"command": 403, "interest": 403, "link": 403, "alarm": 403},
    "operator": {"command": 200, "interest": 200, "link": 403, "alarm": 200},
    "controller": {"command": 403, "interest": 403, "link": 200, "alarm": 200},
}
DOCUMENTS: dict[str, dict[str, Any]] = {
    "command": {"kind": "resume"}, "interest": {}, "link": {"loss": 0.0},
    "alarm": {"kind": "defect", "action": "acknowledge"},
}  # fmt: skip


def test_under_tls_a_certificate_says_what_its_owner_may_do_and_a_stranger_may_do_nothing(
    mission: MissionClient, tmp_path: Path
) -> None:
    authority = Authority.create(tmp_path / "keys")
    folders = {role: authority.issue(subject_of(role, "anna")) for role in PEOPLE}
    revoked = authority.issue(subject_of("operator", "rita"))
    other = Authority.create(tmp_path / "others").issue(subject_of("operator", "mallory"))
    identity = folders["viewer"]

    def opener(folder: Path | None) -> urllib.request.OpenerDirector:
        trusting = ssl.create_default_context(cafile=identity / "page-authority.pem")
        if folder is not None:
            trusting.load_cert_chain(folder / "page-certificate.pem", folder / "page-key.pem")
        cookies = urllib.request.HTTPCookieProcessor()
        return urllib.request.build_opener(urllib.request.HTTPSHandler(context=trusting), cookies)

    def status(folder: Path | None, path: str, document: object = None) -> int:
        if document is not None:
            return post(opener(folder), own, path, document)
        return opened(opener(folder), f"{own}/{path}")[0]

    server = Served(mission, "--bind", "0.0.0.0", "--page-identity", str(identity), "--authority")
    with server as where:
        own = where.rstrip("/")
        assert own.startswith("https://127.0.0.1:")
        until(lambda: status(folders["viewer"], "api/map/history") == 200, "an answer from the ground")
        for role, expected in PEOPLE.items():
            assert {path: status(folders[role], path, DOCUMENTS[path]) for path in expected} == expected
            session = json.loads(opened(opener(folders[role]), f"{own}/api/session")[1])
            assert (session["name"], session["roles"]) == (f"{role}.anna", [role])
        for path in ("", "api/session", "api/stream", "api/map/history"):
            assert status(None, path) == 401
        assert status(None, "command", {"kind": "pause"}) == 401
        assert status(revoked, "api/session") == 200
        authority.revoke(subject_of("operator", "rita"))
        until(lambda: status(revoked, "api/session") == 403, "the revocation to count")
        with pytest.raises((urllib.error.URLError, ssl.SSLError, ConnectionError)):
            opener(other).open(f"{own}/api/session", timeout=PATIENCE_S)
        with opener(None).open(server.login, timeout=PATIENCE_S) as logged_in:
            assert logged_in.status == 200
            assert logged_in.headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'")


@pytest.mark.parametrize("said", [b"", b"GET /api/colours HTTP/1.1\r\nhost: 127.0.0.1\r\nx-slow: "])
def test_a_thousand_connections_that_ask_nothing_keep_no_browser_waiting(address: str, said: bytes) -> None:
    host, port = address.removeprefix("http://").rstrip("/").split(":")
    with ExitStack() as idle:
        for _ in range(1024):
            connection = idle.enter_context(socket.create_connection((host, int(port)), timeout=PATIENCE_S))
            with suppress(OSError):  # closed already, in favour of later ones
                connection.sendall(said)
        for _ in range(3):
            began = time.monotonic()
            assert get(f"{address}api/colours")[0] == 200
            expect_within(3.0, time.monotonic() - began, "an answer")


@contextmanager
def chromium_or_skip(*flags: str, logged: dict[str, str]) -> Iterator[Any]:
    """A browser; the test is skipped, and says so, where there is none."""
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        pytest.skip("no browser: apt-get install chromium chromium-driver")
    pytest.importorskip("selenium.webdriver", reason="no selenium: pip install selenium")
    with chromium("--window-size=1440,900", *flags, logged=logged) as driver:
        yield driver


@pytest.fixture(scope="module")
def logged_in(served: tuple[str, str]) -> Iterator[Any]:
    """A browser that has logged in; it takes longer to start than most tests."""
    with chromium_or_skip(logged={"browser": "ALL", "performance": "ALL"}) as driver:
        driver.get(served[1])
        yield driver


@pytest.fixture
def browser(logged_in: Any, address: str, mission: MissionClient) -> Any:
    """The page with its map as a new browser shows it, of a mission that no earlier test holds up."""
    rover = mission.status().rover
    if rover is not None and rover.mode in (RoverMode.PAUSED, RoverMode.SAFE):
        mission.command("resume").wait("completed", PATIENCE_S)
    logged_in.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    logged_in.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    # A test that failed may leave a plan that was edited; the browser would ask whether to leave it.
    script(logged_in, "addEventListener('beforeunload', (event) => event.stopImmediatePropagation(), true)")
    logged_in.get(f"{address}static/icon.svg")
    script(logged_in, "localStorage.clear(); sessionStorage.clear()")
    for log in ("browser", "performance"):
        logged_in.get_log(log)
    logged_in.get(address)
    until(lambda: shown(logged_in).get("layer") == "mean", "the map")
    return logged_in


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


def test_the_icon_is_found_by_the_name_that_browsers_ask_for(address: str) -> None:
    status, icon = get(f"{address}favicon.ico")
    assert (status, icon) == (200, get(f"{address}static/icon.svg")[1])
    assert b"<svg" in icon


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
    click(browser, "[data-command=return_to_start]")
    assert script(browser, "return document.getElementById('preview-send').disabled")
    browser.switch_to.active_element.send_keys(ENTER)  # too early: it was not read yet
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


@pytest.mark.exhaustive
def test_a_plan_waits_on_the_page_until_it_is_approved_with_other_samples(browser: Any, tmp_path: Path) -> None:
    endpoints = free_endpoints()
    scenario = Path(__file__).parents[2] / "deploy" / "scenarios" / "short.toml"
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
    scenario = Path(__file__).parents[2] / "deploy" / "scenarios" / "short.toml"
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
    scenario = Path(__file__).parents[2] / "deploy" / "scenarios" / "short.toml"
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

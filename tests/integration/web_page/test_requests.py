"""The page's server: which requests it answers, to whom, and what it says of the others."""

from __future__ import annotations

import json
import socket
import ssl
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest

from services.console.client.mission_client import MissionClient
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import subject as subject_of
from tests.integration.web_page.server import OUR_PAGE, Served, get, opened, post
from tests.processes import he3, run
from tests.waiting import PATIENCE_S, expect_within, until

IPV6 = Path("/proc/net/if_inet6").exists() and Path("/proc/net/if_inet6").read_text() != ""
PEOPLE = {
    "viewer": {"command": 403, "interest": 403, "link": 403, "alarm": 403},
    "operator": {"command": 200, "interest": 200, "link": 403, "alarm": 200},
    "controller": {"command": 403, "interest": 403, "link": 200, "alarm": 200},
}
DOCUMENTS: dict[str, dict[str, Any]] = {
    "command": {"kind": "resume"}, "interest": {}, "link": {"loss": 0.0},
    "alarm": {"kind": "defect", "action": "acknowledge"},
}  # fmt: skip


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


def test_who_logs_out_reads_on_and_commands_no_more_and_other_browsers_stay(
    mission: MissionClient, tmp_path: Path
) -> None:
    def browser() -> urllib.request.OpenerDirector:
        made = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        assert opened(made, server.login)[0] == 200
        return made

    def session(of: urllib.request.OpenerDirector) -> tuple[bool, bool]:
        document = json.loads(opened(of, f"{own}/api/session")[1])
        return document["logged_in"], document["commands"]

    server = Served(mission, "--authority", "--login-file", str(tmp_path / "logins"))
    with server as where:
        own = where.rstrip("/")
        mine, other = browser(), browser()
        assert session(mine) == (True, True)
        assert opened(mine, urllib.request.Request(f"{own}/api/logout", method="POST"))[0] == 403, "of no page of ours"
        assert session(mine) == (True, True)
        assert post(mine, own, "logout", {}) == 200
        assert session(mine) == (False, False)
        assert post(mine, own, "command", {"kind": "pause"}) == 403
        assert session(other) == (True, True)
        assert post(mine, own, "logout", {}) == 200, "a second time, too"


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
        with opener(revoked).open(f"{own}/api/stream", timeout=PATIENCE_S) as stream:
            assert stream.readline() == b"retry: 1000\n"
            authority.revoke(subject_of("operator", "rita"))
            until(lambda: status(revoked, "api/session") == 403, "the revocation to count")
            assert stream.read().endswith(b"\n\n"), "the stream has ended, too"
        with pytest.raises((urllib.error.URLError, ssl.SSLError, ConnectionError)):
            opener(other).open(f"{own}/api/session", timeout=PATIENCE_S)
        with opener(None).open(server.login, timeout=PATIENCE_S) as logged_in:
            assert logged_in.status == 200
            assert logged_in.headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'")
        browser = opener(None)
        assert opened(browser, server.login)[0] == 200
        with browser.open(f"{own}/api/stream", timeout=PATIENCE_S) as stream:
            assert stream.readline() == b"retry: 1000\n"
            assert post(browser, own, "logout", {}) == 200
            assert stream.read().endswith(b"\n\n"), "who has logged out reads no further"
        assert opened(browser, f"{own}/api/session")[0] == 401


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


def test_the_icon_is_found_by_the_name_that_browsers_ask_for(address: str) -> None:
    status, icon = get(f"{address}favicon.ico")
    assert (status, icon) == (200, get(f"{address}static/icon.svg")[1])
    assert b"<svg" in icon

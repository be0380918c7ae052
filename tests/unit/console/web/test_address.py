"""The page's addresses: every printed address opens in a browser, every name has one spelling."""

from __future__ import annotations

import socket
import urllib.request
from contextlib import closing
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import pytest

from he3.errors import He3Error, InvalidInput
from services.console.web.address import host_name, listening, normal_host, own_names, urls_of

IPV6 = Path("/proc/net/if_inet6").exists() and Path("/proc/net/if_inet6").read_text() != ""
needs_ipv6 = pytest.mark.skipif(not IPV6, reason="this machine has no IPv6")


@pytest.mark.parametrize(
    ("header", "name"),
    [
        ("127.0.0.1", "127.0.0.1"),
        ("127.0.0.1:8030", "127.0.0.1"),
        ("LocalHost:80", "localhost"),
        ("moonbase.lan.:8030", "moonbase.lan"),
        ("[::1]:8030", "::1"),
        ("[0:0:0:0:0:0:0:1]", "::1"),
        ("[FD00::0001]", "fd00::1"),
        ("[::ffff:127.0.0.1]:80", "127.0.0.1"),
        ("[127.0.0.1]", None),
        ("::1", None),
        ("[::1", None),
        ("[fe80::1%25eth0]:80", None),
        ("a b", None),
        ("evil.example/", None),
        ("host:99999", None),
        ("host:80:80", None),
        ("", None),
        ("-x.lan", None),
        ("x..lan", None),
    ],
)
def test_a_host_header_has_one_spelling(header: str, name: str | None) -> None:
    assert normal_host(header) == name


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("moonbase.lan:8030", "moonbase.lan"),
        ("MOONBASE.lan.", "moonbase.lan"),
        ("fd00::1", "fd00::1"),
        ("[fd00::1]:80", "fd00::1"),
    ],
)
def test_a_name_to_be_allowed_is_taken_as_it_stands_in_the_browser(text: str, name: str) -> None:
    assert host_name(text) == name


@pytest.mark.parametrize("text", ["http://moonbase.lan/", "a/b", "", "*", "a,b", "moonbase.lan:port"])
def test_a_name_that_no_browser_can_send_is_refused(text: str) -> None:
    with pytest.raises(InvalidInput, match="expected a host name or address"):
        host_name(text)


class Answer(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(self.headers["Host"].encode())

    def log_message(self, *_: object) -> None:
        return


@pytest.mark.parametrize(
    ("bind", "shown"),
    [
        ("127.0.0.1", "127.0.0.1"),
        ("127.0.0.2", "127.0.0.2"),
        ("localhost", "localhost"),
        ("0.0.0.0", "127.0.0.1"),
        ("127.1", "127.0.0.1"),
        pytest.param("::1", "[::1]", marks=needs_ipv6),
        pytest.param("[::1]", "[::1]", marks=needs_ipv6),
        pytest.param("::", "[::1]", marks=needs_ipv6),
        pytest.param("::ffff:127.0.0.1", "127.0.0.1", marks=needs_ipv6),
    ],
)
def test_the_address_that_is_printed_opens_and_is_a_name_of_the_server(bind: str, shown: str) -> None:
    with closing(listening(bind, 0)) as listener:
        url = urls_of(listener, bind)[0]
        assert url == f"http://{shown}:{listener.getsockname()[1]}/"
        server = HTTPServer(("", 0), Answer, bind_and_activate=False)
        server.socket.close()
        server.socket = listener
        answering = Thread(target=server.handle_request)
        answering.start()
        with urllib.request.urlopen(url) as answer:
            assert normal_host(answer.read().decode()) in own_names(listener, bind)
        answering.join()


@needs_ipv6
def test_every_ipv6_address_means_every_ipv4_address_too() -> None:
    with closing(listening("::", 0)) as listener, socket.create_connection(("127.0.0.1", listener.getsockname()[1])):
        assert own_names(listener, "::") == {"127.0.0.1", "localhost", "::1"}


@pytest.mark.parametrize("bind", ["", "8.8.8.8", "nowhere.invalid", "fe80::1%lo", "a b", "[::1", "256.1.1.1"])
def test_an_address_that_is_not_of_this_machine_is_bad_input_that_names_the_flag(bind: str) -> None:
    with pytest.raises(InvalidInput, match=r"^--bind: expected an address of this machine") as refusal:
        listening(bind, 0)
    assert "\n" not in str(refusal.value)


def test_a_port_that_is_taken_is_a_failure_that_names_it() -> None:
    with closing(listening("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(He3Error, match=f"cannot listen at 127.0.0.1 port {port}: Address already in use"):
            listening("127.0.0.1", port)


def test_small_answers_are_sent_at_once() -> None:
    with closing(listening("127.0.0.1", 0)) as listener:
        assert listener.proto == socket.IPPROTO_TCP


@pytest.mark.parametrize("bind", ["0.0.0.0", pytest.param("::", marks=needs_ipv6)])
def test_a_server_on_every_address_prints_those_at_which_other_machines_reach_it(bind: str) -> None:
    with closing(listening(bind, 0)) as listener:
        _, *others = urls_of(listener, bind, "https")
        port = listener.getsockname()[1]
        assert all(url.startswith("https://") and url.endswith(f":{port}/") for url in others)
        for url in others:
            host = url.removeprefix("https://").rpartition(":")[0].strip("[]")
            socket.create_connection((host, port), timeout=10).close()
        assert not any(host in url for url in others for host in ("127.0.0.1", "[::1]", "0.0.0.0", "[::]"))

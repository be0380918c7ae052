"""A live mission for Foxglove: where it may be served, and what is said where it cannot be."""

from __future__ import annotations

import socket
import sys

import pytest

from he3.errors import He3Error, InvalidInput
from schemas.roles import Role
from services.console.foxglove_stream import STREAMED, UNPROTECTED, _Server, check_loopback


@pytest.mark.parametrize("bind", ["127.0.0.1", "127.8.0.1", "::1", "localhost"])
def test_it_is_served_on_loopback_without_more(bind: str) -> None:
    assert check_loopback(bind, insecure=False) is None


@pytest.mark.parametrize("bind", ["0.0.0.0", "10.0.0.2", "::"])
def test_off_loopback_it_takes_consent_and_gives_a_warning(bind: str) -> None:
    with pytest.raises(InvalidInput, match=f"--bind {bind}: expected an address on loopback"):
        check_loopback(bind, insecure=False)
    assert check_loopback(bind, insecure=True) == UNPROTECTED


def test_a_name_that_is_no_address_is_refused() -> None:
    with pytest.raises(InvalidInput, match="expected an IP address or localhost, got 'moonbase'"):
        check_loopback("moonbase", insecure=True)


def test_every_topic_that_is_streamed_may_be_read_by_a_viewer() -> None:
    assert all(Role.VIEWER in topic.access.subscribe for topic in STREAMED)


def test_without_foxgloves_package_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(He3Error, match=r"he3 foxglove needs foxglove: pip install 'he3-seeker\[viewers\]'"):
        _Server("m", "127.0.0.1", 0)


def test_a_port_that_is_taken_is_said_in_one_line() -> None:
    pytest.importorskip("foxglove")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(He3Error, match=f"cannot listen at 127.0.0.1 port {port}: .*expected a free port"):
            _Server("m", "127.0.0.1", port)

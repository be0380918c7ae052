"""What a process tells the service manager that started it."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.runtime.service_manager import ServiceManager


@pytest.fixture(params=["file", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    """The socket of a service manager, and its name as in the environment of a service."""
    name = str(tmp_path / "notify") if request.param == "file" else f"@he3-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(name if request.param == "file" else f"\0{name[1:]}")
        listening.setblocking(False)
        yield listening, name


def heard(listening: socket.socket) -> list[bytes]:
    said = []
    while True:
        try:
            said.append(listening.recv(100))
        except BlockingIOError:
            return said


def test_a_service_says_that_it_is_ready_that_it_lives_and_that_it_ends(manager: tuple[socket.socket, str]) -> None:
    listening, name = manager
    service = ServiceManager({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1"})
    service.ready()
    service.alive()
    service.stopping()
    assert heard(listening) == [b"READY=1", b"WATCHDOG=1", b"STOPPING=1"]


def test_it_says_so_three_times_in_each_interval_and_no_more(manager: tuple[socket.socket, str]) -> None:
    listening, name = manager
    service = ServiceManager({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "3600000000"})
    for _ in range(100):
        service.alive()
    assert heard(listening) == [b"WATCHDOG=1"]


@pytest.mark.parametrize(
    "environment",
    [{}, {"WATCHDOG_USEC": "1"}, {"NOTIFY_SOCKET": "/nowhere/notify", "WATCHDOG_USEC": "1"}, {"NOTIFY_SOCKET": "@"}],
)
def test_without_a_manager_that_listens_the_service_goes_on(environment: dict[str, str]) -> None:
    service = ServiceManager(environment)
    service.ready()
    service.alive()
    service.stopping()


@pytest.mark.parametrize("more", [{"WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "soon"}, {"WATCHDOG_USEC": "-5"}])
def test_a_watchdog_that_is_for_another_process_or_is_none_hears_nothing(
    manager: tuple[socket.socket, str], more: dict[str, str]
) -> None:
    listening, name = manager
    ServiceManager({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1000", **more}).alive()
    assert heard(listening) == []

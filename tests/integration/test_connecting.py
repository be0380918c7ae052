"""Connecting to a router that is slow, silent or gone: waited for and reported, or refused with the reason."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from he3.errors import He3Error, PeerUnreachable
from schemas.commands import NoParameters
from schemas.topics import LIST_COMMANDS, Side
from services.console.launch.endpoints import free_endpoints
from services.runtime.transport.client import Client
from services.runtime.transport.opening import SILENT_AFTER_S, SilenceReport, connect_client, open_router
from services.runtime.transport.session import Session
from tests.processes import he3, run, start
from tests.waiting import expect_within, until

MISSION = "connecting"

HANGING_SERVER = """
import sys, time
from services.runtime.entry import prepare_process
prepare_process()
from schemas.topics import LIST_COMMANDS, Side
from services.runtime.transport.opening import open_client
from services.runtime.transport.session import Session
session = Session(open_client(Side.EARTH, sys.argv[1]), "connecting")
held = []
session.serve(LIST_COMMANDS, lambda query: (held.append(query), print("queried", flush=True)))
print("ready", flush=True)
time.sleep(600)
"""
"""A process that takes a query and never answers it."""


@pytest.fixture
def silent() -> Iterator[str]:
    """An endpoint where a program accepts connections and sends nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp/127.0.0.1:{server.getsockname()[1]}"


@pytest.fixture
def router() -> Iterator[str]:
    """An endpoint where an Earth router listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    session = Session(open_router(Side.EARTH, endpoint), MISSION)
    yield endpoint
    session.close()


def test_what_is_called_while_a_client_waits_may_end_the_waiting_at_once(silent: str) -> None:
    def look(waited_s: float) -> None:
        if waited_s > 0.2:
            raise He3Error("the service ended by itself")

    began = time.monotonic()
    with pytest.raises(He3Error, match=r"^the service ended by itself$"):
        Client(silent, MISSION, while_waiting=look)
    expect_within(2.0, time.monotonic() - began, "the end of the waiting")


def test_an_endpoint_that_takes_the_connection_and_says_nothing_is_reported_once(silent: str) -> None:
    lines: list[str] = []
    report = SilenceReport(Side.EARTH, silent, lines.append)

    def look(waited_s: float) -> None:
        report(waited_s)
        if waited_s > SILENT_AFTER_S + 0.3:
            raise He3Error("enough")

    with pytest.raises(He3Error, match="enough"):
        Client(silent, MISSION, while_waiting=look)
    assert lines == [
        f"{silent} takes the connection, but has not replied for 3 s: "
        "expected the earth router there, got perhaps another program; still waiting"
    ]


def test_an_endpoint_where_nothing_listens_is_said_at_once() -> None:
    began = time.monotonic()
    with pytest.raises(PeerUnreachable, match=r"^no earth router at tcp/127\.0\.0\.1:9$"):
        Client("tcp/127.0.0.1:9", MISSION)
    expect_within(2.0, time.monotonic() - began, "the error")


def test_a_router_that_cannot_listen_says_why(silent: str) -> None:
    with pytest.raises(PeerUnreachable, match=r"^cannot listen as the earth router at \S+: Address already in use$"):
        open_router(Side.EARTH, silent)


def test_a_service_waits_for_a_router_that_comes_late_and_says_so_once() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    lines: list[str] = []
    connected: list[Session | None] = []
    stop = threading.Event()
    thread = threading.Thread(
        target=lambda: connected.append(connect_client(Side.EARTH, endpoint, MISSION, stop, lines.append))
    )
    thread.start()
    until(lambda: lines, "the line that it waits")
    router = Session(open_router(Side.EARTH, endpoint), MISSION)
    try:
        thread.join()
        (session,) = connected
        assert session is not None
        session.close()
    finally:
        router.close()
    assert lines[0] == f"no earth router at {endpoint}; still trying"
    assert len(lines) == len(set(lines))


def test_a_service_that_is_told_to_stop_while_a_silent_endpoint_keeps_it_waiting_stops(silent: str) -> None:
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    began = time.monotonic()
    assert connect_client(Side.EARTH, silent, MISSION, stop, lambda _: None) is None
    expect_within(2.0, time.monotonic() - began, "the end of the waiting")


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_a_query_to_a_process_that_dies_ends_at_once_and_not_with_the_timeout(router: str) -> None:
    server = start([sys.executable, "-c", HANGING_SERVER, router], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        assert server.stdout.readline() == "ready\n"
        with Client(router, MISSION) as client:
            ended: list[tuple[float, PeerUnreachable]] = []

            def query() -> None:
                with pytest.raises(PeerUnreachable) as error:
                    client.query(LIST_COMMANDS, NoParameters(), timeout_s=600.0)
                ended.append((time.monotonic(), error.value))

            thread = threading.Thread(target=query)
            thread.start()
            assert server.stdout.readline() == "queried\n"
            killed_at = time.monotonic()
            os.kill(server.pid, signal.SIGKILL)
            thread.join()
    finally:
        server.kill()
        server.wait()
        server.stdout.close()
    ((at, error),) = ended
    assert str(error) == f"mission '{MISSION}': the ground does not answer"
    expect_within(2.0, at - killed_at, "the end of the query")


def test_a_port_that_another_program_has_taken_ends_the_start_with_the_reason(silent: str, tmp_path: Path) -> None:
    began = time.monotonic()
    command = he3("up", "short", "--quiet", "--set", f"network.earth={silent}", "--set", f"network.moon={_free()}")
    process = start(command, stderr=subprocess.PIPE, text=True, env={"XDG_RUNTIME_DIR": str(tmp_path)})
    _, said = process.communicate()
    assert process.returncode == 1
    expected = f"cannot listen as the earth router at {silent}: the address is in use by another program; "
    assert re.fullmatch(
        re.escape(f"he3: {expected}choose another, as in --set network.earth=tcp/127.0.0.1:") + r"\d+\n", said
    )
    expect_within(6.0, time.monotonic() - began, "the error")


def _free() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("short", "--set", "network.earth={silent}"), 1, "cannot listen as the earth router at {silent}"),
        (("nowhere.toml",), 2, "nowhere.toml: cannot read the scenario: No such file or directory"),
    ],
)
def test_the_exit_code_of_a_service_tells_a_failure_that_may_pass_from_bad_input(
    words: tuple[str, ...], code: int, said: str, silent: str
) -> None:
    moon = ("--set", f"network.moon={free_endpoints().moon}") if code == 1 else ()
    given = [word.format(silent=silent) for word in words]
    done = run([sys.executable, "-P", "-m", "services.link", *given, *moon])
    assert (done.returncode, len(done.stderr.splitlines())) == (code, 1), done.stderr
    assert done.stderr.startswith(f"he3 link: {said.format(silent=silent)}")

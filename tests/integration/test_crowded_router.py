"""Connections of strangers, who never say who they are, take no operator's place."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import NamedTuple

import pytest

from he3.errors import PeerUnreachable
from schemas.roles import Role
from schemas.topics import Side
from services.console.launch.endpoints import free_endpoints
from services.mission.deployment import deployment
from services.runtime.child import python_command
from services.runtime.transport.opening import open_client
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import Subject
from services.runtime.trust.identity import Identity, load_identity
from tests.processes import start
from tests.waiting import PATIENCE_S, until

USUAL_FILES = 256
"""Open files of a process that asks for no more: a quarter of what systems give, so that the test is short."""


class Crowd(NamedTuple):
    endpoint: str
    viewer: Identity

    def joins(self) -> bool:
        """Whether the router lets the viewer in now."""
        try:
            session = open_client(Side.EARTH, self.endpoint, _give_up, self.viewer)
        except PeerUnreachable:
            return False
        session.close()  # type: ignore[no-untyped-call]
        return True


def _give_up(waited_s: float) -> None:
    if waited_s > PATIENCE_S:
        raise PeerUnreachable("the router lets nobody in")


@pytest.fixture
def crowd(tmp_path: Path) -> Iterator[Crowd]:
    """A link with keys, and more connections of strangers than it might have had files."""
    authority = Authority.create(tmp_path / "keys")
    link, viewer = (authority.issue(Subject(role, "a")) for role in (Role.LINK, Role.VIEWER))
    endpoints = free_endpoints("tls")
    command = python_command(
        "services.link", str(deployment("scenarios", "short.toml")), "--identity", str(link),
        "--moon", endpoints.moon, "--earth", endpoints.earth, "--journal", str(tmp_path / "journal"),
    )  # fmt: skip
    with ExitStack() as stack:
        process = start(["sh", "-c", f'ulimit -Sn {USUAL_FILES} && exec "$@"', "sh", *command])
        stack.callback(process.wait)
        stack.callback(process.kill)
        identity = load_identity(viewer)
        crowd = Crowd(endpoints.earth, identity)
        until(crowd.joins, "the link to let a viewer in")
        port = int(endpoints.earth.rpartition(":")[2])
        for _ in range(2 * USUAL_FILES):
            stack.enter_context(closing(socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)))
        yield crowd


def test_an_operator_joins_among_more_strangers_than_a_process_may_have_files(crowd: Crowd) -> None:
    assert crowd.joins()

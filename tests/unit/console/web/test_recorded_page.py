"""The page's server over a recording: it sets the time for everyone, and commands nothing."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from typing import Any

import pytest

from benchmarks.faults import small_region
from schemas.roles import Role
from services.console.replay.mission import RecordedMission
from services.console.web.access import Access
from services.console.web.hub import Hub
from services.console.web.server import page
from tests.unit.console.flown import Flown

HOST = "127.0.0.1:8030"


@pytest.fixture(scope="module")
def recorded(flown_with_faults: Flown) -> Iterator[RecordedMission]:
    with RecordedMission(flown_with_faults.path, small_region()) as mission:
        yield mission


@pytest.fixture(scope="module")
def app(recorded: RecordedMission) -> Any:
    hub = Hub(recorded, recorded)
    hub._state.follow()
    return page(hub, ["127.0.0.1"], Access(8030, anonymous=frozenset({Role.VIEWER})))


def ask(app: Any, path: str, document: object = None) -> tuple[int, Any]:
    """Status and document of the server's reply to a request of its own page."""
    body = b"" if document is None else json.dumps(document).encode()
    ours = {"host": HOST, "origin": f"http://{HOST}", "content-type": "application/json", "x-he3-console": "1"}
    ours["content-length"] = str(len(body))
    path, _, query = path.partition("?")
    scope = {
        "type": "http", "http_version": "1.1", "method": "GET" if document is None else "POST", "scheme": "http",
        "path": f"/api/{path}", "query_string": query.encode(), "server": ("127.0.0.1", 8030), "client": None,
        "headers": [(name.encode(), value.encode()) for name, value in ours.items()],
    }  # fmt: skip
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    asyncio.run(app(scope, receive, send))
    return sent[0]["status"], json.loads(b"".join(each.get("body", b"") for each in sent[1:]))


def test_the_time_is_set_for_everyone_and_the_map_is_of_that_time(app: Any, recorded: RecordedMission) -> None:
    status, said = ask(app, "recording", {"at_s": 3600.0, "pace": 0.0})
    assert (status, said["at_s"], said["pace"]) == (200, 3600.0, 0.0)
    early = ask(app, "map/point?x=40&y=30")[1]
    assert early["mission_time_ns"] <= recorded.begin_ns + 3600 * 10**9
    ask(app, "recording", {"at_s": 9000.0})
    assert ask(app, "map/point?x=40&y=30")[1]["revision"] > early["revision"]


@pytest.mark.parametrize(
    ("path", "document"),
    [
        ("command", {"kind": "pause"}), ("link", {"loss": 0.5}), ("interest", {}),
        ("alarm", {"kind": "stale", "action": "acknowledge"}),
        ("plan", {"proposal": 1, "verdict": "approve"}), ("stack", {"text": "pause"}),
        ("stack/answer", {"number": 1, "line": 1, "send": True}), ("stack/stop", {"number": 1}),
    ],
)  # fmt: skip
def test_whoever_would_command_is_told_that_it_is_a_recording(app: Any, path: str, document: object) -> None:
    status, said = ask(app, path, document)
    assert (status, said["error"].endswith("this is a recording, which cannot be commanded")) == (403, True)


def test_a_preview_is_refused_since_nothing_can_be_sent(app: Any) -> None:
    status, said = ask(app, "preview", {"kind": "pause"})
    assert (status, "got a recording" in said["error"]) == (400, True)

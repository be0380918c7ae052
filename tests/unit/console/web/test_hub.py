"""What the page's server sends: what has changed, a few times a second, and everything to who comes new."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

import pytest

from he3.errors import NotReady, PeerUnreachable
from schemas.ground import GroundStatus, MissionPhase
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT, GROUND_STATUS, Topic
from schemas.wire import Header
from services.console.client.mission_client import MissionClient
from services.console.client.mission_state import MissionState
from services.console.rehearsal.alternative import AS_PLANNED
from services.console.rehearsal.forecast import Forecast
from services.console.web import hub as module
from services.console.web.hub import Hub, Viewer
from services.runtime.transport.client import Client
from tests.unit.console.client.test_stacks import Desk

START = 1_893_456_000 * 10**9


class Session(Client):
    """A session in which a test decides what is heard."""

    def __init__(self) -> None:
        self._listeners: list[tuple[Topic, Callable[[Header, Any], None]]] = []

    def subscribe(self, topic: Topic, on_message: Callable[[Header, Any], None]) -> Callable[[], None]:
        self._listeners.append((topic, on_message))
        return lambda: None

    def declare_display(self) -> Callable[[], None]:
        return lambda: None

    def latest(self, topic: Topic, timeout_s: float = 0.0) -> tuple[Header, Any]:
        raise NotReady(topic.name)

    def hear(self, topic: Topic, body: Any, at_s: float, sequence: int = 0, source: str = "ground") -> None:
        made_at = START + round(at_s * 1e9)
        header = Header(mission="m", source=source, incarnation=1, sequence=sequence, made_at=made_at)
        for wanted, listener in self._listeners:
            if wanted is topic:
                listener(header, body)


class Mission(MissionClient):
    def __init__(self, session: Session) -> None:
        self._session = session
        self.earth, self.mission = "", "m"

    def state(self, on_change: Any = None, start_ns: int | None = None, *, follow: bool = True) -> MissionState:
        return MissionState(self._session, on_change, START)


class Page:
    """A browser's view of the hub: what has come, by looks of the server, at a wall time that a test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.wall = 1000.0
        monkeypatch.setattr(module.time, "monotonic", lambda: self.wall)
        self.session = Session()
        self.hub = Hub(Mission(self.session))
        self.hub._state._subscribe()
        loop = asyncio.new_event_loop()
        self._viewer = Viewer(loop)
        self._loop = loop
        assert self.hub.enter(self._viewer)

    def look(self, after_s: float = 1.0) -> list[tuple[str, Any]]:
        """What comes with the next look of the server, that much later."""
        self.wall += after_s
        self.hub._look()
        self._loop.run_until_complete(asyncio.sleep(0))
        texts = []
        while not self._viewer.queue.empty():
            texts.append(self._viewer.queue.get_nowait() or "")
        parts = [part.split("\n") for part in "".join(texts).split("\n\n") if part]
        return [(kind.removeprefix("event: "), json.loads(data.removeprefix("data: "))) for kind, data in parts]

    def close(self) -> None:
        self._loop.close()


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Any:
    page = Page(monkeypatch)
    page.look()
    yield page
    page.close()


def ground(samples: int, driven_m: float = 0.0) -> GroundStatus:
    return GroundStatus(
        phase=MissionPhase.EXECUTING, planner="rrt", round=0, rounds=3, samples=samples, samples_total=9,
        driven_m=driven_m, budget_m=None, plan_revision=0, plans_in_work=0, map_revision=samples, mean_std_ppb=None,
        kernel=None, score=None, rover=None, rover_made_at=None,
    )  # fmt: skip


def test_of_a_status_only_the_fields_that_have_changed_are_sent(page: Page) -> None:
    page.session.hear(GROUND_STATUS, ground(1), 10.0)
    assert dict(page.look())["status"]["planner"] == "rrt"
    page.session.hear(GROUND_STATUS, ground(1, driven_m=5.0), 20.0)
    assert dict(page.look())["status"] == {"at": START + 20 * 10**9, "driven_m": 5.0}


def test_a_status_that_changes_often_is_sent_twice_a_second_and_its_last_change_is_not_lost(page: Page) -> None:
    sent = []
    for number in range(20):
        page.session.hear(GROUND_STATUS, ground(number), number)
        sent += [content["samples"] for kind, content in page.look(after_s=0.1) if kind == "status"]
    sent += [content["samples"] for kind, content in page.look(after_s=0.5) if kind == "status"]
    assert len(sent) <= 6
    assert sent[-1] == 19


def test_nothing_but_a_beat_a_second_is_sent_while_nothing_changes(page: Page) -> None:
    page.session.hear(GROUND_STATUS, ground(1), 10.0)
    page.look()
    kinds = [kind for _ in range(30) for kind, _ in page.look(after_s=0.1)]
    assert set(kinds) == {"beat"}
    assert len(kinds) <= 4


def test_a_mission_that_is_started_anew_replaces_all_that_an_open_page_shows(page: Page) -> None:
    event = RoverEvent(kind=EventKind.BLOCKED, at=START, x_m=1.0, y_m=2.0, round=1)
    page.session.hear(GROUND_STATUS, ground(5), 500.0)
    page.session.hear(EVENT, event, 400.0, source="rover")
    assert [kind for kind, _ in page.look() if kind in ("event", "status", "alarms")] == ["event", "alarms", "status"]
    page.hub._state._start_afresh()  # as it does when another link process keeps an earlier time
    ((kind, everything),) = page.look()
    assert kind == "state"
    assert [everything[name] for name in ("events", "status", "commands", "entries")] == [[], None, [], []]
    assert everything["alarms"]["current"] == []
    page.session.hear(GROUND_STATUS, ground(1), 10.0)
    assert dict(page.look())["status"]["samples"] == 1


def test_who_comes_later_gets_everything_once(page: Page) -> None:
    event = RoverEvent(kind=EventKind.PAUSED, at=START, x_m=1.0, y_m=2.0)
    page.session.hear(EVENT, event, 400.0, source="rover")
    later = Viewer(page._loop)
    assert page.hub.enter(later)
    page.look()
    page._loop.run_until_complete(asyncio.sleep(0))
    text = "".join(later.queue.get_nowait() or "" for _ in range(later.queue.qsize()))
    assert text.count('"kind":"paused"') == 1


def away(*_: Any) -> tuple[Forecast, ...]:
    raise PeerUnreachable("the ground does not answer")


def test_no_two_servers_give_their_rehearsals_or_stacks_one_number() -> None:
    numbers: set[int] = set()
    for _ in range(3):
        hub = Hub(Mission(Session()), rehearse=away)
        hub.stacks._desk, hub.stacks._start_ns = Desk, lambda: START
        hub.rehearsals.begin(2, (AS_PLANNED,), "anna")
        hub.stacks.start("pause", True, "anna")
        stack = hub.stacks.document()
        assert stack is not None
        assert hub.rehearsals.document()["number"] == stack["number"]
        numbers.add(stack["number"])
        hub.close()
    assert len(numbers) == 3

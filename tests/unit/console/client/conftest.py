"""A Zenoh session for the tests of the client: answers are values, and a test decides when messages arrive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest

from he3.errors import PeerUnreachable
from schemas.topics import Topic
from schemas.wire import Header, Wire
from services.runtime.transport.client import Client


class FakeSession:
    """What `MissionState` and `CommandHandle` use of a session."""

    def __init__(self) -> None:
        self.kept: dict[Topic, tuple[Header, Any]] = {}
        self.answers: dict[Topic, Callable[[], Any]] = {}
        self.listeners: dict[Topic, list[Callable[[Header, Any], None]]] = {}

    def latest(self, topic: Topic, timeout_s: float = 10.0) -> tuple[Header, Any]:
        if topic not in self.kept:
            raise PeerUnreachable(topic.name)
        return self.kept[topic]

    def query(self, topic: Topic, request: Wire, timeout_s: float = 10.0) -> Any:
        if topic not in self.answers:
            raise PeerUnreachable(topic.name)
        return self.answers[topic]()

    def subscribe(self, topic: Topic, on_message: Callable[[Header, Any], None]) -> Callable[[], None]:
        listeners = self.listeners.setdefault(topic, [])
        listeners.append(on_message)
        return lambda: listeners.remove(on_message)

    def send(self, topic: Topic, head: Header, body: Any) -> None:
        """A message arrives."""
        for listener in [*self.listeners.get(topic, ())]:
            listener(head, body)

    @property
    def client(self) -> Client:
        return cast(Client, self)


@pytest.fixture
def session() -> FakeSession:
    return FakeSession()

"""The recorder as a node: it hears every recorded topic on Earth, disturbs nobody, and hands all of it to a sink."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from schemas.codec import encode
from schemas.topics import TOPICS, Side, Topic
from services.mission.scenario import Scenario
from services.runtime.node import (
    Effect,
    Event,
    Interface,
    Level,
    LogRecord,
    MissionTime,
    Received,
    SetTimer,
    Started,
    TimerFired,
    seconds,
)

FLUSH = "flush"

RECORDED: tuple[Topic, ...] = tuple(topic for topic in TOPICS if topic.recorded and Side.EARTH in topic.sides)
"""What is recorded: the topics of the table that say so, as they are heard on Earth."""


class Sink(Protocol):
    """Where a recording goes."""

    def write(
        self, topic: Topic, payload: bytes, received_at: MissionTime, made_at: MissionTime, sequence: int
    ) -> None:
        """Append one message."""

    def flush(self) -> None:
        """Make what was written safe."""


class RecorderNode:
    """Writes down what it hears; after a message, at most `flush_s` of mission time pass before it is safe."""

    def __init__(self, sink: Sink, flush_s: float) -> None:
        self._sink = sink
        self._flush_after = seconds(flush_s)
        self._flush_pending = False

    @property
    def interface(self) -> Interface:
        return Interface("recorder", (Side.EARTH,), subscribes=RECORDED, custody=False)

    def handle(self, event: Event, now: MissionTime) -> Iterable[Effect]:
        """Nothing but a timer: a recorder says nothing."""
        match event:
            case Started(incarnation):
                return [LogRecord(Level.INFO, "recording", {"incarnation": incarnation, "topics": len(RECORDED)})]
            case Received(topic, header, body):
                self._sink.write(topic, encode(header, body), now, header.made_at, header.sequence)
                if not self._flush_pending:
                    self._flush_pending = True
                    return [SetTimer(FLUSH, now + self._flush_after)]
            case TimerFired(timer) if timer == FLUSH:
                self._flush_pending = False
                self._sink.flush()
        return []


def build_node(scenario: Scenario, sink: Sink, flush_s: float | None = None) -> RecorderNode:
    """The recorder of that scenario; by default a message is safe after half a second of wall time at its rate."""
    return RecorderNode(sink, 0.5 * scenario.rate if flush_s is None else flush_s)

"""The recorder's node: it receives every recorded topic on Earth, sends nothing, and writes each message to a sink."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Protocol

from schemas.codec import encode
from schemas.link import ClockMode, ClockState
from schemas.topics import TOPICS, Side, Topic
from services.mission.mission_time import MissionTime, seconds
from services.recorder.foxglove.derivation import Derivation, Derived
from services.runtime.node import Effect, Event, Interface, Level, LogRecord, Received, SetTimer, Started, TimerFired

if TYPE_CHECKING:
    from schemas.wire import Header, Wire
    from services.mission.scenario import Scenario

FLUSH = "flush"
"""Timer: flush the messages since the last flush."""

FLUSH_WALL_S = 0.5
"""Wall time between flushes [s]."""

RECORDED: tuple[Topic, ...] = tuple(topic for topic in TOPICS if topic.recorded and Side.EARTH in topic.sides)
"""The topics that are recorded, as they are received on Earth."""

Derive = Callable[[Topic, "Header", "Wire"], Iterable[Derived]]
"""Makes messages in Foxglove's schemas of one of ours; it may raise anything."""


class Sink(Protocol):
    """The destination of a recording. Writing does not raise; `failure` tells why messages cannot be written."""

    @property
    def failure(self) -> str | None:
        """One line on why messages cannot be written at present; None if they can."""

    @property
    def lost(self) -> bool:
        """Whether the recording is gone, with all that was written."""

    @property
    def omitted(self) -> int:
        """Messages that were left out, because writing failed for too long."""

    def write(
        self, topic: Topic, payload: bytes, received_at: MissionTime, made_at: MissionTime, sequence: int
    ) -> None:
        """Append one message."""

    def write_derived(self, message: Derived, received_at: MissionTime) -> None:
        """Append a message in a schema of Foxglove's, if that is possible now."""

    def flush(self) -> None:
        """Hand all messages to the operating system, so that they survive the end of this process."""


class RecorderNode:
    """Writes each message that it receives; it is safe after at most `flush_s` of mission time.

    With `flush_wall_s` the mission time between flushes follows the rate of the clock, so that a message is safe after
    that wall time at every pace. While time stands it is safe with the clock's next message.
    """

    def __init__(
        self, sink: Sink, flush_s: float, derive: Derive | None = None, flush_wall_s: float | None = None
    ) -> None:
        """derive: the messages in Foxglove's schemas that follow from one of ours; None: there are none."""
        self._sink = sink
        self._derive = derive
        self._derive_failed = False
        self._flush_after = seconds(flush_s)
        self._flush_wall_s = flush_wall_s
        self._flush_pending = False
        self._failure: str | None = None
        self._lost = False

    @property
    def interface(self) -> Interface:
        return Interface("recorder", (Side.EARTH,), subscribes=RECORDED, custody=False)

    def handle(self, event: Event, now: MissionTime) -> Iterator[Effect]:
        """Timers and log records: a recorder sends nothing."""
        match event:
            case Started(incarnation):
                yield LogRecord(Level.INFO, "recording", {"incarnation": incarnation, "topics": len(RECORDED)})
            case Received(topic, header, body):
                self._sink.write(topic, encode(header, body), now, header.made_at, header.sequence)
                yield from self._write_derived(topic, header, body, now)
                if isinstance(body, ClockState) and body.mode is ClockMode.WALL and self._flush_wall_s is not None:
                    self._follow(body.rate, self._flush_wall_s)
            case TimerFired(timer) if timer == FLUSH:
                self._flush_pending = False
                self._sink.flush()
            case _:
                return
        yield from self._report_failure()
        if not self._flush_pending and (isinstance(event, Received) or self._failure is not None):
            self._flush_pending = True
            yield SetTimer(FLUSH, now + self._flush_after)

    def _follow(self, rate: float, flush_wall_s: float) -> None:
        """Flush what has come, and from now on every `flush_wall_s` of wall time at that rate [mission s / wall s].

        While time stands no timer fires. Then a message of the clock leads to a flush, every few seconds of wall time.
        """
        self._sink.flush()
        if rate > 0 and seconds(flush_wall_s * rate) != self._flush_after:
            self._flush_after = seconds(flush_wall_s * rate)
            self._flush_pending = False  # the timer that is set is moved

    def _write_derived(self, topic: Topic, header: Header, body: Wire, now: MissionTime) -> Iterable[Effect]:
        """Write what follows from a message that is written already; a log record when that fails for the first time.

        A recording without messages for Foxglove is a recording. So a fault in making them ends neither.
        """
        if self._derive is None:
            return []
        try:
            for message in self._derive(topic, header, body):
                self._sink.write_derived(message, now)
        except Exception as error:  # noqa: BLE001 - whatever it is, it concerns no message of ours
            if self._derive_failed:
                return []
            self._derive_failed = True
            text = f"messages for Foxglove are missing: {topic.name}: {type(error).__name__}: {error}"
            return [LogRecord(Level.ERROR, text)]
        return []

    def _report_failure(self) -> Iterable[Effect]:
        """A log record when writing begins to fail, when it succeeds again, and when the file is gone; else none."""
        failure, before = self._sink.failure, self._failure
        self._failure = failure
        if self._sink.lost:
            first, self._lost = not self._lost, True
            return [LogRecord(Level.ERROR, f"{failure}; the mission goes on without it")] if first else []
        if failure is not None and before is None:
            text = f"{failure}; messages wait in memory, and writing is tried again"
            return [LogRecord(Level.ERROR, text)]
        if failure is None and before is not None:
            return [LogRecord(Level.WARNING, "the recording continues", {"messages_not_recorded": self._sink.omitted})]
        return []


def build_node(scenario: Scenario, sink: Sink, flush_s: float | None = None) -> RecorderNode:
    """The recorder of that scenario; by default it flushes messages every half second of wall time."""
    if flush_s is not None:
        return RecorderNode(sink, flush_s, Derivation().of)
    return RecorderNode(sink, FLUSH_WALL_S * scenario.rate, Derivation().of, FLUSH_WALL_S)

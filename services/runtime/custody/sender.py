"""The sender's half of custody: keeps each message until it is acknowledged, and repeats it when it was lost.

Per stream (a topic and an incarnation of its source):

- Messages are sent in order of priority, then of offering, as far as the window allows. Those of an earlier incarnation
  of the source go first, so the receiver sees one order across restarts.
- A message is missing when one of its stream that was sent later has arrived and it has not; it is repeated at once.
  The last messages have no later one, so the one longest under way is repeated when its timer elapses.
- After several repetitions without any message from the other side the timers are suspended, and one message is sent
  from time to time as a probe. Any message from the other side resumes the timers at once. No message is ever given up.
- A receiver that restarts may forget the messages that it holds out of turn, so they stay here until acknowledged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from schemas.codec import restamped
from schemas.topics import Custody, Topic, under_custody
from services.runtime.custody.protocol import CustodyConfig, CustodyQueueFull, MessageState, Signal
from services.runtime.custody.retransmission import RetransmissionTimer
from services.runtime.custody.stream import KeptMessage, SendStream, Transmission, below, made, missing
from services.runtime.custody.window import SendWindow

if TYPE_CHECKING:
    from schemas.link import Acknowledgement
    from schemas.wire import Header
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState


@dataclass(frozen=True, slots=True)
class Transmit:
    """Publish these bytes on that topic now."""

    topic: Topic
    payload: bytes


class CustodySender:
    """Messages of one source under custody, on their way to the other side."""

    def __init__(self, source: str, config: CustodyConfig | None = None) -> None:
        self._source = source
        self._config = config or CustodyConfig()
        self._streams: dict[tuple[str, int], SendStream] = {}
        self._window = SendWindow(self._config)
        self._timer = RetransmissionTimer(self._config)
        self._offered = 0
        self._transmissions = 0
        self._bytes = 0
        self.retransmitted = 0
        """Messages sent again so far."""

    # --- what its owner asks ------------------------------------------------------------------------------------

    @property
    def depth(self) -> int:
        """Messages that are not yet acknowledged."""
        return sum(len(stream.kept) for stream in self._streams.values())

    @property
    def suspended(self) -> bool:
        """Whether the timers are suspended because nothing has been received for a long time."""
        return self._timer.suspended

    def held_from(self, topic: Topic, incarnation: int, sequence: int) -> int:
        """`held_from` of a new message with that sequence: the lowest sequence of its stream that is still kept."""
        stream = self._streams.get((topic.name, incarnation))
        return next(iter(stream.kept), sequence) if stream is not None else sequence

    def next_timer(self) -> MissionTime | None:
        """When `timer_elapsed` is to be called; None if no timer runs."""
        if self.suspended:
            return self._timer.probe_at if self.depth else None
        times = [deadline for stream in self._streams.values() if (deadline := self._deadline(stream)) is not None]
        return min(times, default=None)

    # --- what happens to it -------------------------------------------------------------------------------------

    def offer(self, topic: Topic, header: Header, payload: bytes, now: MissionTime) -> list[Transmit]:
        """Keep a new message.

        Raises CustodyQueueFull if there is no room, InvalidInput for a message of another source, of a topic that is
        not under custody, or out of sequence.
        """
        config = self._config
        if self.depth >= config.max_messages or self._bytes + len(payload) > config.max_bytes:
            raise CustodyQueueFull(
                f"{topic.name}: expected at most {config.max_messages} messages and {config.max_bytes} bytes to await "
                f"acknowledgement, got {self.depth} and {self._bytes} before one of {len(payload)} bytes"
            )
        self._keep(topic, header, payload)
        return self._send(now)

    def contact(self, now: MissionTime) -> list[Transmit]:
        """Note contact: a message has come from the other side."""
        self._resume(now)
        return self._send(now)

    def objection(self, ack: Acknowledgement) -> str | None:
        """One line on an acknowledgement of a message that was never sent; None if there is nothing to object."""
        stream = self._streams.get((ack.stream, ack.incarnation)) if ack.source == self._source else None
        if stream is None or ack.next_sequence <= stream.highest_sent + 1:
            return None
        return (
            f"acknowledgement of {ack.stream}: expected at most the {stream.highest_sent + 1} messages that were sent, "
            f"got {ack.next_sequence}"
        )

    def acknowledged(self, ack: Acknowledgement, header: Header, now: MissionTime) -> list[Transmit]:
        """Handle an acknowledgement. One for another source, or an outdated one, only proves contact."""
        stream = self._streams.get((ack.stream, ack.incarnation)) if ack.source == self._source else None
        number = made(header, now)
        if stream is None or number <= stream.newest_ack:
            return self.contact(now)
        stream.newest_ack = number
        latest = stream.latest_arrival(ack)
        transmission = stream.acknowledged_transmission(ack)
        if transmission is not None:
            self._timer.acknowledged(stream, transmission, now)
        if self._settle(stream, ack):
            stream.waits_since = now
        self._repeat_missing(stream, ack, latest)
        if not stream.kept:
            self._begin_next_incarnation(ack.stream)
        self._resume(now)
        return self._send(now)

    def timer_elapsed(self, now: MissionTime) -> list[Transmit]:
        """Handle the end of the time that `next_timer` returned."""
        probe_at = self._timer.probe_at
        if probe_at is None:
            self._repeat_overdue(now)
        elif probe_at <= now:
            self._probe(now)
        return self._send(now)

    # --- keeping ------------------------------------------------------------------------------------------------

    def _keep(self, topic: Topic, header: Header, payload: bytes) -> None:
        if not under_custody(topic) or not isinstance(topic.service, Custody):
            raise InvalidInput(f"expected a topic under custody, got {topic.name}")
        if header.source != self._source:
            raise InvalidInput(f"{topic.name}: expected messages of '{self._source}', got one of '{header.source}'")
        stream = self._stream(topic.name, header.incarnation)
        last = next(reversed(stream.kept), -1)
        if header.sequence <= last:
            raise InvalidInput(f"{topic.name}: expected a sequence above {last}, got {header.sequence}")
        self._offered += 1
        message = KeptMessage(
            topic=topic,
            incarnation=header.incarnation,
            sequence=header.sequence,
            payload=payload,
            priority=topic.service.priority,
            order=self._offered,
        )
        stream.kept[header.sequence] = message
        self._bytes += len(payload)
        if stream.in_turn:
            self._window.enqueue(message)

    def _stream(self, name: str, incarnation: int) -> SendStream:
        stream = self._streams.get((name, incarnation))
        if stream is None:
            others = [key for key in self._streams if key[0] == name]
            for key in others:
                if not self._streams[key].kept:
                    del self._streams[key]
            earlier = any(key in self._streams for key in others)
            stream = self._streams[name, incarnation] = SendStream(in_turn=not earlier)
        return stream

    def _begin_next_incarnation(self, name: str) -> None:
        """Queue the messages of the next incarnation once all of the earlier one are acknowledged."""
        left = [stream for key in sorted(self._streams) if key[0] == name and (stream := self._streams[key]).kept]
        if left and not left[0].in_turn:
            left[0].in_turn = True
            for message in left[0].kept.values():
                self._window.enqueue(message)

    # --- sending ------------------------------------------------------------------------------------------------

    def _send(self, now: MissionTime) -> list[Transmit]:
        """Send the waiting messages: repetitions at once, the others in turn, as far as the window allows."""
        transmits = []
        while (message := self._window.take_next()) is not None:
            transmits.append(self._transmit(message, now))
        return transmits

    def _transmit(self, message: KeptMessage, now: MissionTime) -> Transmit:
        stream = self._streams[message.topic.name, message.incarnation]
        if message.repetitions:
            self.retransmitted += 1
            self._restamp(message, stream)
        if stream.oldest_sent is None:
            stream.waits_since = now
        self._transmissions += 1
        last_bit_at = self._timer.transmit(len(message.payload), now)
        stream.highest_sent = max(stream.highest_sent, message.sequence)
        message.transmitted(Transmission(self._transmissions, now, last_bit_at))
        self._window.open(stream.sent, message)
        if self.suspended:
            message.signal(Signal.SILENCE)
        return Transmit(message.topic, message.payload)

    def _restamp(self, message: KeptMessage, stream: SendStream) -> None:
        """Write repetition count and `held_from` into the payload; a receiver that lost its state needs the latter."""
        before = len(message.payload)
        message.payload = restamped(message.payload, next(iter(stream.kept)), message.repetitions)
        self._bytes += len(message.payload) - before

    def _requeue(self, stream: SendStream, message: KeptMessage, signal: Signal) -> None:
        message.signal(signal)
        self._window.close(stream, message)
        self._window.enqueue(message)

    def _requeue_oldest(self, stream: SendStream, now: MissionTime) -> None:
        """Repeat the message whose timer runs."""
        message = stream.oldest_sent
        stream.waits_since = now
        if message is not None:
            self._requeue(stream, message, Signal.TIMED_OUT)

    # --- timers and contact -------------------------------------------------------------------------------------

    def _deadline(self, stream: SendStream) -> MissionTime | None:
        message = stream.oldest_sent
        return None if message is None else self._timer.deadline(stream, self._bytes_ahead(message))

    def _bytes_ahead(self, message: KeptMessage) -> int:
        """Size of the message and of all under way that leave before it."""
        if self._config.rate_bit_s is None:
            return 0
        return sum(
            len(other.payload)
            for stream in self._streams.values()
            for other in stream.sent.values()
            if other.priority < message.priority
            or (other.priority == message.priority and other.last_transmission <= message.last_transmission)
        )

    def _repeat_overdue(self, now: MissionTime) -> None:
        for stream in list(self._streams.values()):
            deadline = self._deadline(stream)
            if deadline is None or deadline > now:
                continue
            self._requeue_oldest(stream, now)
            if self._timer.elapsed(stream):
                self._suspend(now)
                return

    def _suspend(self, now: MissionTime) -> None:
        self._timer.suspend(now)
        for stream in self._streams.values():
            for message in stream.sent.values():
                message.signal(Signal.SILENCE)

    def _probe(self, now: MissionTime) -> None:
        """Repeat one message, of the stream whose first message has the earliest turn."""
        self._timer.suspend(now)
        streams = [stream for stream in self._streams.values() if stream.oldest_sent]
        if streams:
            self._requeue_oldest(min(streams, key=lambda stream: next(iter(stream.kept.values())).turn), now)

    def _resume(self, now: MissionTime) -> None:
        """Resume the timers on contact; if they were suspended, each stream repeats its oldest message."""
        for stream in self._streams.values():
            stream.unanswered = 0
        if not self.suspended:
            return
        self._timer.resume()
        for stream in self._streams.values():
            stream.doublings = 0
            stream.waits_since = now
            for message in stream.sent.values():
                if message.state is MessageState.SUSPENDED:
                    message.signal(Signal.CONTACT)
            if not next((message.queued for message in stream.kept.values()), False):
                self._requeue_oldest(stream, now)

    # --- acknowledgements ---------------------------------------------------------------------------------------

    def _settle(self, stream: SendStream, ack: Acknowledgement) -> bool:
        """Drop acknowledged messages and mark held ones; returns whether anything was new."""
        complete = ack.gaps[0][0] if ack.gaps else ack.next_sequence
        progress = False
        for sequence in list(below(stream.kept, ack.next_sequence)):
            message = stream.kept[sequence]
            if not message.transmissions:
                continue  # it cannot have arrived
            if sequence >= complete and (message.state is MessageState.HELD or missing(ack, sequence)):
                continue
            progress = True
            self._window.dequeue(message)
            self._window.close(stream, message)
            if sequence < complete:
                message.signal(Signal.ACKNOWLEDGED)
                del stream.kept[sequence]
                self._bytes -= len(message.payload)
            else:
                message.signal(Signal.OUT_OF_TURN)
                self._window.open(stream.held, message)
        return progress

    def _repeat_missing(self, stream: SendStream, ack: Acknowledgement, latest_arrival: int) -> None:
        """Queue again the messages that a later one has overtaken, and those that the receiver no longer holds."""
        for message in [*stream.sent.values()]:
            if missing(ack, message.sequence) and message.last_transmission < latest_arrival:
                if message.state is MessageState.SUSPENDED:
                    message.signal(Signal.CONTACT)
                self._requeue(stream, message, Signal.MISSED)
        for message in [*stream.held.values()]:
            if missing(ack, message.sequence):
                self._requeue(stream, message, Signal.MISSED)

    # --- checkpoints --------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """Every message kept, and the timers, as named parts."""
        return {
            "streams": {key: stream.checkpoint() for key, stream in self._streams.items()},
            "timer": self._timer.checkpoint(),
            "offered": self._offered,
            "transmissions": self._transmissions,
            "retransmitted": self.retransmitted,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the sender from this state."""
        self._streams = {key: SendStream.restored(stream) for key, stream in state["streams"].items()}
        self._timer.restore(state["timer"])
        self._window.restore(self._streams.values())
        self._offered, self._transmissions = state["offered"], state["transmissions"]
        self.retransmitted = state["retransmitted"]
        self._bytes = sum(len(message.payload) for stream in self._streams.values() for message in stream.kept.values())

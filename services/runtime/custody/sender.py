"""The sender's half of custody: keeps each message until it is acknowledged, and sends it again when it must.

How it decides, per stream (topic and incarnation of its source):

- Messages go out in order of priority and offering, so many at a time as the window allows; those of an earlier
  incarnation of the source come first, so that the receiver sees one order across restarts.
- A message is found missing when one of its stream that was sent after it has come and it has not: then it is sent
  again at once. The last ones have no such witness, so the one longest under way is sent again when its time is up:
  one round trip, what queues ahead of it at the known rate, and a margin; twice as long each time in vain.
- After several such repetitions without any word from the other side, timers are suspended and one message is tried
  now and then. Any word resumes them at once. Nothing is ever given up.
- The receiver may forget what it holds out of turn when it restarts, so that is kept here too until acknowledged.

Times are integer nanoseconds of mission time. Rebuilt from a journal with `restore`, then `resume`.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from dataclasses import dataclass

from he3.errors import InvalidInput
from schemas.codec import restamped
from schemas.link import Acknowledgement
from schemas.topics import Custody, Topic
from schemas.wire import Header
from services.runtime.custody.protocol import (
    CustodyConfig,
    CustodyQueueFull,
    RoundTrip,
    Signal,
    State,
    bits_time,
    following,
    under_custody,
)
from services.runtime.custody.stream import Kept, Sending, Stream, below, missing, turn
from services.runtime.node import MissionTime, seconds

REMEMBERED_SENDINGS = 8
MAX_DOUBLINGS = 5
"""A wait grows 32-fold at most: what is lost here is lost to noise more often than to a queue."""
MAX_SURPRISE = 4
"""No measured round trip counts for more than so many waits: a blackout within it must not spoil the measure."""


@dataclass(frozen=True, slots=True)
class Transmit:
    """Put these bytes under the topic's key now."""

    topic: Topic
    payload: bytes
    repetition: int
    """0: for the first time."""


@dataclass(frozen=True, slots=True)
class SenderCounts:
    """What became of the messages since the start."""

    offered: int
    sent: int
    repeated: int
    acknowledged: int
    kept: int
    suspensions: int


class CustodySender:
    """Messages of one source under custody, on their way to the other side."""

    def __init__(self, source: str, config: CustodyConfig | None = None) -> None:
        self._source = source
        self._config = config or CustodyConfig()
        self._streams: dict[tuple[str, int], Stream] = {}
        self._new: list[Kept] = []  # waiting for their first sending, by turn
        self._again: list[Kept] = []  # waiting for a repetition, by turn
        self._round_trip = RoundTrip(seconds(self._config.round_trip_s), seconds(self._config.margin_s))
        self._order = 0
        self._sendings = 0
        self._bytes = 0
        self._under_way = 0
        self._under_way_bytes = 0
        self._clear_at: MissionTime = 0
        self._probe_at: MissionTime | None = None  # not None: suspended
        self._offered = self._repeated = self._acknowledged = self._suspensions = 0

    # --- what its owner asks ------------------------------------------------------------------------------------

    @property
    def depth(self) -> int:
        """Messages that are not yet acknowledged."""
        return sum(len(stream.kept) for stream in self._streams.values())

    @property
    def suspended(self) -> bool:
        """Whether timers stand still because the other side has not been heard for long."""
        return self._probe_at is not None

    @property
    def round_trip(self) -> MissionTime:
        """From sending to acknowledgement as measured [ns]."""
        return self._round_trip.mean

    @property
    def counts(self) -> SenderCounts:
        return SenderCounts(
            offered=self._offered,
            sent=self._sendings,
            repeated=self._repeated,
            acknowledged=self._acknowledged,
            kept=self.depth,
            suspensions=self._suspensions,
        )

    def held_from(self, topic: Topic, incarnation: int, sequence: int) -> int:
        """What a new message with that sequence should say in its header: the lowest sequence still kept here."""
        stream = self._streams.get((topic.name, incarnation))
        return next(iter(stream.kept), sequence) if stream is not None else sequence

    def next_due(self) -> MissionTime | None:
        """When `due` wants to be called next; None: not before something else happens."""
        if self._probe_at is not None:
            return self._probe_at if self.depth else None
        times = [deadline for stream in self._streams.values() if (deadline := self._deadline(stream)) is not None]
        return min(times, default=None)

    # --- what happens to it -------------------------------------------------------------------------------------

    def restore(self, topic: Topic, header: Header, payload: bytes) -> None:
        """Keeps a message of an earlier life again; in their old order, before anything is offered."""
        stream = self._stream(topic.name, header.incarnation)
        stream.in_turn = False
        self._keep(stream, topic, header, payload).repetitions = 1

    def resume(self, now: MissionTime) -> list[Transmit]:
        """What to send at the start, after everything was restored.

        One message a topic: its acknowledgement tells which of the others the receiver has.
        """
        begun = set()
        for (name, _), stream in sorted(self._streams.items(), key=lambda item: item[0]):
            if name not in begun and stream.kept:
                begun.add(name)
                self._queues(next(iter(stream.kept.values())))
        return self._sends(now)

    def offer(self, topic: Topic, header: Header, payload: bytes, now: MissionTime) -> list[Transmit]:
        """Keeps a new message; raises OutboxFull when there is no room, InvalidInput when it is not ours to keep."""
        config = self._config
        if self.depth >= config.max_messages or self._bytes + len(payload) > config.max_bytes:
            raise CustodyQueueFull(
                f"{topic.name}: expected at most {config.max_messages} messages and {config.max_bytes} bytes to await "
                f"acknowledgement, got {self.depth} and {self._bytes} before one of {len(payload)} bytes"
            )
        self._keep(self._stream(topic.name, header.incarnation), topic, header, payload)
        self._offered += 1
        return self._sends(now)

    def heard(self, now: MissionTime) -> list[Transmit]:
        """Any message came from the other side: there is contact."""
        self._notes_contact(now)
        return self._sends(now)

    def acknowledged(self, ack: Acknowledgement, header: Header, now: MissionTime) -> list[Transmit]:
        """An acknowledgement came; one for others, or older than one before it, shows only that there is contact."""
        stream = self._streams.get((ack.stream, ack.incarnation)) if ack.source == self._source else None
        number = (header.incarnation, header.sequence)
        if stream is None or number <= stream.newest_ack:
            return self.heard(now)
        stream.newest_ack = number
        witness = stream.witness(ack)
        self._learns_round_trip(stream, ack, now)
        progress = self._settles(stream, ack)
        self._findsmissing(stream, ack, witness)
        if progress:
            stream.waits_since = now
        self._comes_into_turn(ack.stream, stream if stream.kept else None)
        self._notes_contact(now)
        return self._sends(now)

    def due(self, now: MissionTime) -> list[Transmit]:
        """The time that `next_due` told has come."""
        if self._probe_at is not None:
            if self._probe_at <= now:
                self._probe_at = now + self._probe_pause()
                stream = min(
                    (stream for stream in self._streams.values() if stream.oldest_sent),
                    key=lambda stream: next(iter(stream.kept.values())).turn,
                    default=None,
                )
                if stream is not None:
                    self._tries_oldest(stream, now)
            return self._sends(now)
        for stream in list(self._streams.values()):
            deadline = self._deadline(stream)
            if deadline is not None and deadline <= now:
                self._tries_oldest(stream, now)
                stream.doublings = min(MAX_DOUBLINGS, stream.doublings + 1)
                stream.in_vain += 1
                if stream.in_vain > self._config.silent_repetitions:
                    self._suspends(now)
                    break
        return self._sends(now)

    # --- keeping ------------------------------------------------------------------------------------------------

    def _keep(self, stream: Stream, topic: Topic, header: Header, payload: bytes) -> Kept:
        if not under_custody(topic) or not isinstance(topic.service, Custody):
            raise InvalidInput(f"expected a topic under custody, got {topic.name}")
        if header.source != self._source:
            raise InvalidInput(f"{topic.name}: expected messages of '{self._source}', got one of '{header.source}'")
        last = next(reversed(stream.kept), -1)
        if header.sequence <= last:
            raise InvalidInput(f"{topic.name}: expected a sequence above {last}, got {header.sequence}")
        self._order += 1
        kept = Kept(
            topic=topic,
            incarnation=header.incarnation,
            sequence=header.sequence,
            payload=payload,
            priority=topic.service.priority,
            order=self._order,
        )
        stream.kept[header.sequence] = kept
        self._bytes += len(payload)
        if stream.in_turn:
            self._queues(kept)
        return kept

    def _stream(self, name: str, incarnation: int) -> Stream:
        stream = self._streams.get((name, incarnation))
        if stream is None:
            others = [key for key in self._streams if key[0] == name]
            for key in others:
                if not self._streams[key].kept:
                    del self._streams[key]
            earlier = any(key in self._streams for key in others)
            stream = self._streams[name, incarnation] = Stream(in_turn=not earlier)
        return stream

    def _comes_into_turn(self, name: str, stream: Stream | None) -> None:
        """Queues all of a restored stream that was heard of, or of the next incarnation after one that has ended."""
        if stream is None:
            left = [(key, found) for key, found in sorted(self._streams.items()) if key[0] == name and found.kept]
            stream = left[0][1] if left else None
        if stream is not None and not stream.in_turn:
            stream.in_turn = True
            for kept in stream.kept.values():
                if kept.state is State.WAITING and not kept.queued:
                    self._queues(kept)

    def _moves(self, kept: Kept, signal: Signal) -> None:
        kept.state = following(kept.state, signal)

    def _queues(self, kept: Kept) -> None:
        kept.queued = True
        insort(self._again if kept.sendings else self._new, kept, key=turn)

    def _leaves_queue(self, kept: Kept) -> None:
        if kept.queued:
            kept.queued = False
            queue = self._again if kept.sendings else self._new
            del queue[bisect_left(queue, kept.turn, key=turn)]

    def _goes_under_way(self, among: dict[int, Kept], kept: Kept) -> None:
        among[kept.sequence] = kept
        self._under_way += 1
        self._under_way_bytes += len(kept.payload)

    def _comes_off_the_way(self, stream: Stream, kept: Kept) -> None:
        if stream.sent.pop(kept.sequence, None) or stream.held.pop(kept.sequence, None):
            self._under_way -= 1
            self._under_way_bytes -= len(kept.payload)

    def _returns_to_queue(self, stream: Stream, kept: Kept, signal: Signal) -> None:
        self._moves(kept, signal)
        self._comes_off_the_way(stream, kept)
        self._queues(kept)

    # --- sending ------------------------------------------------------------------------------------------------

    def _sends(self, now: MissionTime) -> list[Transmit]:
        """Sends what waits: repetitions at once, the rest in turn, as far as the window allows."""
        transmits = []
        while self._again or (self._new and self._window_admits(self._new[0])):
            kept = (self._again or self._new)[0]
            self._leaves_queue(kept)
            transmits.append(self._transmits(kept, now))
        return transmits

    def _window_admits(self, kept: Kept) -> bool:
        config = self._config
        return self._under_way == 0 or (
            self._under_way < config.window_messages
            and self._under_way_bytes + len(kept.payload) <= config.window_bytes
        )

    def _transmits(self, kept: Kept, now: MissionTime) -> Transmit:
        stream = self._streams[kept.topic.name, kept.incarnation]
        if kept.repetitions:
            self._restamps(kept, stream)
        if stream.oldest_sent is None:
            stream.waits_since = now
        self._sendings += 1
        self._repeated += bool(kept.sendings)
        self._clear_at = max(now, self._clear_at) + bits_time(len(kept.payload), self._config.rate_bit_s)
        if len(kept.sendings) >= REMEMBERED_SENDINGS:
            del kept.sendings[list(kept.sendings)[1]]  # the first is the one that comes first
        kept.sendings[kept.repetitions] = Sending(self._sendings, now, self._clear_at)
        kept.repetitions += 1
        self._moves(kept, Signal.TRANSMITTED)
        self._goes_under_way(stream.sent, kept)
        if self.suspended:
            self._moves(kept, Signal.SILENCE)
        return Transmit(kept.topic, kept.payload, kept.repetitions - 1)

    def _restamps(self, kept: Kept, stream: Stream) -> None:
        """Says which repetition it is, and, to a receiver that forgot everything, that what came before is settled."""
        before = len(kept.payload)
        kept.payload = restamped(kept.payload, next(iter(stream.kept)), kept.repetitions)
        self._bytes += len(kept.payload) - before

    def _tries_oldest(self, stream: Stream, now: MissionTime) -> None:
        """Puts the message that is longest under way back in the queue."""
        kept = stream.oldest_sent
        stream.waits_since = now
        if kept is not None:
            self._returns_to_queue(stream, kept, Signal.TIMED_OUT)

    # --- time ---------------------------------------------------------------------------------------------------

    def _deadline(self, stream: Stream) -> MissionTime | None:
        """When the time of the stream's oldest message under way is up."""
        kept = stream.oldest_sent
        if kept is None:
            return None
        wait = (self._round_trip.wait + self._queued_before(kept)) << stream.doublings
        most = max(seconds(self._config.max_wait_s), 2 * self._round_trip.wait + self._queued_before(kept))
        return max(stream.waits_since, kept.last_sent_at) + min(wait, most)

    def _queued_before(self, kept: Kept) -> MissionTime:
        """How long the message may have waited for others, and taken itself, at the known rate."""
        if self._config.rate_bit_s is None:
            return 0
        ahead = sum(
            len(other.payload)
            for stream in self._streams.values()
            for other in stream.sent.values()
            if other.priority < kept.priority
            or (other.priority == kept.priority and other.last_sending <= kept.last_sending)
        )
        return bits_time(ahead, self._config.rate_bit_s)

    def _probe_pause(self) -> MissionTime:
        return max(seconds(self._config.probe_s), 2 * self._round_trip.mean)

    def _suspends(self, now: MissionTime) -> None:
        self._suspensions += 1
        self._probe_at = now + self._probe_pause()
        for stream in self._streams.values():
            for kept in stream.sent.values():
                self._moves(kept, Signal.SILENCE)

    def _notes_contact(self, now: MissionTime) -> None:
        for stream in self._streams.values():
            stream.in_vain = 0
        if self._probe_at is None:
            return
        self._probe_at = None
        for stream in self._streams.values():
            stream.doublings = 0
            stream.waits_since = now
            for kept in stream.sent.values():
                if kept.state is State.SUSPENDED:
                    self._moves(kept, Signal.HEARD)
            if not next((kept.queued for kept in stream.kept.values()), False):
                self._tries_oldest(stream, now)

    # --- acknowledgements ---------------------------------------------------------------------------------------

    def _learns_round_trip(self, stream: Stream, ack: Acknowledgement, now: MissionTime) -> None:
        """Measures by the sending whose arrival was acknowledged."""
        sending = stream.last_to_come(ack)
        if sending is not None:
            most = MAX_SURPRISE * self._round_trip.wait
            self._round_trip.measured(min(most, max(0, now - sending.last_bit_at)))
            stream.doublings = 0

    def _settles(self, stream: Stream, ack: Acknowledgement) -> bool:
        """Lets go of what is acknowledged and notes what is held; True when anything was new."""
        complete = ack.gaps[0][0] if ack.gaps else ack.next_sequence
        progress = False
        for sequence in list(below(stream.kept, ack.next_sequence)):
            kept = stream.kept[sequence]
            if sequence >= complete and (kept.state is State.HELD or missing(ack, sequence)):
                continue
            progress = True
            self._leaves_queue(kept)
            self._comes_off_the_way(stream, kept)
            if sequence < complete:
                self._moves(kept, Signal.ACKNOWLEDGED)
                del stream.kept[sequence]
                self._bytes -= len(kept.payload)
                self._acknowledged += 1
            else:
                self._moves(kept, Signal.OUT_OF_TURN)
                self._goes_under_way(stream.held, kept)
        return progress

    def _findsmissing(self, stream: Stream, ack: Acknowledgement, witness: int) -> None:
        """Puts back in the queue what a later sending has overtaken, and what the receiver no longer holds."""
        for kept in [*stream.sent.values()]:
            if missing(ack, kept.sequence) and kept.last_sending < witness:
                if kept.state is State.SUSPENDED:
                    self._moves(kept, Signal.HEARD)
                self._returns_to_queue(stream, kept, Signal.MISSED)
        for kept in [*stream.held.values()]:
            if missing(ack, kept.sequence):
                self._returns_to_queue(stream, kept, Signal.MISSED)

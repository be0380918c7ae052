"""What stands between a node and any driver: headers stamped, messages checked, events counted, still without I/O.

A driver hands in what came (bytes, times, names) and carries out the actions that come back. Everything that all
drivers must do alike is done here, so that a mission is the same in one process, in many, and after a restart.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from schemas.topics import Crosses, Side, Topic
from schemas.wire import Header, Refused, Wire, decode, decode_reply, encode
from services.node import (
    Answer,
    Answered,
    Ask,
    Asked,
    Compute,
    Computed,
    Due,
    Effect,
    Event,
    Finish,
    Forward,
    Interface,
    Level,
    MissionTime,
    Node,
    Note,
    Overheard,
    Received,
    Refuse,
    Send,
    Show,
    Silence,
    Started,
    Unanswered,
    WakeAt,
)


@dataclass(frozen=True, slots=True)
class Publish:
    """Put these bytes under the topic's key on that side."""

    topic: Topic
    side: Side
    payload: bytes


@dataclass(frozen=True, slots=True)
class PutQuestion:
    """Ask whoever serves the topic on that side; report back under the question's name."""

    topic: Topic
    side: Side
    payload: bytes
    question: str
    timeout_s: float


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer the asker of that token with these bytes."""

    token: int
    topic: Topic
    payload: bytes


@dataclass(frozen=True, slots=True)
class ReplyError:
    """Tell the asker of that token, in one line, why there is no answer."""

    token: int
    topic: Topic
    why: str


def origin(topic: Topic) -> Side:
    """The side on which messages of that topic are made."""
    if topic.crosses is Crosses.NEVER:
        return topic.sides[0]
    return Side.EARTH if topic.crosses is Crosses.UP else Side.MOON


Action = Publish | PutQuestion | Reply | ReplyError | WakeAt | Compute | Show | Note | Finish

Trace = Callable[[MissionTime, str, str], None]
"""Called with mission time, node and a line for each event handled: the event log."""


class Host:
    """One node, ready to be driven."""

    def __init__(self, node: Node, mission: str, trace: Trace | None = None) -> None:
        self._node = node
        self._interface = node.interface
        self._mission = mission
        self._trace = trace
        self._incarnation = 0
        self._sequences: dict[str, int] = {}
        self._asked: dict[int, Topic] = {}
        self._questions: dict[str, Topic] = {}
        self._refused = 0
        self._events = 0

    @property
    def interface(self) -> Interface:
        return self._interface

    @property
    def mission(self) -> str:
        return self._mission

    @property
    def incarnation(self) -> int:
        return self._incarnation

    @property
    def refused(self) -> int:
        """Messages from outside that were refused since the start."""
        return self._refused

    @property
    def events(self) -> int:
        """Events handled since the start."""
        return self._events

    def hears(self, topic: Topic, side: Side) -> bool:
        """Whether a message published on that side is for this node.

        A topic that crosses is carried from where it is made only: nobody makes telemetry on Earth.
        """
        if side not in self._interface.sides:
            return False
        if topic in self._interface.overhears:
            return side is origin(topic)
        return topic in self._interface.subscribes

    # --- what a driver reports ----------------------------------------------------------------------------------

    def start(self, incarnation: int, now: MissionTime) -> list[Action]:
        """Actions of the node's start; to be called once, before anything else."""
        self._incarnation = incarnation
        return self._handle(Started(incarnation), now, f"started {incarnation}")

    def deliver(self, topic: Topic, payload: bytes, now: MissionTime) -> list[Action]:
        """Actions upon a message that came; one that is not what its topic asks for is refused and counted."""
        what = f"received {topic.name} {len(payload)} {zlib.crc32(payload):08x}"
        if topic in self._interface.overhears:
            return self._handle(Overheard(topic, payload), now, what)
        try:
            header, body = decode(topic, payload, self._mission)
        except Refused as refusal:
            return [self._refuse(str(refusal))]
        return self._handle(Received(topic, header, body), now, what)

    def ask(self, topic: Topic, payload: bytes, token: int, now: MissionTime) -> list[Action]:
        """Actions upon a question put to this node; a bad one is answered with its refusal."""
        try:
            _, body = decode(topic, payload, self._mission)
        except Refused as refusal:
            return [self._refuse(str(refusal)), ReplyError(token, topic, str(refusal))]
        return self.ask_checked(topic, body, token, now)

    def ask_checked(self, topic: Topic, request: Wire, token: int, now: MissionTime) -> list[Action]:
        """Like `ask`, with a request that was made from selector parameters and is checked already."""
        self._asked[token] = topic
        return self._handle(Asked(topic, request, token), now, f"asked {topic.name}")

    def answered(self, question: str, payload: bytes, now: MissionTime) -> list[Action]:
        """Actions upon the answer to this node's question."""
        topic = self._questions.pop(question, None)
        if topic is None:
            return []
        try:
            _, reply = decode_reply(topic, payload, self._mission)
        except Refused as refusal:
            unanswered = Unanswered(topic, question, Silence.REFUSED, str(refusal))
            return [self._refuse(str(refusal)), *self._handle(unanswered, now, f"unanswered {topic.name}")]
        return self._handle(
            Answered(topic, question, reply), now, f"answered {topic.name} {zlib.crc32(payload):08x} {question}"
        )

    def unanswered(self, question: str, why: Silence, detail: str, now: MissionTime) -> list[Action]:
        """Actions upon the news that a question of this node has no answer."""
        topic = self._questions.pop(question, None)
        if topic is None:
            return []
        return self._handle(
            Unanswered(topic, question, why, detail), now, f"unanswered {topic.name} {why.name} {question}"
        )

    def due(self, timer: str, now: MissionTime) -> list[Action]:
        """Actions upon a timer."""
        return self._handle(Due(timer), now, f"due {timer}")

    def computed(self, job: str, result: Any, error: Exception | None, now: MissionTime) -> list[Action]:
        """Actions upon the end of a computation."""
        return self._handle(Computed(job, result, error), now, f"computed {job}{' failed' if error else ''}")

    # --- inside -------------------------------------------------------------------------------------------------

    def _handle(self, event: Event, now: MissionTime, what: str) -> list[Action]:
        self._events += 1
        if self._trace is not None:
            self._trace(now, self._interface.name, what)
        return list(self._actions(self._node.handle(event, now), now))

    def _actions(self, effects: Iterable[Effect], now: MissionTime) -> Iterable[Action]:
        for effect in effects:
            match effect:
                case Send(topic, body):
                    yield Publish(topic, self._side_of(topic), encode(self._header(topic, now), body))
                case Forward(topic, payload, side):
                    yield Publish(topic, side, payload)
                case Ask(topic, request, question, timeout_s):
                    self._questions[question] = topic
                    payload = encode(self._header(topic, now), request)
                    yield PutQuestion(topic, self._side_of(topic), payload, question, timeout_s)
                case Answer(token, reply):
                    asked = self._asked.pop(token, None)
                    if asked is not None:
                        yield Reply(token, asked, encode(self._header(asked, now), reply))
                case Refuse(token, why):
                    asked = self._asked.pop(token, None)
                    if asked is not None:
                        yield ReplyError(token, asked, why)
                case _:
                    yield effect

    def _side_of(self, topic: Topic) -> Side:
        sides = self._interface.sides
        return sides[0] if len(sides) == 1 else topic.sides[0]

    def _header(self, topic: Topic, now: MissionTime) -> Header:
        sequence = self._sequences.get(topic.name, 0)
        self._sequences[topic.name] = sequence + 1
        return Header(
            mission=self._mission,
            source=self._interface.name,
            incarnation=self._incarnation,
            sequence=sequence,
            made_at=now,
        )

    def _refuse(self, why: str) -> Note:
        self._refused += 1
        return Note(Level.WARNING, f"refused: {why}", {"refused": self._refused})

"""Custody at one end of the link: a node's sender and receiver together, in terms of actions.

What the node sends under custody is kept until the other side has it. What arrives is delivered once and in order, and
acknowledged. Each side receives the acknowledgements that the other one sends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Final

from schemas.codec import encode
from schemas.link import Acknowledgement, Direction, LinkConditions
from schemas.topics import ACK_DOWN, ACK_UP, TOPICS, Side, Topic, under_custody
from schemas.wire import Header, Wire
from services.runtime.actions import Action, Publish
from services.runtime.custody.protocol import CustodyConfig, CustodyQueueFull, MessageState
from services.runtime.custody.receiver import Arrival, CustodyReceiver, Delivery, Skip
from services.runtime.custody.sender import CustodySender, Transmit
from services.runtime.custody.stream import Transmission, made
from services.runtime.node import Cause, Interface, Level, LogRecord, SetTimer

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState

CUSTODY_TIMER: Final = "@custody"
"""Name of the host's own timer; the names of a node's timers do not begin with '@'."""

STATE_TYPES: Final[tuple[type, ...]] = (
    Arrival,
    Delivery,
    Header,
    MessageState,
    Skip,
    Transmission,
    *{topic.payload for topic in TOPICS if under_custody(topic)},
)
"""The types in the state of custody, beside plain values."""


def custody_config(link: LinkConditions, interface: Interface) -> CustodyConfig:
    """The settings of a node's custody over a link with these conditions."""
    return CustodyConfig.over(link, Direction.UP if Side.EARTH in interface.sides else Direction.DOWN)


def _unsigned(_topic: Topic, header: Header, body: Wire) -> bytes:
    return encode(header, body)


class CustodyEndpoint:
    """The custody of one node on its side of the link."""

    def __init__(
        self,
        name: str,
        side: Side,
        config: CustodyConfig | None,
        encode: Callable[[Topic, Header, Wire], bytes] = _unsigned,
    ) -> None:
        """encode: the bytes of a message of that topic."""
        up_and_down = ACK_UP, ACK_DOWN
        self.ack_topic, self._own_ack_topic = up_and_down if side is Side.MOON else reversed(up_and_down)
        """Topic of the acknowledgements that come to this side; those that it sends go the other way."""
        self._encode = encode
        self._name = name
        self._side = side
        self._mission = ""
        self._incarnation = 0
        self._sender = CustodySender(name, config)
        self._receiver = CustodyReceiver(config)
        self._acks_sent = 0
        self._timer_at: MissionTime | None = None
        self._timer_may_move = False
        """Whether anything has happened since `move_timer`."""
        self._newest: dict[tuple[str, str], tuple[MissionTime, int, int]] = {}

    @property
    def depth(self) -> int:
        """Messages that await the other side's acknowledgement."""
        return self._sender.depth

    @property
    def retransmitted(self) -> int:
        """Messages sent again so far."""
        return self._sender.retransmitted

    def start(self, mission: str, incarnation: int) -> None:
        """The process has started: acknowledgements carry this mission and incarnation from now on."""
        self._mission = mission
        self._incarnation = incarnation
        self._acks_sent = 0

    def offer(self, topic: Topic, header: Header, body: Wire, now: MissionTime) -> list[Action]:
        """Keep a message of this node, and send what may be sent."""
        self._timer_may_move = True
        held_from = self._sender.held_from(topic, header.incarnation, header.sequence)
        header = header.model_copy(update={"held_from": held_from})
        try:
            return self._publish(self._sender.offer(topic, header, self._encode(topic, header, body), now))
        except CustodyQueueFull as error:
            return [LogRecord(Level.ERROR, str(error), cause=Cause(f"{topic.name}: custody is full", self._name))]

    def objection(self, topic: Topic, header: Header, body: Any) -> str | None:
        """One line on a message that its source cannot have sent; None if there is nothing to object."""
        if isinstance(body, Acknowledgement):
            return self._sender.objection(body)
        return self._receiver.objection(topic, header) if under_custody(topic) else None

    def received(
        self, topic: Topic, header: Header, body: Any, size_bytes: int, now: MissionTime
    ) -> tuple[list[Delivery], list[Action]]:
        """The messages to deliver after a message that crossed the link, and the actions to carry out."""
        self._timer_may_move = True
        actions = self._publish(self._sender.contact(now))
        if not under_custody(topic):
            return [Delivery(topic, header, body)] if self._is_newest(topic, header, now) else [], actions
        deliveries, acks = self._receiver.received(topic, header, body, size_bytes, now)
        return deliveries, actions + self._acknowledge(acks, now)

    def _is_newest(self, topic: Topic, header: Header, now: MissionTime) -> bool:
        """Whether the message is the newest of a topic that is never repeated; an overtaken one is dropped."""
        number = made(header, now)
        if number <= self._newest.get((topic.name, header.source), (-1, -1, -1)):
            return False
        self._newest[topic.name, header.source] = number
        return True

    def acknowledged(self, ack: Acknowledgement, header: Header, now: MissionTime) -> list[Action]:
        """Drop the messages that the other side has, and repeat those that it lacks."""
        self._timer_may_move = True
        return self._publish(self._sender.acknowledged(ack, header, now))

    def timer_elapsed(self, now: MissionTime) -> list[Action]:
        """Repeat what was not acknowledged in time, and send the acknowledgements that waited."""
        self._timer_at, self._timer_may_move = None, True
        actions: list[Action] = []
        repeat_at, acknowledge_at = self._sender.next_timer(), self._receiver.next_timer()
        if repeat_at is not None and repeat_at <= now:
            actions += self._publish(self._sender.timer_elapsed(now))
        if acknowledge_at is not None and acknowledge_at <= now:
            actions += self._acknowledge(self._receiver.timer_elapsed(now), now)
        return actions

    def move_timer(self) -> list[Action]:
        """The change of the host's timer, if it has to move."""
        if not self._timer_may_move:
            return []
        self._timer_may_move = False
        times = [at for at in (self._sender.next_timer(), self._receiver.next_timer()) if at is not None]
        timer_at = min(times, default=None)
        if timer_at == self._timer_at:
            return []
        self._timer_at = timer_at
        return [SetTimer(CUSTODY_TIMER, timer_at)]

    def _publish(self, transmits: Iterable[Transmit]) -> list[Action]:
        return [Publish(transmit.topic, self._side, transmit.payload) for transmit in transmits]

    def _acknowledge(self, acks: Iterable[Acknowledgement], now: MissionTime) -> list[Action]:
        actions: list[Action] = []
        for ack in acks:
            header = Header(
                mission=self._mission,
                source=self._name,
                incarnation=self._incarnation,
                sequence=self._acks_sent,
                made_at=now,
            )
            self._acks_sent += 1
            actions.append(Publish(self._own_ack_topic, self._side, self._encode(self._own_ack_topic, header, ack)))
        return actions

    # --- checkpoints --------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """Both halves, as named parts."""
        return {
            "mission": self._mission,
            "incarnation": self._incarnation,
            "sender": self._sender.checkpoint(),
            "receiver": self._receiver.checkpoint(),
            "acks_sent": self._acks_sent,
            "timer_at": self._timer_at,
            "newest": dict(self._newest),
        }

    def restore(self, state: SavedState) -> None:
        """Restore the endpoint from this state."""
        self._mission, self._incarnation = state["mission"], state["incarnation"]
        self._sender.restore(state["sender"])
        self._receiver.restore(state["receiver"])
        self._acks_sent, self._timer_at = state["acks_sent"], state["timer_at"]
        self._newest = state["newest"]
        self._timer_may_move = True

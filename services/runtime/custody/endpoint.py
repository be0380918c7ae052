"""Custody at one end of the link: a host's outbox and inbox together, speaking in actions.

What the node sends under custody is kept until the other side has it; what comes is handed up once and in order, and
acknowledged. Each side hears the acknowledgements that the other sends its way.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from schemas.codec import encode
from schemas.link import Acknowledgement, Direction, LinkConditions
from schemas.topics import ACK_DOWN, ACK_UP, Side, Topic
from schemas.wire import Header, Wire
from services.runtime.actions import Action, Publish
from services.runtime.custody.protocol import CustodyConfig, CustodyQueueFull, under_custody
from services.runtime.custody.receiver import Ack, CustodyReceiver, Delivery
from services.runtime.custody.sender import CustodySender, Transmit
from services.runtime.node import Interface, Level, LogRecord, MissionTime, SetTimer

CUSTODY_TIMER = "@custody"
"""Name of the host's own timer; nodes name theirs without '@'."""


def custody_config(link: LinkConditions, interface: Interface) -> CustodyConfig:
    """The settings of a node's custody over a link with these conditions."""
    return CustodyConfig.over(link, Direction.UP if Side.EARTH in interface.sides else Direction.DOWN)


class CustodyEndpoint:
    """The outbox and the inbox of one node."""

    def __init__(self, name: str, side: Side, config: CustodyConfig | None) -> None:
        self.hears = ACK_UP if side is Side.MOON else ACK_DOWN
        """The acknowledgements that concern this side: on the Moon they come up, on Earth they come down."""
        self._name = name
        self._side = side
        self._mission = ""
        self._sender = CustodySender(name, config)
        self._receiver = CustodyReceiver(config)
        self._wakes_at: MissionTime | None = None
        self._acks = 0
        self._incarnation = 0
        self._newest: dict[tuple[str, str], tuple[int, int]] = {}

    @property
    def depth(self) -> int:
        """Messages that wait for the other side's acknowledgement."""
        return self._sender.depth

    @property
    def retransmitted(self) -> int:
        """Messages sent again so far."""
        return self._sender.counts.repeated

    def starts(self, mission: str, incarnation: int) -> None:
        """Acknowledgements made from now on carry this mission and incarnation."""
        self._mission = mission
        self._incarnation = incarnation
        self._acks = 0

    def offer(self, topic: Topic, header: Header, body: Wire, now: MissionTime) -> list[Action]:
        """Keep a message of this node, and send what may be sent."""
        kept_from = self._sender.held_from(topic, header.incarnation, header.sequence)
        header = header.model_copy(update={"held_from": kept_from})
        try:
            return self._sent(self._sender.offer(topic, header, encode(header, body), now))
        except CustodyQueueFull as error:
            return [LogRecord(Level.ERROR, str(error))]

    def received(
        self, topic: Topic, header: Header, body: Any, size_bytes: int, now: MissionTime
    ) -> tuple[list[Delivery], list[Action]]:
        """What to hand up of a message that crossed the link, and what to send."""
        actions = self._sent(self._sender.heard(now))
        if not under_custody(topic):
            return [Delivery(topic, header, body)] if self._is_news(topic, header) else [], actions
        deliveries, acks = self._receiver.received(topic, header, body, size_bytes, now)
        return deliveries, actions + self._acknowledged(acks, now)

    def _is_news(self, topic: Topic, header: Header) -> bool:
        """Of what is never repeated only the newest counts: one that was overtaken on the way is passed over."""
        number = (header.incarnation, header.sequence)
        if number <= self._newest.get((topic.name, header.source), (-1, -1)):
            return False
        self._newest[topic.name, header.source] = number
        return True

    def acknowledged(self, ack: Acknowledgement, header: Header, now: MissionTime) -> list[Action]:
        """Let go what the other side has, and send again what it misses."""
        return self._sent(self._sender.acknowledged(ack, header, now))

    def due(self, now: MissionTime) -> list[Action]:
        """Send again what nobody acknowledged in time, and the acknowledgements that waited."""
        self._wakes_at = None
        actions: list[Action] = []
        sender_due, receiver_due = self._sender.next_due(), self._receiver.next_due()
        if sender_due is not None and sender_due <= now:
            actions += self._sent(self._sender.due(now))
        if receiver_due is not None and receiver_due <= now:
            actions += self._acknowledged(self._receiver.due(now), now)
        return actions

    def timer(self) -> list[Action]:
        """The host's timer, where it has to be moved."""
        times = [at for at in (self._sender.next_due(), self._receiver.next_due()) if at is not None]
        wakes_at = min(times) if times else None
        if wakes_at == self._wakes_at:
            return []
        self._wakes_at = wakes_at
        return [SetTimer(CUSTODY_TIMER, wakes_at)]

    def _sent(self, transmits: Iterable[Transmit]) -> list[Action]:
        return [Publish(transmit.topic, self._side, transmit.payload) for transmit in transmits]

    def _acknowledged(self, acks: Iterable[Ack], now: MissionTime) -> list[Action]:
        actions: list[Action] = []
        for topic, body in acks:
            header = Header(
                mission=self._mission,
                source=self._name,
                incarnation=self._incarnation,
                sequence=self._acks,
                made_at=now,
            )
            self._acks += 1
            actions.append(Publish(topic, self._side, encode(header, body)))
        return actions

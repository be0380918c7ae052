"""Custody at one end of the link: a host's outbox and inbox together, speaking in actions.

What the node sends under custody is kept until the other side has it; what comes is handed up once and in order, and
acknowledged. Each side hears the acknowledgements that the other sends its way.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from schemas.link import Acknowledgement, Direction, LinkConditions
from schemas.topics import TC_ACK, TM_ACK, Side, Topic
from schemas.wire import Header, Wire, encode
from services.runtime.actions import Action, Publish
from services.runtime.custody.protocol import CustodyConfig, OutboxFull, under_custody
from services.runtime.custody.receiver import Ack, Inbox, Letter
from services.runtime.custody.sender import Outbox, Transmit
from services.runtime.node import Interface, Level, MissionTime, Note, WakeAt

CUSTODY_TIMER = "@custody"
"""Name of the host's own timer; nodes name theirs without '@'."""


def custody_config(link: LinkConditions, interface: Interface) -> CustodyConfig:
    """The settings of a node's custody over a link with these conditions."""
    return CustodyConfig.over(link, Direction.UP if Side.EARTH in interface.sides else Direction.DOWN)


class CustodyDesk:
    """The outbox and the inbox of one node."""

    def __init__(self, name: str, side: Side, config: CustodyConfig | None) -> None:
        self.hears = TM_ACK if side is Side.MOON else TC_ACK
        """The acknowledgements that concern this side: on the Moon they come up, on Earth they come down."""
        self._name = name
        self._side = side
        self._mission = ""
        self._outbox = Outbox(name, config)
        self._inbox = Inbox(config)
        self._wakes_at: MissionTime | None = None
        self._acks = 0
        self._incarnation = 0
        self._newest: dict[tuple[str, str], tuple[int, int]] = {}

    @property
    def depth(self) -> int:
        """Messages that wait for the other side's acknowledgement."""
        return self._outbox.depth

    @property
    def retransmitted(self) -> int:
        """Messages sent again so far."""
        return self._outbox.counts.repeated

    def starts(self, mission: str, incarnation: int) -> None:
        """Acknowledgements made from now on carry this mission and incarnation."""
        self._mission = mission
        self._incarnation = incarnation
        self._acks = 0

    def offer(self, topic: Topic, header: Header, body: Wire, now: MissionTime) -> list[Action]:
        """Keep a message of this node, and send what may be sent."""
        kept_from = self._outbox.held_from(topic, header.incarnation, header.sequence)
        header = header.model_copy(update={"held_from": kept_from})
        try:
            return self._sent(self._outbox.offer(topic, header, encode(header, body), now))
        except OutboxFull as error:
            return [Note(Level.ERROR, str(error))]

    def received(
        self, topic: Topic, header: Header, body: Any, size_bytes: int, now: MissionTime
    ) -> tuple[list[Letter], list[Action]]:
        """What to hand up of a message that crossed the link, and what to send."""
        actions = self._sent(self._outbox.heard(now))
        if not under_custody(topic):
            return [Letter(topic, header, body)] if self._is_news(topic, header) else [], actions
        letters, acks = self._inbox.received(topic, header, body, size_bytes, now)
        return letters, actions + self._acknowledged(acks, now)

    def _is_news(self, topic: Topic, header: Header) -> bool:
        """Of what is never repeated only the newest counts: one that was overtaken on the way is passed over."""
        number = (header.incarnation, header.sequence)
        if number <= self._newest.get((topic.name, header.source), (-1, -1)):
            return False
        self._newest[topic.name, header.source] = number
        return True

    def acknowledged(self, ack: Acknowledgement, header: Header, now: MissionTime) -> list[Action]:
        """Let go what the other side has, and send again what it misses."""
        return self._sent(self._outbox.acknowledged(ack, header, now))

    def due(self, now: MissionTime) -> list[Action]:
        """Send again what nobody acknowledged in time, and the acknowledgements that waited."""
        self._wakes_at = None
        actions: list[Action] = []
        outbox_due, inbox_due = self._outbox.next_due(), self._inbox.next_due()
        if outbox_due is not None and outbox_due <= now:
            actions += self._sent(self._outbox.due(now))
        if inbox_due is not None and inbox_due <= now:
            actions += self._acknowledged(self._inbox.due(now), now)
        return actions

    def timer(self) -> list[Action]:
        """The host's timer, where it has to be moved."""
        times = [at for at in (self._outbox.next_due(), self._inbox.next_due()) if at is not None]
        wakes_at = min(times) if times else None
        if wakes_at == self._wakes_at:
            return []
        self._wakes_at = wakes_at
        return [WakeAt(CUSTODY_TIMER, wakes_at)]

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

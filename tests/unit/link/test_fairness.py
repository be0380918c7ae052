"""A flood from one flow leaves room for the others, in the queue and in flight; `safe` always has a place."""

from __future__ import annotations

from random import Random

import pytest

from schemas.codec import encode, passed
from schemas.commands import CommandKind, Telecommand
from schemas.link import Acknowledgement, DirectionConditions, LinkConditions
from schemas.topics import ACK_UP, COMMAND, PLAN, Topic
from schemas.wire import Header
from services.link.channel import Channel, Limits
from services.link.contact import Contact
from services.link.packet import Packet, packet_of
from services.link.transmit_queue import URGENT_PLACES, TransmitQueue

START = 1_893_456_000_000_000_000


def packet(order: int, topic: Topic = COMMAND, size: int = 100) -> Packet:
    return Packet(topic, bytes(size), "ground", order, (), START, order)


def command(order: int, kind: CommandKind) -> Packet:
    header = Header(mission="m", source="ground", incarnation=1, sequence=order, made_at=START)
    return packet_of(COMMAND, encode(header, Telecommand(command_id=f"c{order}", kind=kind)), START, order)


@pytest.mark.parametrize("plan_first", [True, False])
def test_a_flood_of_higher_priority_does_not_push_a_plan_out(plan_first: bool) -> None:
    queue = TransmitQueue(10_000, 64 * 1024 * 1024)
    plan = packet(20_000, PLAN)
    if plan_first:
        queue.add(plan)
    for order in range(10_000):
        queue.add(packet(order))
    if not plan_first:
        assert plan not in queue.add(plan)
    assert plan in list(queue)
    assert len(queue) == 10_000


def test_a_flood_of_large_packets_does_not_push_a_plan_out() -> None:
    queue = TransmitQueue(10_000, 100_000)
    queue.add(packet(0, PLAN, 1_000))
    for order in range(1, 500):
        queue.add(packet(order, size=10_000))
    assert any(each.topic is PLAN for each in queue)
    assert sum(len(each.payload) for each in queue) <= 100_000


def test_safe_has_a_place_in_a_full_queue_and_is_sent_first() -> None:
    queue = TransmitQueue(100, 64 * 1024 * 1024)
    for order in range(200):
        queue.add(command(order, CommandKind.PAUSE))
    safe = command(300, CommandKind.SAFE)
    assert safe.urgent
    assert queue.add(safe) == []
    assert next(iter(queue)) is safe


def test_a_flood_of_safe_is_bounded() -> None:
    queue = TransmitQueue(100, 64 * 1024 * 1024)
    for order in range(1_000):
        queue.add(command(order, CommandKind.SAFE))
    assert len(queue) <= 100 + URGENT_PLACES


def test_a_flow_in_flight_is_bounded_and_leaves_room_for_the_others() -> None:
    conditions = DirectionConditions(one_way_light_time_s=1.0)
    limits = Limits(flying=1_000, flying_bytes=1_000_000)
    link = Channel(conditions, Contact.of(LinkConditions(), START), Random(1), limits=limits)
    for order in range(100):
        link.offer(packet(order, size=50_000), START)
    assert sum(len(flight.payload) for flight in link.flights()) <= 300_000
    link.offer(packet(1_000, PLAN), START)
    link.offer(command(1_001, CommandKind.SAFE), START)
    carried = {flight.packet.order for flight in link.flights()}
    assert {1_000, 1_001} <= carried
    link.arrived(START + 10**10)
    link.offer(packet(2_000, size=50_000), START + 10**10)
    assert len(link.flights()) == 1, "what arrived has made room"


def test_a_message_passed_as_objects_is_the_same_packet_as_one_that_is_parsed() -> None:
    header = Header(mission="m", source="ground", incarnation=2, sequence=5, made_at=9)
    ack = Acknowledgement(stream="tm/event", source="rover", incarnation=3, next_sequence=7)
    safe = Telecommand(command_id="c", kind=CommandKind.SAFE)
    for topic, body in ((ACK_UP, ack), (COMMAND, safe)):
        parsed, of_objects = (packet_of(topic, make(header, body), 9, 1) for make in (encode, passed))
        assert parsed == of_objects
    assert of_objects.urgent

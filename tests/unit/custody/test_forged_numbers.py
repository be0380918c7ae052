"""Custody against messages that another one made under the name of the source: no number holds a stream up for good."""

from __future__ import annotations

import pytest

from schemas.codec import Refused, decode, encode
from schemas.link import Acknowledgement, LinkChange
from schemas.topics import ACK_DOWN, EVENT, PLAN, STATE
from schemas.wire import Header
from services.runtime.custody.protocol import CustodyConfig
from services.runtime.custody.receiver import CustodyReceiver
from services.runtime.custody.sender import CustodySender
from tests.unit.custody.test_custody import HOUR, START, S, World, body_of


def forged(sequence: int, held_from: int | None = None, incarnation: int = 1) -> Header:
    return Header(
        mission="m", source="rover", incarnation=incarnation, sequence=sequence, made_at=START, held_from=held_from
    )


@pytest.mark.parametrize("number", [2**53, 2**62, 2**63 - 1, 10**40, -1])
@pytest.mark.parametrize("field", ["sequence", "incarnation", "held_from", "repetition"])
def test_a_number_that_no_source_reaches_is_refused(field: str, number: int) -> None:
    header = forged(5, 5).model_copy(update={field: number})
    with pytest.raises(Refused, match=field):
        decode(EVENT, encode(header, body_of(EVENT, 1)), "m")


def test_a_message_that_its_source_claims_not_to_keep_is_refused() -> None:
    header = forged(5).model_copy(update={"held_from": 6})
    with pytest.raises(Refused, match="expected held_from up to sequence 5, got 6"):
        decode(EVENT, encode(header, body_of(EVENT, 1)), "m")


def test_a_known_stream_does_not_jump() -> None:
    receiver = CustodyReceiver(CustodyConfig(max_held=100))
    assert receiver.objection(EVENT, forged(2**52)) is None, "a receiver that lost its state has nothing to compare"
    receiver.received(EVENT, forged(0, 0), body_of(EVENT, 0), 100, START)
    assert receiver.objection(EVENT, forged(101, 0)) is None
    line = receiver.objection(EVENT, forged(102, 102))
    assert line == "tm/event: expected a sequence up to 101 of rover, got 102"


@pytest.mark.parametrize("when", ["before the first message", "between messages"])
@pytest.mark.parametrize("number", [3, 40, 2_000, 2**52])
def test_a_forged_skip_loses_nothing(when: str, number: int) -> None:
    world = World()
    if when == "between messages":
        world.rover.offer(EVENT, world.now)
        world.settle()
    header = forged(number, number)
    if world.ground.receiver.objection(EVENT, header) is None:
        deliveries, acks = world.ground.receiver.received(EVENT, header, body_of(EVENT, 99), 100, world.now)
        assert len(deliveries) == 1
        world.ground.acknowledge(acks, world.now)
    for _ in range(6):
        world.rover.offer(EVENT, world.now)
        world.run(world.now + 10 * S)
    world.settle(HOUR)
    genuine = [body.round for _, _, body in world.ground.delivered]
    # The forged message itself stands for the one whose number it took: only a signature can tell these two apart.
    expected = [k for k in range(6 + (when == "between messages")) if k != number]
    assert genuine == expected


def test_a_skipped_message_is_not_acknowledged() -> None:
    receiver = CustodyReceiver(CustodyConfig())
    receiver.received(EVENT, forged(7, 7), body_of(EVENT, 7), 100, START)
    assert receiver.received(EVENT, forged(3, 3), body_of(EVENT, 3), 100, START + HOUR) == ([], [])


def test_a_copy_that_was_under_way_when_its_stream_was_skipped_is_not_delivered() -> None:
    receiver = CustodyReceiver(CustodyConfig())
    receiver.received(EVENT, forged(7, 7), body_of(EVENT, 7), 100, START)
    for repetition in range(4):
        late = forged(3, 3).model_copy(update={"repetition": repetition})
        assert receiver.received(EVENT, late, body_of(EVENT, 3), 100, START + 5 * S)[0] == []


def test_an_acknowledgement_of_what_was_never_sent_is_refused_and_changes_nothing() -> None:
    world = World()
    world.relay.change(LinkChange(loss=1.0), world.now)
    world.rover.offer(EVENT, world.now)
    sender: CustodySender = world.rover.sender
    before = sender.checkpoint()
    ack = Acknowledgement(stream=EVENT.name, source="rover", incarnation=1, next_sequence=2)
    assert sender.objection(ack) == "acknowledgement of tm/event: expected at most the 1 messages that were sent, got 2"
    assert sender.checkpoint() == before
    world.relay.change(LinkChange(loss=0.0), world.now)
    world.settle()
    world.check()


def test_an_absurd_incarnation_in_an_acknowledgement_outdates_no_later_one() -> None:
    world = World()
    world.rover.offer(EVENT, world.now)
    stale = Acknowledgement(stream=EVENT.name, source="rover", incarnation=1, next_sequence=0)
    header = Header(mission="m", source="ground", incarnation=2**52, sequence=2**52, made_at=2**62)
    world.rover.transmit(world.rover.sender.acknowledged(stale, header, world.now))
    world.settle()
    world.check()
    assert world.repeated == 0


@pytest.mark.parametrize("gaps", [((2, 1),), ((0, 9),), ((3, 4), (1, 2)), ((1, 3), (3, 4))])
def test_an_acknowledgement_whose_gaps_contradict_themselves_is_refused(gaps: tuple[tuple[int, int], ...]) -> None:
    ack = Acknowledgement(stream=PLAN.name, source="ground", incarnation=1, next_sequence=6)
    payload = encode(forged(0).model_copy(update={"source": "rover"}), ack.model_copy(update={"gaps": gaps}))
    with pytest.raises(Refused, match="expected gaps in order below 6"):
        decode(ACK_DOWN, payload, "m")


def test_held_messages_of_forged_incarnations_leave_room_for_the_genuine_stream() -> None:
    config = CustodyConfig(max_held_bytes=1_000)
    receiver = CustodyReceiver(config)
    for incarnation in range(2, 2_000):
        receiver.received(EVENT, forged(5, 0, incarnation), body_of(EVENT, 5), 400, START)
    assert len(receiver.checkpoint()["streams"]) <= 16
    receiver.received(EVENT, forged(1, 0), body_of(EVENT, 1), 900, START)
    streams = receiver.checkpoint()["streams"]
    assert sum(stream["held_bytes"] for stream in streams.values()) <= 1_000
    ready, _ = receiver.received(EVENT, forged(0, 0), body_of(EVENT, 0), 900, START)
    assert [delivery.header.sequence for delivery in ready] == [0, 1]


def test_streams_of_other_topics_are_not_dropped_for_forged_incarnations() -> None:
    assert STATE.name != EVENT.name
    receiver = CustodyReceiver()
    receiver.received(PLAN, Header(mission="m", source="ground", incarnation=1, sequence=0, made_at=0), None, 1, START)
    for incarnation in range(2, 200):
        receiver.received(EVENT, forged(0, 0, incarnation), body_of(EVENT, 0), 1, START)
    assert any(topic is PLAN for topic, _, _ in receiver.checkpoint()["streams"])

"""One direction of the link: arrivals to the nanosecond, contact, bounded queues, and random impairments."""

from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.codec import encode
from schemas.link import AtEdge, DirectionConditions, DutyCycle, LinkChange, LinkConditions, Window
from schemas.topics import COMMAND, EVENT, PLAN, SAMPLE, STATE, Latest, Topic
from schemas.wire import Header
from services.link.channel import Channel, Limits, transmission_time
from services.link.contact import Contact
from services.link.counts import DropReason
from services.link.packet import Packet, packet_of

START = 1_893_456_000_000_000_000
S = 1_000_000_000
PERFECT = DirectionConditions(one_way_light_time_s=1.282)


def packet(order: int, topic: Topic = SAMPLE, size: int = 100, at: int = START) -> Packet:
    subject = (topic.name, "rover") if isinstance(topic.service, Latest) else ()
    return Packet(topic, bytes(size), "rover", order, subject, at, order)


def channel(
    conditions: DirectionConditions = PERFECT,
    contact: LinkConditions | None = None,
    at_edge: AtEdge = AtEdge.HOLD,
    limits: Limits | None = None,
    seed: int = 1,
) -> Channel:
    return Channel(conditions, Contact.of(contact or LinkConditions(), START), Random(seed), at_edge, limits)


def arrivals(link: Channel, until: int = START + 10**15) -> list[tuple[int, int]]:
    """(sequence, arrival) of every packet; the channel is called only at its own next events."""
    found: list[tuple[int, int]] = []
    for _ in range(100_000):
        event = link.next_event()
        if event is None or event > until:
            return found
        found += [(flight.packet.sequence, flight.arrives_at) for flight in link.arrived(event)]
    raise AssertionError("the channel has a next event for ever")


def test_a_packet_arrives_one_light_time_after_its_last_bit_was_sent_to_the_nanosecond() -> None:
    link = channel(DirectionConditions(one_way_light_time_s=1.282, rate_bit_s=125.0))
    link.offer(packet(1, size=33), START + 7)
    assert arrivals(link) == [(1, START + 7 + 33 * 8 * S // 125 + 1_282_000_000)]


def test_nothing_arrives_before_its_time() -> None:
    link = channel()
    link.offer(packet(1), START)
    assert link.arrived(START + 1_281_999_999) == []
    assert [flight.packet.sequence for flight in link.arrived(START + 1_282_000_000)] == [1]


def test_packets_are_sent_one_after_the_other() -> None:
    link = channel(DirectionConditions(one_way_light_time_s=0.0, rate_bit_s=800.0))
    for order in range(1, 4):
        link.offer(packet(order, size=100), START)
    assert arrivals(link) == [(1, START + S), (2, START + 2 * S), (3, START + 3 * S)]


def test_waiting_packets_are_sent_by_priority_and_then_in_order() -> None:
    link = channel(DirectionConditions(one_way_light_time_s=0.0, rate_bit_s=800.0))
    for order, topic in enumerate([STATE, SAMPLE, EVENT, PLAN, COMMAND, SAMPLE]):
        link.offer(packet(order, topic), START)
    assert [sequence for sequence, _ in arrivals(link)] == [0, 4, 2, 3, 1, 5]


def test_a_newer_state_replaces_the_one_that_waits() -> None:
    link = channel(DirectionConditions(one_way_light_time_s=0.0, rate_bit_s=800.0))
    for order in range(5):
        link.offer(packet(order, STATE), START + order)
    assert [sequence for sequence, _ in arrivals(link)] == [0, 4]
    assert link.counts.superseded == 3
    assert {drop.reason for drop in link.drops()} == {DropReason.SUPERSEDED}


def test_a_late_call_changes_no_arrival() -> None:
    conditions = DirectionConditions(one_way_light_time_s=1.0, rate_bit_s=800.0)
    contact = LinkConditions(windows=(Window(opens_s=10, closes_s=12), Window(opens_s=20, closes_s=40)))
    punctual, late = channel(conditions, contact), channel(conditions, contact)
    for link in (punctual, late):
        for order in range(5):
            link.offer(packet(order), START + order)
    at_last = [(flight.packet.sequence, flight.arrives_at) for flight in late.arrived(START + 1000 * S)]
    assert arrivals(punctual) == at_last
    assert at_last == [(k, START + t * S) for k, t in [(0, 12), (1, 13), (2, 22), (3, 23), (4, 24)]]


def test_a_packet_that_does_not_fit_into_the_window_waits_while_a_smaller_one_is_sent() -> None:
    contact = LinkConditions(windows=(Window(opens_s=0, closes_s=2), Window(opens_s=10, closes_s=20)))
    link = channel(DirectionConditions(one_way_light_time_s=0.0, rate_bit_s=800.0), contact)
    link.offer(packet(1, PLAN, size=300), START)
    link.offer(packet(2, STATE, size=200), START)
    assert arrivals(link) == [(2, START + 2 * S), (1, START + 13 * S)]


def test_a_packet_longer_than_any_window_is_sent_in_parts() -> None:
    contact = LinkConditions(duty_cycle=DutyCycle(period_s=10, contact_s=1))
    link = channel(DirectionConditions(one_way_light_time_s=0.5, rate_bit_s=800.0), contact)
    link.offer(packet(1, size=350), START)
    assert arrivals(link) == [(1, START + 30 * S + S // 2 + S // 2)]


def test_with_hold_the_waiting_packets_are_sent_when_contact_begins() -> None:
    link = channel(contact=LinkConditions(windows=(Window(opens_s=100, closes_s=200),)))
    for order in range(3):
        link.offer(packet(order), START + order * S)
    assert link.next_event() == START + 100 * S
    assert arrivals(link) == [(k, START + 100 * S + 1_282_000_000) for k in range(3)]


def test_with_hold_and_no_contact_to_come_a_packet_waits_without_a_next_event() -> None:
    link = channel(contact=LinkConditions(windows=(Window(opens_s=0, closes_s=1),)))
    link.offer(packet(1), START + 5 * S)
    assert link.next_event() is None
    assert link.counts.waiting == 1


def test_with_drop_the_waiting_packets_are_dropped_when_contact_ends() -> None:
    contact = LinkConditions(windows=(Window(opens_s=1, closes_s=3),))
    link = channel(DirectionConditions(one_way_light_time_s=0.0, rate_bit_s=800.0), contact, AtEdge.DROP)
    link.offer(packet(1), START)
    for order in range(2, 6):
        link.offer(packet(order), START + S)
    assert arrivals(link) == [(2, START + 2 * S), (3, START + 3 * S)]
    drops = link.drops()
    assert [(drop.packet.sequence, drop.at) for drop in drops] == [(1, START), (4, START + 3 * S), (5, START + 3 * S)]
    assert {drop.reason for drop in drops} == {DropReason.OUT_OF_CONTACT}
    assert link.counts.dropped_out_of_contact == 3


def test_a_change_applies_to_packets_sent_after_it() -> None:
    link = channel(DirectionConditions(one_way_light_time_s=5.0, rate_bit_s=800.0))
    always = Contact.of(LinkConditions(), START)
    link.offer(packet(1), START)
    link.offer(packet(2), START)
    link.change(DirectionConditions(one_way_light_time_s=1.0, rate_bit_s=1600.0), always, AtEdge.HOLD, START + S // 2)
    assert arrivals(link) == [(2, START + S + S // 2 + S), (1, START + S + 5 * S)]


def test_a_blackout_does_not_change_packets_in_flight() -> None:
    link = channel()
    link.offer(packet(1), START)
    link.change(PERFECT, Contact.of(LinkConditions(), START, forced=False), AtEdge.HOLD, START + S)
    link.offer(packet(2), START + S)
    assert arrivals(link) == [(1, START + 1_282_000_000)]
    link.change(PERFECT, Contact.of(LinkConditions(), START), AtEdge.HOLD, START + 9 * S)
    assert arrivals(link) == [(2, START + 9 * S + 1_282_000_000)]


def test_a_full_queue_drops_packets_of_the_lowest_priority() -> None:
    contact = LinkConditions(windows=(Window(opens_s=100, closes_s=200),))
    link = channel(contact=contact, limits=Limits(waiting=2))
    for order, topic in enumerate([SAMPLE, SAMPLE, COMMAND, SAMPLE]):
        link.offer(packet(order, topic), START)
    drops = link.drops()
    assert [(drop.packet.sequence, drop.reason) for drop in drops] == [
        (1, DropReason.QUEUE_FULL),
        (3, DropReason.QUEUE_FULL),
    ]
    assert [sequence for sequence, _ in arrivals(link)] == [2, 0]


def test_a_queue_that_is_full_in_bytes_drops_packets_too() -> None:
    contact = LinkConditions(windows=(Window(opens_s=100, closes_s=200),))
    link = channel(contact=contact, limits=Limits(waiting_bytes=250))
    for order in range(4):
        link.offer(packet(order), START)
    assert link.counts.dropped_queue_full == 2
    assert link.counts.waiting == 2


def test_loss_duplication_and_corruption_occur_at_the_configured_rates() -> None:
    conditions = DirectionConditions(one_way_light_time_s=1.0, loss=0.3, duplicate=0.1, corrupt=0.2)
    link = channel(conditions)
    for order in range(10_000):
        link.offer(packet(order), START + order)
    flights = link.arrived(START + 100 * S)
    counts = link.counts
    assert counts.lost == pytest.approx(3000, abs=150)
    assert counts.duplicated == pytest.approx(700, abs=90)
    assert counts.corrupted == pytest.approx(1400, abs=130)
    assert sum(flight.payload != flight.packet.payload for flight in flights) >= counts.corrupted
    assert {len(flight.payload) for flight in flights} == {100}


def test_jitter_alone_keeps_the_order_and_reordering_does_not() -> None:
    def order_of(reorder: float) -> list[int]:
        link = channel(DirectionConditions(one_way_light_time_s=1.0, jitter_s=0.3, reorder=reorder))
        for order in range(500):
            link.offer(packet(order), START + order * S // 100)
        found = arrivals(link)
        assert all(
            0.7 * S <= at - (START + order * S // 100) <= (2.3 if reorder else 1.3) * S + 0.6 * S for order, at in found
        )
        return [order for order, _ in found]

    assert order_of(0.0) == sorted(range(500))
    shuffled = order_of(0.2)
    assert shuffled != sorted(shuffled)
    assert sorted(shuffled) == list(range(500))


def test_the_same_seed_gives_the_same_impairments_and_another_seed_gives_others() -> None:
    conditions = DirectionConditions(one_way_light_time_s=1.0, jitter_s=0.5, loss=0.3, duplicate=0.1, reorder=0.2)

    def run(seed: int) -> list[tuple[int, int]]:
        link = channel(conditions, seed=seed)
        for order in range(200):
            link.offer(packet(order), START + order * S)
        return arrivals(link)

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_changing_one_condition_leaves_the_draws_for_the_others_as_they_were() -> None:
    def lost(duplicate: float, corrupt: float) -> set[int]:
        link = channel(DirectionConditions(loss=0.3, duplicate=duplicate, corrupt=corrupt))
        for order in range(300):
            link.offer(packet(order), START + order)
        return {drop.packet.sequence for drop in link.drops()}

    assert lost(0.0, 0.0) == lost(0.5, 0.5)


@given(size=st.integers(0, 10**7), rate=st.floats(1, 1e12))
def test_transmission_time_is_rounded_up_to_a_whole_nanosecond(size: int, rate: float) -> None:
    numerator, denominator = rate.as_integer_ratio()
    duration = transmission_time(size, rate)
    assert duration * numerator >= size * S * denominator
    assert (duration - 1) * numerator < size * S * denominator


offers = st.lists(
    st.tuples(st.integers(0, 40), st.integers(1, 400), st.sampled_from([COMMAND, PLAN, SAMPLE, STATE])), max_size=30
)


@given(
    offers=offers,
    rate=st.sampled_from([None, 100.0, 1000.0]),
    loss=st.sampled_from([0.0, 0.3]),
    reorder=st.sampled_from([0.0, 0.3]),
    at_edge=st.sampled_from(AtEdge),
    contact_s=st.integers(1, 10),
    windows=st.booleans(),
    late=st.integers(0, 5),
)
@settings(max_examples=200)
def test_every_packet_is_counted_and_none_arrives_early_or_is_sent_out_of_contact(
    offers: list[tuple[int, int, Topic]],
    rate: float | None,
    loss: float,
    reorder: float,
    at_edge: AtEdge,
    contact_s: int,
    windows: bool,
    late: int,
) -> None:
    conditions = DirectionConditions(one_way_light_time_s=2.0, rate_bit_s=rate, loss=loss, reorder=reorder)
    cycle = LinkConditions(duty_cycle=DutyCycle(period_s=10, contact_s=contact_s)) if windows else LinkConditions()
    contact = Contact.of(cycle, START)
    link = channel(conditions, cycle, at_edge)
    flights = []
    now = START
    for order, (wait, size, topic) in enumerate(offers):
        now += wait * S // 7
        link.offer(packet(order, topic, size, now), now)
        flights += link.arrived(now)
    for _ in range(10_000):
        event = link.next_event()
        if event is None:
            break
        now = max(now, event) + late * S // 3
        flights += link.arrived(now)
    counts = link.counts
    gone = counts.lost + counts.dropped_out_of_contact + counts.dropped_queue_full + counts.superseded
    assert counts.offered == len(offers)
    assert counts.offered + counts.duplicated == counts.delivered + gone + counts.waiting + counts.in_flight
    assert counts.waiting == counts.in_flight == 0
    assert len(link.drops()) == gone
    busy_until = 0
    for flight in sorted(flights, key=lambda flight: flight.departs_at):
        duration = transmission_time(flight.packet.size_bits, rate)
        ends = contact.after(flight.departs_at, duration)
        assert ends is not None
        assert contact.open_at(flight.departs_at)
        assert flight.departs_at >= max(flight.packet.offered_at, busy_until)
        assert ends + 2 * S <= flight.arrives_at <= ends + (4 if reorder else 2) * S
        busy_until = ends


def test_a_payload_that_cannot_be_read_is_carried_too() -> None:
    for payload in (
        b"",
        b"\xff\xfe",
        b"[]",
        b'{"header":[1]}',
        b'{"header":{"source":7}}',
        b'{"header":' + b"[" * 5000,
    ):
        found = packet_of(STATE, payload, START, 1)
        assert (found.source, found.sequence, found.subject, found.payload) == ("?", 0, (), payload)


def test_a_packet_has_the_source_sequence_and_subject_of_the_encoded_message() -> None:
    from schemas.link import Acknowledgement
    from schemas.topics import ACK_UP

    header = Header(mission="m", source="ground", incarnation=2, sequence=17, made_at=START)
    ack = Acknowledgement(stream="tm/sample", source="rover", incarnation=3, next_sequence=4)
    found = packet_of(ACK_UP, encode(header, ack), START, 1)
    assert (found.source, found.sequence) == ("ground", 17)
    assert found.subject == ("tc/ack", "ground", "tm/sample", "rover", "3")


def test_the_repetition_of_a_message_under_custody_never_waits_twice() -> None:
    payload = b'{"header":{"source":"rover","incarnation":1,"sequence":4},"body":{}}'
    other = payload.replace(b'"incarnation":1', b'"incarnation":2')
    link = channel(contact=LinkConditions(windows=(Window(opens_s=100, closes_s=200),)))
    for order, copy in enumerate([payload, payload, other, payload]):
        link.offer(packet_of(SAMPLE, copy, START, order), START)
    assert [flight.payload for flight in link.arrived(START + 300 * S)] == [payload, other]


def test_a_message_under_custody_that_is_offered_again_is_counted_as_a_repetition() -> None:
    link = channel()
    for sequence in (0, 1, 1, 2, 0):
        payload = encode(Header(mission="m", source="rover", incarnation=1, sequence=sequence, made_at=0), LinkChange())
        link.offer(packet_of(SAMPLE, payload, START, sequence), START)
        link.offer(packet_of(STATE, payload, START, sequence), START)
    assert (link.counts.offered, link.counts.repeated) == (10, 2)


def test_the_same_sequence_of_another_incarnation_is_not_a_repetition() -> None:
    link = channel()
    for incarnation in (1, 2):
        payload = encode(
            Header(mission="m", source="rover", incarnation=incarnation, sequence=0, made_at=0), LinkChange()
        )
        link.offer(packet_of(SAMPLE, payload, START, 0), START)
    assert link.counts.repeated == 0

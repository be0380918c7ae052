"""Both halves of custody over the real link: each message is delivered once and in order, under any faults."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.errors import He3Error, InvalidInput
from schemas.codec import Refused, decode, encode
from schemas.commands import CommandKind, CommandReport, CommandStage, Telecommand
from schemas.link import Acknowledgement, AtEdge, Direction, DirectionConditions, LinkChange, LinkConditions
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import ACK_DOWN, ACK_UP, COMMAND, COMMAND_REPORT, EVENT, MEASURE, PLAN, STATE, Topic, under_custody
from schemas.wire import Header, Wire
from services.link.relay import Relay
from services.mission.link_presets import PRESETS
from services.runtime.custody.endpoint import STATE_TYPES
from services.runtime.custody.protocol import (
    TRANSITIONS,
    CustodyConfig,
    CustodyQueueFull,
    MessageState,
    Signal,
    next_state,
)
from services.runtime.custody.receiver import CustodyReceiver
from services.runtime.custody.retransmission import RoundTrip
from services.runtime.custody.sender import CustodySender, Transmit
from services.runtime.state_codec import StateCodec

START = 1_893_456_000_000_000_000
S = 1_000_000_000
HOUR = 3600 * S


def body_of(topic: Topic, number: int, size: int = 0) -> Wire:
    if topic is COMMAND:
        return Telecommand(command_id=f"c{number}", kind=CommandKind.PAUSE)
    if topic is COMMAND_REPORT:
        return CommandReport(command_id=f"c{number}", stage=CommandStage.RECEIVED, at=START, why="x" * size)
    return RoverEvent(kind=EventKind.PARKED, at=START, x_m=0.0, y_m=0.0, round=number, detail="x" * size)


CODEC = StateCodec(STATE_TYPES)


@dataclass
class Station:
    """One side: a sender, a receiver, and what was offered and delivered over all its starts."""

    name: str
    sends: Direction
    config: CustodyConfig
    publish: Callable[[Topic, bytes], None]
    incarnation: int = 0
    offered: list[tuple[Topic, Header, bytes]] = field(default_factory=list)
    delivered: list[tuple[Topic, Header, Any]] = field(default_factory=list)
    sent: int = 0

    def start(self) -> None:
        """Start, or restart with no state but the messages that await acknowledgement."""
        self.incarnation += 1
        self.sequences: Counter[str] = Counter()
        self.receiver = CustodyReceiver(self.config)
        if self.incarnation == 1:
            self.sender = CustodySender(self.name, self.config)

    def restart(self) -> None:
        """Restart from a checkpoint."""
        self.incarnation += 1
        self.sequences = Counter()
        self.reload()

    def reload(self) -> None:
        """Replace sender and receiver by ones restored from a checkpoint."""
        sender, receiver = CODEC.decode(CODEC.encode((self.sender.checkpoint(), self.receiver.checkpoint())))
        self.sender, self.receiver = CustodySender(self.name, self.config), CustodyReceiver(self.config)
        self.sender.restore(sender)
        self.receiver.restore(receiver)

    def header(self, topic: Topic, now: int, held_from: int | None = None) -> Header:
        sequence = self.sequences[topic.name]
        self.sequences[topic.name] += 1
        return Header(
            mission="m",
            source=self.name,
            incarnation=self.incarnation,
            sequence=sequence,
            made_at=now,
            held_from=held_from,
        )

    def offer(self, topic: Topic, now: int, size: int = 0) -> None:
        held_from = self.sender.held_from(topic, self.incarnation, self.sequences[topic.name])
        header = self.header(topic, now, held_from)
        payload = encode(header, body_of(topic, len(self.offered), size))
        self.offered.append((topic, header, payload))
        self.transmit(self.sender.offer(topic, header, payload, now))

    def transmit(self, transmits: list[Transmit]) -> None:
        self.sent += len(transmits)
        for transmit in transmits:
            self.publish(transmit.topic, transmit.payload)

    def acknowledge(self, acks: list[Acknowledgement], now: int) -> None:
        topic = ACK_UP if self.sends is Direction.UP else ACK_DOWN
        for ack in acks:
            self.publish(topic, encode(self.header(topic, now), ack))

    def receive(self, topic: Topic, payload: bytes, now: int) -> None:
        try:
            header, body = decode(topic, payload, "m")
        except Refused:
            return
        if isinstance(body, Acknowledgement):
            if self.sender.objection(body) is not None:
                return
            self.transmit(self.sender.acknowledged(body, header, now))
            return
        if under_custody(topic) and self.receiver.objection(topic, header) is not None:
            return
        self.transmit(self.sender.contact(now))
        if under_custody(topic):
            deliveries, acks = self.receiver.received(topic, header, body, len(payload), now)
            self.delivered += [(delivery.topic, delivery.header, delivery.body) for delivery in deliveries]
            self.acknowledge(acks, now)

    def next_timer(self) -> int | None:
        times = [time for time in (self.sender.next_timer(), self.receiver.next_timer()) if time is not None]
        return min(times, default=None)

    def timer_elapsed(self, now: int) -> None:
        if (time := self.sender.next_timer()) is not None and time <= now:
            self.transmit(self.sender.timer_elapsed(now))
        if (time := self.receiver.next_timer()) is not None and time <= now:
            self.acknowledge(self.receiver.timer_elapsed(now), now)


class World:
    """Two stations and the link between them, in virtual time."""

    def __init__(self, link: LinkConditions | None = None, seed: int = 1, config: CustodyConfig | None = None) -> None:
        self.link = link or LinkConditions()
        self.now = START
        self.seed = seed
        self.relay = Relay(self.link, START, seed)
        self.published: list[tuple[Topic, bytes]] = []
        up, down = (config or CustodyConfig.over(self.link, way) for way in (Direction.UP, Direction.DOWN))
        self.ground = Station("ground", Direction.UP, up, self.publish)
        self.rover = Station("rover", Direction.DOWN, down, self.publish)
        self.state_period: int | None = None
        self.state_at = START
        for station in self.stations:
            station.start()

    @property
    def stations(self) -> tuple[Station, Station]:
        return self.ground, self.rover

    def publish(self, topic: Topic, payload: bytes) -> None:
        self.published.append((topic, payload))
        self.relay.offer(topic, payload, self.now)

    def lose_link(self) -> None:
        """The link's process dies, with all that is under way."""
        self.seed += 1
        self.relay = Relay(self.link, START, self.seed)

    def instant(self) -> int | None:
        times = [self.relay.next_event(), *(station.next_timer() for station in self.stations)]
        times.append(self.state_at if self.state_period else None)
        return min((time for time in times if time is not None), default=None)

    def run(self, until: int, stop: Callable[[], bool] = lambda: False) -> None:
        for _ in range(200_000):
            instant = self.instant()
            if stop() or instant is None or instant > until:
                self.now = self.now if stop() else until
                return
            self.now = max(self.now, instant)
            if self.state_period and self.state_at <= self.now:
                self.state_at = self.now + self.state_period
                self.publish(STATE, b'{"header":{"source":"rover"}}')
                if self.relay.in_contact(self.now):
                    self.ground.transmit(self.ground.sender.contact(self.now))
            for direction, flight in self.relay.arrived(self.now):
                station = self.rover if direction is Direction.UP else self.ground
                station.receive(flight.packet.topic, flight.payload, self.now)
            for station in self.stations:
                station.timer_elapsed(self.now)
        raise AssertionError("no end in sight")

    def settle(self, within: int = 100 * HOUR) -> None:
        self.run(self.now + within, self.settled)
        assert self.settled(), (self.ground.sender.depth, self.rover.sender.depth, self.now - START)

    def settled(self) -> bool:
        return all(station.sender.depth == 0 for station in self.stations)

    def check(self) -> None:
        """Fail unless each message was delivered once, and each topic in order."""
        for sender, receiver in ((self.ground, self.rover), (self.rover, self.ground)):
            for topic in (COMMAND, COMMAND_REPORT, EVENT):
                sent = [(header.incarnation, header.sequence) for at, header, _ in sender.offered if at is topic]
                got = [(header.incarnation, header.sequence) for at, header, _ in receiver.delivered if at is topic]
                assert got == sent, topic.name

    @property
    def repeated(self) -> int:
        return sum(station.sender.retransmitted for station in self.stations)


def both_ways(**conditions: Any) -> LinkConditions:
    return LinkConditions(up=DirectionConditions(**conditions), down=DirectionConditions(**conditions))


# --- without loss -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("light_time_s", [0.0, 1.282, 5.0, 1200.0])
@pytest.mark.parametrize("rate", [None, 2000.0, 125.0])
def test_without_loss_nothing_is_repeated_and_every_message_takes_its_light_time(
    light_time_s: float, rate: float | None
) -> None:
    world = World(both_ways(one_way_light_time_s=light_time_s, rate_bit_s=rate))
    for k in range(40):
        world.rover.offer(EVENT, world.now)
        if k % 5 == 0:
            world.ground.offer(COMMAND, world.now)
            world.rover.offer(COMMAND_REPORT, world.now)
        world.run(world.now + 200 * S)
    world.settle()
    world.check()
    assert world.repeated == 0
    assert (len(world.rover.delivered), len(world.ground.delivered)) == (8, 48)


@pytest.mark.parametrize(
    ("name", "most"), [("nominal", 0), ("zero", 0), ("agency-8s", 0), ("csa-10s", 0), ("mars", 0), ("farside-relay", 5)]
)
def test_a_burst_over_a_link_of_known_conditions_needs_no_repetition(name: str, most: int) -> None:
    """At 125 bit/s, acknowledgements wait behind ten minutes of commands, which their receiver cannot know."""
    world = World(PRESETS[name])
    for _ in range(30):
        world.rover.offer(EVENT, world.now, size=400)
        world.ground.offer(COMMAND, world.now)
    world.settle()
    world.check()
    assert world.repeated <= most


def test_a_burst_beyond_the_window_goes_out_in_order_as_acknowledgements_come() -> None:
    config = CustodyConfig(window_messages=8)
    world = World(config=config)
    for _ in range(100):
        world.rover.offer(EVENT, world.now)
    assert world.rover.sent == 8
    world.settle()
    world.check()
    assert world.repeated == 0


def test_large_messages_arrive_over_a_slow_link_whose_rate_is_not_known() -> None:
    world = World(both_ways(rate_bit_s=8_000.0), config=CustodyConfig())
    for _ in range(100):
        world.rover.offer(EVENT, world.now, size=500)
    world.settle()
    world.check()
    assert world.repeated <= 3


def test_acknowledgements_of_a_burst_are_few() -> None:
    world = World()
    for _ in range(200):
        world.rover.offer(EVENT, world.now)
    before = len(world.published)
    world.settle()
    assert len(world.published) - before <= 3


# --- with loss --------------------------------------------------------------------------------------------------


def test_a_gap_is_filled_one_round_trip_after_it_shows() -> None:
    world = World()
    world.rover.offer(EVENT, world.now)
    world.settle()
    world.relay.change(LinkChange(loss=1.0), world.now)
    world.rover.offer(EVENT, world.now)
    world.relay.change(LinkChange(loss=0.0), world.now)
    began = world.now
    world.rover.offer(EVENT, world.now)
    world.run(world.now + HOUR, lambda: len(world.rover.offered) == len(world.ground.delivered))
    assert world.now - began == 3 * 1_282_000_000
    assert world.repeated == 1
    world.settle()
    world.check()


def test_a_lost_last_message_comes_one_wait_and_one_light_time_later() -> None:
    world = World(config=CustodyConfig(round_trip_s=2.564, margin_s=1.0))
    world.relay.change(LinkChange(loss=1.0), world.now)
    world.rover.offer(EVENT, world.now)
    world.relay.change(LinkChange(loss=0.0), world.now)
    world.run(world.now + HOUR, lambda: bool(world.ground.delivered))
    assert world.now - START == 2_564_000_000 + S + 1_282_000_000


@pytest.mark.parametrize("loss", [0.1, 0.3, 0.6])
def test_heavy_loss_costs_a_bounded_number_of_repetitions(loss: float) -> None:
    world = World(both_ways(loss=loss))
    for _ in range(200):
        world.rover.offer(EVENT, world.now)
        world.ground.offer(COMMAND, world.now)
        world.run(world.now + 20 * S)
    world.settle()
    world.check()
    needed = 400 * (1 / (1 - loss) ** 2 - 1)  # each sending and each acknowledgement may be lost
    assert world.repeated <= 1.3 * needed + 10


# --- blackouts --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at_edge", list(AtEdge))
@pytest.mark.parametrize("light_time_s", [1.282, 600.0])
def test_a_blackout_suspends_the_timers_and_any_message_resumes_them(at_edge: AtEdge, light_time_s: float) -> None:
    world = World(both_ways(one_way_light_time_s=light_time_s).model_copy(update={"at_edge": at_edge}))
    world.state_period = 60 * S
    world.run(world.now + S)
    world.relay.change(LinkChange(contact=False), world.now)
    for _ in range(20):
        world.rover.offer(EVENT, world.now)
        world.ground.offer(COMMAND, world.now)
        world.run(world.now + 600 * S)
    light = round(light_time_s * S)
    world.run(world.now + 100 * (2 * light + 5 * S))
    assert world.rover.sender.suspended
    assert world.ground.sender.suspended
    silent_s = (world.now - START) / S
    assert world.repeated <= 2 * (silent_s / max(300.0, 4 * light_time_s) + 6)
    world.relay.change(LinkChange(contact=True), world.now)
    regained = world.now
    world.settle()
    world.check()
    assert world.now - regained < 60 * S + 10 * light + 20 * S
    assert not world.rover.sender.suspended


def test_a_suspended_sender_probes_with_one_message_and_never_gives_up() -> None:
    world = World()
    world.relay.change(LinkChange(contact=False, at_edge=AtEdge.DROP), world.now)
    for _ in range(5):
        world.rover.offer(EVENT, world.now)
    world.run(world.now + 24 * HOUR)
    sender = world.rover.sender
    assert sender.suspended
    assert sender.depth == 5
    assert 24 * 12 - 2 <= sender.retransmitted <= 24 * 12 + 6
    world.relay.change(LinkChange(contact=True), world.now)
    world.settle(within=HOUR)
    world.check()


def test_a_sender_that_receives_messages_is_never_suspended() -> None:
    world = World(LinkConditions(up=DirectionConditions(loss=1.0)))
    world.ground.offer(COMMAND, world.now)
    world.state_period = 30 * S
    world.run(world.now + HOUR)
    assert not world.ground.sender.suspended
    assert 20 <= world.ground.sender.retransmitted <= 32


def test_a_rate_that_collapses_is_measured_and_leads_to_few_repetitions() -> None:
    world = World(both_ways(rate_bit_s=100_000.0))
    world.rover.offer(EVENT, world.now)
    world.settle()
    world.relay.change(LinkChange(rate_bit_s=125.0), world.now)
    for _ in range(60):
        world.rover.offer(EVENT, world.now)
        world.run(world.now + 100 * S)
    world.settle()
    world.check()
    assert world.repeated <= 15


def test_a_light_time_that_jumps_is_measured() -> None:
    world = World()
    world.state_period = 60 * S
    world.relay.change(LinkChange(one_way_light_time_s=600.0), world.now)
    costs = []
    for _ in range(12):
        before = world.repeated
        world.rover.offer(EVENT, world.now)
        world.run(world.now + 2 * HOUR)
        costs.append(world.repeated - before)
    world.settle()
    world.check()
    assert costs[-3:] == [0, 0, 0]
    assert sum(costs) < 60


# --- anything ---------------------------------------------------------------------------------------------------

steps = st.lists(
    st.tuples(
        st.sampled_from([0, 1, 200_000_000, S, 3 * S, 70 * S, 1000 * S]),
        st.sampled_from(
            ["event", "event", "event", "report", "command", "command", "burst", "ground restarts", "rover restarts",
             "link restarts", "blackout", "contact", "lossy", "clean"]
        ),
    ),
    max_size=40,
)  # fmt: skip


@given(
    steps=steps,
    seed=st.integers(0, 2**32),
    loss=st.sampled_from([0.0, 0.3, 0.5]),
    corrupt=st.sampled_from([0.0, 0.2]),
    duplicate=st.sampled_from([0.0, 0.3]),
    reorder=st.sampled_from([0.0, 0.5]),
    light_time_s=st.sampled_from([0.0, 1.282, 30.0]),
    rate=st.sampled_from([None, 1000.0]),
    at_edge=st.sampled_from(AtEdge),
    window=st.sampled_from([1, 4, 256]),
)
@settings(max_examples=150)
def test_each_message_is_delivered_once_and_in_order_whatever_happens(
    steps: list[tuple[int, str]],
    seed: int,
    loss: float,
    corrupt: float,
    duplicate: float,
    reorder: float,
    light_time_s: float,
    rate: float | None,
    at_edge: AtEdge,
    window: int,
) -> None:
    bad = {"loss": loss, "corrupt": corrupt, "duplicate": duplicate, "reorder": reorder}
    link = both_ways(one_way_light_time_s=light_time_s, rate_bit_s=rate, jitter_s=0.1, **bad)
    link = link.model_copy(update={"at_edge": at_edge})
    config = replace(CustodyConfig.over(link, Direction.UP), window_messages=window)
    world = World(link, seed, config)
    world.state_period = 300 * S
    for wait, step in steps:
        world.run(world.now + wait)
        match step:
            case "event":
                world.rover.offer(EVENT, world.now)
            case "report":
                world.rover.offer(COMMAND_REPORT, world.now, size=100)
            case "command":
                world.ground.offer(COMMAND, world.now)
            case "burst":
                for _ in range(10):
                    world.rover.offer(EVENT, world.now)
            case "ground restarts":
                world.ground.restart()
            case "rover restarts":
                world.rover.restart()
            case "link restarts":
                world.lose_link()
            case "blackout":
                world.relay.change(LinkChange(contact=False), world.now)
            case "contact":
                world.relay.change(LinkChange(contact=True), world.now)
            case "lossy":
                world.relay.change(LinkChange(**bad), world.now)
            case "clean":
                world.relay.change(LinkChange(loss=0.0, corrupt=0.0, duplicate=0.0, reorder=0.0), world.now)
    world.relay.change(LinkChange(contact=True), world.now)
    world.settle()
    world.check()


# --- restarts ---------------------------------------------------------------------------------------------------


def test_a_sender_that_restarts_from_its_checkpoint_repeats_nothing_that_arrives_in_time() -> None:
    world = World()
    for _ in range(50):
        world.rover.offer(EVENT, world.now)
    world.run(world.now + S)
    world.rover.restart()
    assert world.rover.sender.depth == 50
    world.settle()
    world.check()
    assert world.repeated == 0


def test_a_receiver_that_restarts_from_its_checkpoint_delivers_nothing_twice() -> None:
    world = World()
    world.relay.change(LinkChange(duplicate=1.0), world.now)
    for _ in range(20):
        world.rover.offer(EVENT, world.now)
        world.run(world.now + S // 10)
        world.ground.restart()
    world.settle()
    world.check()


@given(seed=st.integers(0, 2**32), window=st.sampled_from([1, 4, 256]))
@settings(max_examples=20)
def test_a_sender_and_a_receiver_restored_from_a_checkpoint_behave_as_before(seed: int, window: int) -> None:
    link = both_ways(loss=0.3, reorder=0.3, duplicate=0.2, rate_bit_s=5_000.0)
    config = replace(CustodyConfig.over(link, Direction.UP), window_messages=window)
    undisturbed, reloaded = World(link, seed, config), World(link, seed, config)
    for number in range(25):
        for world in (undisturbed, reloaded):
            world.rover.offer((EVENT, COMMAND_REPORT)[number % 2], world.now, size=20 * number)
            world.ground.offer(COMMAND, world.now)
            if number in (8, 16):
                world.relay.change(LinkChange(contact=number == 16), world.now)
            world.run(world.now + (0, S, 20 * S, 300 * S)[(seed >> number) % 4])
        reloaded.rover.reload()
        reloaded.ground.reload()
    for world in (undisturbed, reloaded):
        world.settle()

    assert reloaded.published == undisturbed.published


def test_messages_that_a_receiver_held_out_of_turn_and_forgot_are_sent_again() -> None:
    world = World()
    world.relay.change(LinkChange(loss=1.0), world.now)
    world.rover.offer(EVENT, world.now)
    world.relay.change(LinkChange(loss=0.0), world.now)
    for _ in range(5):
        world.rover.offer(EVENT, world.now)
    world.run(world.now + 1_282_000_000)
    assert world.ground.delivered == [], "the first one is missing"
    world.ground.start()
    world.settle()
    world.check()


def test_a_receiver_that_forgot_everything_delivers_what_is_not_yet_acknowledged() -> None:
    world = World()
    for _ in range(5):
        world.rover.offer(EVENT, world.now)
    world.settle()
    world.relay.change(LinkChange(contact=False, at_edge=AtEdge.DROP), world.now)
    for _ in range(3):
        world.rover.offer(EVENT, world.now)
    world.ground.delivered.clear()
    world.ground.start()
    world.relay.change(LinkChange(contact=True), world.now)
    world.settle()
    assert [header.sequence for _, header, _ in world.ground.delivered] == [5, 6, 7]


def test_messages_of_a_new_incarnation_wait_for_those_of_the_old_one() -> None:
    world = World()
    world.relay.change(LinkChange(contact=False, at_edge=AtEdge.DROP), world.now)
    for _ in range(3):
        world.ground.offer(COMMAND, world.now)
    world.ground.restart()
    world.ground.offer(COMMAND, world.now)
    world.relay.change(LinkChange(contact=True), world.now)
    world.settle()
    assert [(h.incarnation, h.sequence) for _, h, _ in world.rover.delivered] == [(1, 0), (1, 1), (1, 2), (2, 0)]


# --- the parts --------------------------------------------------------------------------------------------------


def test_every_transition_of_a_kept_message_is_in_the_table_and_any_other_is_an_error() -> None:
    reached = {MessageState.WAITING}
    for _ in MessageState:
        reached |= {after for (before, _), after in TRANSITIONS.items() if before in reached}
    assert reached == set(MessageState)
    assert all(before is not MessageState.ACKNOWLEDGED for before, _ in TRANSITIONS)
    for state, signal in product(MessageState, Signal):
        if (state, signal) in TRANSITIONS:
            assert next_state(state, signal) is TRANSITIONS[state, signal]
        else:
            with pytest.raises(He3Error, match=f"{state.value}.*{signal.value}"):
                next_state(state, signal)


def test_a_round_trip_is_measured_and_its_variation_lengthens_the_wait() -> None:
    trip = RoundTrip(2 * S, S)
    for _ in range(100):
        trip.measured(10 * S)
    assert trip.mean == pytest.approx(10 * S, abs=S // 100)
    steady = trip.wait
    for k in range(100):
        trip.measured((8 if k % 2 else 12) * S)
    assert steady == pytest.approx(11 * S, abs=S // 10)
    assert trip.wait > 16 * S


def test_only_topics_of_custody_service_that_cross_are_under_custody() -> None:
    assert under_custody(COMMAND)
    assert under_custody(EVENT)
    assert not under_custody(STATE)
    assert not under_custody(MEASURE)


def header(source: str = "rover", sequence: int = 0, incarnation: int = 1) -> Header:
    return Header(mission="m", source=source, incarnation=incarnation, sequence=sequence, made_at=START)


def test_a_full_sender_refuses_a_message_and_keeps_the_others() -> None:
    sender = CustodySender("rover", CustodyConfig(max_messages=2))
    for sequence in range(2):
        sender.offer(EVENT, header(sequence=sequence), b"x", START)
    with pytest.raises(CustodyQueueFull, match="at most 2 messages"):
        sender.offer(EVENT, header(sequence=2), b"x", START)
    assert sender.depth == 2


@pytest.mark.parametrize(
    ("topic", "source", "sequence", "says"),
    [(STATE, "rover", 5, "under custody"), (EVENT, "ground", 5, "'rover'"), (EVENT, "rover", 0, "above 0, got 0")],
)
def test_a_message_that_is_not_to_be_kept_here_is_refused(topic: Topic, source: str, sequence: int, says: str) -> None:
    sender = CustodySender("rover")
    sender.offer(EVENT, header(), b"x", START)
    with pytest.raises(InvalidInput, match=says):
        sender.offer(topic, header(source, sequence), b"x", START)
    assert sender.depth == 1


def test_commands_go_before_plans_and_events_before_samples_when_the_window_is_small() -> None:
    sender = CustodySender("ground", CustodyConfig(window_messages=1))
    first = sender.offer(PLAN, header("ground"), b"p0", START)
    sender.offer(PLAN, header("ground", 1), b"p1", START)
    sender.offer(COMMAND, header("ground", 0), b"c0", START)
    ack = Acknowledgement(stream="tc/plan", source="ground", incarnation=1, next_sequence=1, last_sequence=0)
    then = sender.acknowledged(ack, header(), START + 3 * S)
    assert [transmit.payload for transmit in (*first, *then)] == [b"p0", b"c0"]


def test_an_acknowledgement_that_a_newer_one_overtook_changes_nothing() -> None:
    sender = CustodySender("rover")
    for sequence in range(3):
        sender.offer(EVENT, header(sequence=sequence), b"x", START)
    ack = Acknowledgement(stream="tm/event", source="rover", incarnation=1, next_sequence=3)
    stale = ack.model_copy(update={"next_sequence": 2, "gaps": ((0, 0),)})
    sender.acknowledged(ack.model_copy(update={"next_sequence": 2}), header("ground", 5), START + S)
    assert sender.acknowledged(stale, header("ground", 4), START + S) == []
    assert sender.depth == 1
    others = ack.model_copy(update={"source": "field"})
    sender.acknowledged(others, header("ground", 6), START + S)
    assert sender.depth == 1


def test_an_acknowledgement_with_more_gaps_than_fit_covers_fewer_messages() -> None:
    receiver = CustodyReceiver()
    for sequence in range(1, 400, 2):
        _, acks = receiver.received(EVENT, header(sequence=sequence), None, 10, START + sequence * S)
    (ack,) = acks
    assert len(ack.gaps) == 64
    assert ack.gaps[-1] == (126, 126)
    assert ack.next_sequence == 128
    assert ack.last_sequence == 399


def test_a_receiver_without_room_neither_holds_nor_acknowledges() -> None:
    receiver = CustodyReceiver(CustodyConfig(max_held=2))
    for sequence in (1, 2):
        receiver.received(EVENT, header(sequence=sequence), None, 10, START)
    assert receiver.received(EVENT, header(sequence=3), None, 10, START + 9 * S) == ([], [])
    deliveries, _ = receiver.received(EVENT, header(sequence=0), None, 10, START)
    assert [delivery.header.sequence for delivery in deliveries] == [0, 1, 2]


def test_each_stream_of_a_topic_has_its_own_sequence() -> None:
    receiver = CustodyReceiver()
    got = [
        receiver.received(EVENT, header(source, 0, incarnation), None, 10, START)[0]
        for source, incarnation in (("rover", 1), ("rover", 2), ("other", 1), ("rover", 1))
    ]
    assert [len(deliveries) for deliveries in got] == [1, 1, 1, 0]

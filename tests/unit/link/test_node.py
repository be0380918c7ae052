"""The link's node: forwarding, changes, contact and status reports."""

from itertools import pairwise
from typing import Any, TypeVar

import pytest

from he3.errors import InvalidInput
from schemas.link import (
    Direction,
    DirectionConditions,
    DutyCycle,
    LinkChange,
    LinkConditions,
    LinkStatus,
    Window,
)
from schemas.topics import COMMAND, LINK_SET, LINK_SHOW, LINK_STATUS, MEASURE, SAMPLE, STATE, Side, crossing
from services.link.node import LinkNode, build_node
from services.link.relay import Relay, apply_change
from services.mission.link_presets import PRESETS, PROVENANCE, preset
from services.mission.scenario import Scenario
from services.runtime.node import (
    Cause,
    Effect,
    Event,
    Forward,
    Level,
    LogRecord,
    QueryReceived,
    ReceivedRaw,
    RefuseQuery,
    Send,
    SendIfHeard,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
)

START = 1_893_456_000_000_000_000
S = 1_000_000_000

E = TypeVar("E")


class Endpoint:
    """Drives a link node in virtual time, as any driver would."""

    def __init__(self, conditions: LinkConditions | None = None, seed: int = 1, reports: bool = True) -> None:
        self.node = LinkNode(Relay(conditions or LinkConditions(), START, seed), reports)
        self.now = START
        self.timers: dict[str, int] = {}
        self.effects: list[tuple[int, Effect]] = []
        self.give(Started(1))

    def give(self, event: Event) -> list[Effect]:
        effects: list[Effect] = []
        for given in self.node.handle(event, self.now):
            effect = Send(given.topic, given.make()) if isinstance(given, SendIfHeard) else given
            effects.append(effect)
            if isinstance(effect, SetTimer):
                self.timers.pop(effect.timer, None)
                if effect.at is not None:
                    self.timers[effect.timer] = effect.at
            self.effects.append((self.now, effect))
        return effects

    def until(self, time: int) -> None:
        for _ in range(100_000):
            due = min(((at, name) for name, at in self.timers.items()), default=None)
            if due is None or due[0] > time:
                self.now = time
                return
            self.now = max(self.now, due[0])
            del self.timers[due[1]]
            self.give(TimerFired(due[1]))
        raise AssertionError("the node never lets time pass")

    def of(self, kind: type[E]) -> list[tuple[int, E]]:
        return [(at, effect) for at, effect in self.effects if isinstance(effect, kind)]

    def forwards(self) -> list[tuple[int, bytes, Side]]:
        return [(at - START, effect.payload, effect.side) for at, effect in self.of(Forward)]

    def statuses(self) -> list[tuple[int, LinkStatus]]:
        return [(at - START, effect.body) for at, effect in self.of(Send)]  # type: ignore[misc]

    def ask(self, **change: Any) -> LinkStatus:
        (answer,) = [e for e in self.give(QueryReceived(LINK_SET, LinkChange(**change), 7)) if isinstance(e, SendReply)]
        assert answer.token == 7
        assert isinstance(answer.reply, LinkStatus)
        return answer.reply


def test_the_link_receives_every_topic_that_crosses_and_no_other() -> None:
    interface = build_node(Scenario(name="m", region="t1")).interface
    assert set(interface.receives_raw) == {*crossing(Direction.UP), *crossing(Direction.DOWN)}
    assert interface.serves == (LINK_SET, LINK_SHOW)
    assert interface.sides == (Side.MOON, Side.EARTH)
    assert not interface.custody


def test_packets_arrive_on_the_moon_and_on_earth_one_light_time_later() -> None:
    endpoint = Endpoint()
    endpoint.give(ReceivedRaw(COMMAND, b"up"))
    endpoint.now += 5
    endpoint.give(ReceivedRaw(SAMPLE, b"down"))
    endpoint.until(START + 5 * S)
    assert endpoint.forwards() == [(1_282_000_000, b"up", Side.MOON), (1_282_000_005, b"down", Side.EARTH)]


def test_each_direction_has_its_own_conditions() -> None:
    endpoint = Endpoint(LinkConditions(down=DirectionConditions(one_way_light_time_s=3.0, rate_bit_s=8.0)))
    endpoint.give(ReceivedRaw(COMMAND, b"u"))
    endpoint.give(ReceivedRaw(SAMPLE, b"d"))
    endpoint.until(START + 10 * S)
    assert endpoint.forwards() == [(1_282_000_000, b"u", Side.MOON), (4 * S, b"d", Side.EARTH)]


def test_packets_that_arrive_together_come_in_the_order_of_offering() -> None:
    endpoint = Endpoint()
    payloads = [str(k).encode() for k in range(10)]
    for k, payload in enumerate(payloads):
        endpoint.give(ReceivedRaw(COMMAND if k % 3 else SAMPLE, payload))
    endpoint.until(START + 5 * S)
    assert [payload for _, payload, _ in endpoint.forwards()] == payloads
    assert {at for at, _, _ in endpoint.forwards()} == {1_282_000_000}


def test_the_status_shows_each_packet_in_flight_with_its_arrival() -> None:
    endpoint = Endpoint()
    endpoint.give(ReceivedRaw(SAMPLE, b'{"header":{"source":"rover","sequence":4},"body":{}}'))
    (shown,) = endpoint.ask().in_flight
    assert (shown.topic, shown.source, shown.sequence, shown.direction) == ("tm/sample", "rover", 4, Direction.DOWN)
    assert (shown.offered_at, shown.departs_at, shown.arrives_at) == (START, START, START + 1_282_000_000)
    endpoint.until(START + 2 * S)
    assert endpoint.ask().in_flight == ()
    assert endpoint.ask().down.delivered == 1


def test_a_change_leaves_the_fields_that_it_does_not_name() -> None:
    endpoint = Endpoint(LinkConditions(up=DirectionConditions(loss=0.5), down=DirectionConditions(jitter_s=0.25)))
    status = endpoint.ask(direction=Direction.DOWN, one_way_light_time_s=6.0)
    assert status.conditions.down == DirectionConditions(one_way_light_time_s=6.0, jitter_s=0.25)
    assert status.conditions.up == DirectionConditions(loss=0.5)
    status = endpoint.ask(rate_bit_s=1000.0)
    assert status.conditions.up.rate_bit_s == status.conditions.down.rate_bit_s == 1000.0
    status = endpoint.ask(unlimited_rate=True)
    assert status.conditions.up.rate_bit_s is None


def test_an_empty_change_changes_nothing_and_returns_the_status() -> None:
    endpoint = Endpoint()
    before = len(endpoint.of(LogRecord))
    assert endpoint.ask().conditions == LinkConditions()
    assert len(endpoint.of(LogRecord)) == before


def test_single_values_of_a_change_apply_on_top_of_a_preset() -> None:
    endpoint = Endpoint()
    status = endpoint.ask(conditions=PRESETS["farside-relay"], loss=0.1)
    assert status.conditions.up == PRESETS["farside-relay"].up.model_copy(update={"loss": 0.1})
    assert status.conditions.down.rate_bit_s == 140_000.0


def test_a_forced_blackout_can_be_ended_and_the_schedule_applies_again() -> None:
    endpoint = Endpoint(LinkConditions(windows=(Window(opens_s=0, closes_s=100),)))
    assert endpoint.ask(contact=False).contact is False
    endpoint.give(ReceivedRaw(SAMPLE, b"held"))
    endpoint.until(START + 50 * S)
    assert endpoint.forwards() == []
    status = endpoint.ask(contact=True)
    assert (status.contact, status.contact_changes_at, status.contact_forced) == (True, None, True)
    status = endpoint.ask(contact_as_scheduled=True)
    assert (status.contact, status.contact_changes_at, status.contact_forced) == (True, START + 100 * S, None)
    endpoint.until(START + 60 * S)
    assert endpoint.forwards() == [(51_282_000_000, b"held", Side.EARTH)]


def test_a_change_of_contact_is_reported_when_it_happens() -> None:
    endpoint = Endpoint(LinkConditions(duty_cycle=DutyCycle(period_s=100, contact_s=30)))
    endpoint.until(START + 210 * S)
    said = [(at - START, note.text) for at, note in endpoint.of(LogRecord) if note.text.startswith("contact")]
    assert said == [
        (30 * S, "contact lost"),
        (100 * S, "contact regained"),
        (130 * S, "contact lost"),
        (200 * S, "contact regained"),
    ]
    contact = [(at, status.contact) for at, status in endpoint.statuses() if at % (10 * S) == 0]
    assert (30 * S, False) in contact
    assert (100 * S, True) in contact


def test_a_dropped_packet_is_reported_with_its_reason() -> None:
    endpoint = Endpoint(LinkConditions(down=DirectionConditions(loss=1.0)))
    endpoint.give(ReceivedRaw(SAMPLE, b'{"header":{"source":"rover","sequence":4},"body":{}}'))
    (note,) = [note for _, note in endpoint.of(LogRecord) if note.text == "packet dropped"]
    assert note.level is Level.DEBUG
    assert (note.fields["why"], note.fields["source"], note.fields["sequence"]) == ("lost on the way", "rover", 4)
    status = endpoint.ask()
    assert status.down.lost == 1
    assert [(drop.topic, drop.why) for drop in status.dropped] == [("tm/sample", "lost on the way")]


def test_packets_dropped_for_want_of_room_name_their_flow_so_that_the_log_limits_their_lines() -> None:
    endpoint = Endpoint(LinkConditions(down=DirectionConditions(rate_bit_s=1.0)))
    for number in range(20_000):
        endpoint.give(
            ReceivedRaw(SAMPLE, b'{"header":{"source":"rover","incarnation":%d,"sequence":4},"body":{}}' % number)
        )
    notes = [note for _, note in endpoint.of(LogRecord) if note.text == "packet dropped"]
    assert len(notes) > 1_000
    assert {note.cause for note in notes} == {Cause("tm/sample: queue full", "rover")}


@pytest.mark.parametrize("name", PRESETS)
def test_the_log_has_each_value_that_a_preset_sets(name: str) -> None:
    endpoint = Endpoint(LinkConditions(down=DirectionConditions(loss=1.0)))
    endpoint.ask(conditions=preset(name), by="anna")
    (note,) = [note for _, note in endpoint.of(LogRecord) if note.text == "link changed"]
    assert note.fields == {"conditions": preset(name).model_dump(mode="json"), "by": "anna"}


def test_a_request_that_changes_nothing_has_no_line_in_the_log() -> None:
    endpoint = Endpoint(LinkConditions())
    endpoint.ask(by="anna")
    assert [note for _, note in endpoint.of(LogRecord) if note.text == "link changed"] == []


def test_status_is_published_rarely_when_idle_and_at_most_once_a_second_when_busy() -> None:
    endpoint = Endpoint()
    endpoint.until(START + 600 * S)
    assert [at for at, _ in endpoint.statuses()] == [k * 60 * S for k in range(11)]
    endpoint.effects.clear()
    for k in range(100):
        endpoint.until(START + 600 * S + k * S // 10)
        endpoint.give(ReceivedRaw(STATE, b"state"))
    endpoint.until(START + 620 * S)
    times = [at for at, _ in endpoint.statuses()]
    assert all(later - earlier >= S for earlier, later in pairwise(times))
    assert 9 <= len(times) <= 13


def test_a_link_without_reports_carries_packets_and_answers_about_its_status_alone() -> None:
    endpoint = Endpoint(reports=False)
    endpoint.give(ReceivedRaw(STATE, b"state"))
    endpoint.until(START + 600 * S)
    assert len(endpoint.forwards()) == 1
    assert endpoint.statuses() == []
    assert endpoint.ask().down.delivered == 1


def test_a_topic_that_is_not_served_is_refused() -> None:
    (refusal,) = [e for e in Endpoint().give(QueryReceived(MEASURE, object(), 3)) if isinstance(e, RefuseQuery)]
    assert refusal.token == 3
    assert LINK_SET.name in refusal.why


def test_an_invalid_change_is_refused_and_changes_nothing() -> None:
    bad = LinkChange.model_construct(**{**LinkChange().model_dump(), "loss": 7.0})
    endpoint = Endpoint()
    (refusal,) = [e for e in endpoint.give(QueryReceived(LINK_SET, bad, 3)) if isinstance(e, RefuseQuery)]
    assert "loss" in refusal.why
    assert endpoint.ask().conditions == LinkConditions()
    with pytest.raises(InvalidInput, match="loss"):
        apply_change(LinkConditions(), bad)


def test_two_runs_with_the_same_seed_are_the_same() -> None:
    def run(seed: int) -> list[tuple[int, Effect]]:
        endpoint = Endpoint(PRESETS["lossy"], seed)
        for k in range(100):
            endpoint.give(ReceivedRaw(SAMPLE if k % 2 else COMMAND, b"x" * k))
            endpoint.until(endpoint.now + S // 3)
        endpoint.until(endpoint.now + 10 * S)
        return endpoint.effects

    assert run(3) == run(3)
    assert run(3) != run(4)


def test_a_restarted_link_does_not_repeat_the_losses_of_its_first_start() -> None:
    def lost(incarnation: int) -> set[int]:
        endpoint = Endpoint(LinkConditions(down=DirectionConditions(loss=0.5)))
        endpoint.give(Started(incarnation))
        for k in range(50):
            endpoint.give(ReceivedRaw(SAMPLE, f'{{"header":{{"source":"rover","sequence":{k}}},"body":{{}}}}'.encode()))
        return {drop.sequence for drop in endpoint.ask().dropped}

    assert lost(1) == lost(1)
    assert lost(1) != lost(2)


def test_every_preset_has_its_provenance_and_the_published_light_time() -> None:
    assert set(PRESETS) == set(PROVENANCE)
    assert PRESETS["nominal"].up.one_way_light_time_s == 1.282
    assert PRESETS["zero"].down.one_way_light_time_s == 0.0
    assert PRESETS["csa-10s"].down.rate_bit_s == 300_000.0
    assert PRESETS["farside-relay"].up.rate_bit_s == 125.0
    assert PRESETS["mars"].up.one_way_light_time_s == 1200.0
    with pytest.raises(InvalidInput, match="nominal, zero"):
        preset("venus")


def test_the_polar_preset_begins_one_day_before_contact_is_lost() -> None:
    relay = Relay(PRESETS["polar-window"], START, 1)
    assert relay.in_contact(START)
    assert relay.contact_changes_at(START) == START + 86_400 * S


def test_the_link_status_of_a_full_link_fits_its_topic() -> None:
    from schemas.codec import decode, encode
    from schemas.wire import Header

    endpoint = Endpoint(PRESETS["polar-window"])
    for _ in range(500):
        endpoint.give(ReceivedRaw(SAMPLE, b"x" * 2000))
    status = endpoint.ask(contact=False, loss=1.0)
    assert len(status.in_flight) == 200
    header = Header(mission="m", source="link", incarnation=1, sequence=0, made_at=START)
    assert decode(LINK_STATUS, encode(header, status), "m")[1] == status

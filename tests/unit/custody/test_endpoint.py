"""Custody at one end of the link, as a host drives it: two endpoints without a link between them."""

from __future__ import annotations

import pytest

from schemas.codec import decode
from schemas.commands import CommandKind, Telecommand
from schemas.link import LinkConditions
from schemas.telemetry import RoverMode, RoverState
from schemas.topics import ACK_DOWN, ACK_UP, COMMAND, STATE, Side
from schemas.wire import Header
from services.mission.mission_time import SECOND
from services.runtime.actions import Publish
from services.runtime.custody.endpoint import CUSTODY_TIMER, CustodyEndpoint, custody_config
from services.runtime.node import Interface, SetTimer

LINK = LinkConditions()
EARTH = Interface("ground", (Side.EARTH,))
MOON = Interface("rover", (Side.MOON,))


def endpoint(interface: Interface) -> CustodyEndpoint:
    endpoint = CustodyEndpoint(interface.name, interface.sides[0], custody_config(LINK, interface))
    endpoint.start("short", 1)
    return endpoint


@pytest.fixture
def ground() -> CustodyEndpoint:
    return endpoint(EARTH)


@pytest.fixture
def rover() -> CustodyEndpoint:
    return endpoint(MOON)


def offered(ground: CustodyEndpoint, number: int, now: int) -> list[Publish]:
    header = Header(mission="short", source="ground", incarnation=1, sequence=number, made_at=now)
    body = Telecommand(command_id=f"c{number}", kind=CommandKind.PAUSE)
    return [action for action in ground.offer(COMMAND, header, body, now) if isinstance(action, Publish)]


def arrives(rover: CustodyEndpoint, published: Publish, now: int) -> tuple[list[str], list[Publish]]:
    """Ids of the delivered commands, and the messages sent."""
    header, body = decode(published.topic, published.payload, "short")
    deliveries, actions = rover.received(published.topic, header, body, len(published.payload), now)
    return [delivery.body.command_id for delivery in deliveries], [
        each for each in actions if isinstance(each, Publish)
    ]


def acknowledgements(rover: CustodyEndpoint, sent: list[Publish], now: int) -> list[Publish]:
    """The acknowledgements sent at once, and those sent by the timer."""
    return [*sent, *(action for action in rover.timer_elapsed(now) if isinstance(action, Publish))]


def test_a_message_is_sent_at_once_and_kept_until_it_is_acknowledged(ground, rover):
    (published,) = offered(ground, 0, 0)
    assert (published.topic, published.side) == (COMMAND, Side.EARTH)
    assert ground.depth == 1
    handed_up, sent = arrives(rover, published, SECOND)
    assert handed_up == ["c0"]
    acks = acknowledgements(rover, sent, 2 * SECOND)
    assert {ack.topic for ack in acks} == {ACK_DOWN}, "what went up is acknowledged by what comes down"
    for ack in acks:
        header, body = decode(ACK_DOWN, ack.payload, "short")
        ground.acknowledged(body, header, 3 * SECOND)
    assert ground.depth == 0
    assert ground.retransmitted == 0


def test_a_message_that_is_not_acknowledged_is_sent_again_and_delivered_once(ground, rover):
    (published,) = offered(ground, 0, 0)
    (timer,) = ground.move_timer()
    assert isinstance(timer, SetTimer)
    assert timer.timer == CUSTODY_TIMER
    assert timer.at is not None
    assert timer.at > 2 * LINK.up.one_way_light_time_s * SECOND, "not before the answer could be here"
    assert ground.move_timer() == [], "a timer that has not moved is not set again"
    again = [action for action in ground.timer_elapsed(timer.at) if isinstance(action, Publish)]
    assert len(again) == 1
    assert ground.retransmitted == 1
    assert arrives(rover, published, SECOND)[0] == ["c0"]
    assert arrives(rover, again[0], timer.at)[0] == []


def test_messages_are_delivered_in_the_order_in_which_they_were_sent(ground, rover):
    first, second = offered(ground, 0, 0)[0], offered(ground, 1, 0)[0]
    assert arrives(rover, second, SECOND)[0] == []
    assert arrives(rover, first, SECOND)[0] == ["c0", "c1"]


def test_a_state_that_was_overtaken_on_the_way_is_dropped(ground):
    state = RoverState(
        mode=RoverMode.IDLE, x_m=1.0, y_m=2.0, heading_deg=0.0, energy_wh=1.0, capacity_wh=2.0, driven_m=0.0,
        drilled_m=0.0, round=0, plan_revision=0, rounds_on_board=0, samples_done=0, queue_depth=0,
    )  # fmt: skip

    def came(incarnation: int, sequence: int) -> int:
        header = Header(mission="short", source="rover", incarnation=incarnation, sequence=sequence, made_at=0)
        return len(ground.received(STATE, header, state, 100, SECOND)[0])

    assert [came(1, 4), came(1, 5), came(1, 5), came(1, 3), came(2, 0), came(1, 9)] == [1, 1, 0, 0, 1, 0]


def test_each_side_receives_the_acknowledgements_that_the_other_sends(ground, rover):
    assert (ground.ack_topic, rover.ack_topic) == (ACK_DOWN, ACK_UP)

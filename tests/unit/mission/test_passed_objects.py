"""A mission in one process passes objects between its nodes, and is the same as one whose messages are all parsed."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from he3.frames import SiteGrid
from he3.reference import Region
from schemas.codec import Passed, Refused, decode, encode, header_of, passed, restamped
from schemas.ground import MissionPhase
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT, GROUND_STATUS, LINK_STATUS, MAP_OVERVIEW, STATE, Side, Topic
from schemas.wire import Header
from services.field.node import build_node as build_field
from services.ground.node import build_node as build_ground
from services.ground.planners.interface import PlannedRound, PlanningRequest
from services.link.node import build_node as build_link
from services.mission.in_process import InProcessMission
from services.mission.scenario import checked_scenario
from services.rover.node import build_node as build_rover

HEADER = Header(mission="m", source="rover", incarnation=1, sequence=3, made_at=5, held_from=2)
BODY = RoverEvent(kind=EventKind.PARKED, at=5, x_m=0.1, y_m=1 / 3, round=2, detail="at\x1b the end")


def across(request: PlanningRequest) -> PlannedRound:
    """Four places on a line, and the next line a little farther north."""
    y = 10.0 + len(request.observed_m)
    places = np.column_stack((np.linspace(10.0, 50.0, 4), np.full(4, y)))
    return PlannedRound(np.vstack((request.start_m, places)), places, 1.0)


@cache
def flown(passes_objects: bool, taps: bool) -> tuple[list[Any], list[Any], Any]:
    """The event log of a mission over a bad link, its messages as bytes, and its map."""
    grid = SiteGrid(60, 60, 1.0)
    east = np.tile(np.linspace(6.0, 9.0, 60), (60, 1))
    none = np.zeros(grid.shape)
    region = Region(
        name="flat", title="flat", provenance="made by a test", grid=grid, he3_ppb=east, orbital_ppb=east,
        elevation_m=none, slope_deg=none.copy(), traversable=np.ones(grid.shape, dtype=bool),
    )  # fmt: skip
    bad = {"loss": 0.2, "corrupt": 0.1, "duplicate": 0.1, "reorder": 0.1, "jitter_s": 0.2}
    document = {"name": "passed", "region": "t1", "rounds": 2, "samples_per_round": 4, "link": {"up": bad, "down": bad}}
    scenario = checked_scenario(document, "test")
    nodes = (
        build_field(scenario, region), build_rover(scenario, grid), build_link(scenario),
        build_ground(scenario, region, across),
    )  # fmt: skip
    events: list[Any] = []
    messages: list[Any] = []
    mission = InProcessMission(
        scenario, event_sink=lambda *event: events.append(event), nodes=nodes, passes_objects=passes_objects
    )
    if taps:
        mission.simulation.tap(lambda topic, side, payload, now: messages.append((topic.name, side, payload, now)))
    assert mission.run() is MissionPhase.COMPLETED, mission.why()
    return events, messages, mission.simulation.snapshots["ground"]


def test_a_mission_that_passes_objects_has_the_events_and_the_messages_of_one_that_parses_bytes() -> None:
    events, messages, snapshot = flown(passes_objects=False, taps=True)
    passed_events, passed_messages, passed_snapshot = flown(passes_objects=True, taps=True)
    assert passed_events == events
    assert passed_messages == messages
    assert passed_snapshot.samples == snapshot.samples
    assert (passed_snapshot.mean_ppb == snapshot.mean_ppb).all()
    assert any("refused" in event or "received" in event[2] for event in events)


def test_a_message_that_nobody_receives_is_not_made_and_changes_no_event() -> None:
    events, messages, _ = flown(passes_objects=True, taps=True)
    unheard_events, unheard_messages, _ = flown(passes_objects=True, taps=False)
    assert unheard_events == events
    assert unheard_messages == []
    assert {GROUND_STATUS.name, LINK_STATUS.name, MAP_OVERVIEW.name} <= {name for name, *_ in messages}


def test_a_passed_message_is_the_bytes_of_its_encoding_and_reads_as_they_do() -> None:
    message, plain = passed(HEADER, BODY), encode(HEADER, BODY)
    assert message == plain
    assert decode(EVENT, message, "m") == decode(EVENT, plain, "m")
    assert decode(EVENT, message, "m")[1] is BODY
    assert {key: value for key, value in header_of(message).items() if value is not None} == header_of(plain) | {
        "repetition": 0
    }
    assert not isinstance(restamped(message, 3, 1), Passed)


@pytest.mark.parametrize(
    ("topic", "mission", "why"),
    [(EVENT, "other", "expected mission 'other'"), (STATE, "m", "tm/state"), (GROUND_STATUS, "m", "ground/status")],
)
def test_a_passed_message_is_refused_where_its_bytes_are(topic: Topic, mission: str, why: str) -> None:
    said = []
    for payload in (passed(HEADER, BODY), encode(HEADER, BODY)):
        with pytest.raises(Refused, match=why) as refusal:
            decode(topic, payload, mission)
        said.append(str(refusal.value))
    assert said[0] == said[1]
    assert topic.sides[0] in Side

"""A recorded mission shows at any time what a client saw live at that time, and cannot be commanded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from benchmarks.faults import small_region
from he3.errors import InvalidInput, NotAllowed
from schemas.maps import CrossValidationQuery, MapLayer, MapLayerQuery, MapTrackQuery, RealisationsQuery
from schemas.topics import MAP_CROSS_VALIDATION, MAP_LAYER, MAP_POINT, MAP_REALISATIONS, TRACK
from services.console.replay.mission import RecordedMission
from services.console.report.alarm_history import recorded_alarms
from services.console.web.hub import Hub
from services.mission.mission_time import SECOND
from tests.unit.console.flown import HOUR_S, INSTANTS_S, PLACE, Flown

ALL_OVER_THE_PLACE = (7, 2, 9, 0, 3, 3, 8, 1, 6, 4, 5)


@pytest.fixture(scope="module")
def recorded(flown_with_faults: Flown) -> Iterator[RecordedMission]:
    with RecordedMission(flown_with_faults.path, small_region()) as mission:
        yield mission


@pytest.fixture(scope="module")
def hub(recorded: RecordedMission) -> Hub:
    hub = Hub(recorded, recorded)
    recorded.on_time(hub._time_passes)
    hub._state.follow()
    return hub


def page(document: dict[str, Any]) -> dict[str, Any]:
    """What the page shows, but for flights, which are drawn for some wall time, and how often an alarm was raised: the
    server looks at intervals of wall time whether a report is overdue, and may miss one that is overdue for seconds."""
    link = document["link"] and {key: value for key, value in document["link"].items() if key != "in_flight"}
    alarms = [(each["kind"], each["active"], each["acknowledged"]) for each in document["alarms"]["current"]]
    same = {
        key: document[key]
        for key in ("status", "rover", "commands", "events", "entries", "modes", "contacts", "curves")
    }
    return {**same, "link": link, "alarms": alarms, "liveness": document["liveness"]["condition"]}


@pytest.mark.parametrize("number", ALL_OVER_THE_PLACE)
def test_at_ten_instants_the_page_shows_what_it_showed_live(
    hub: Hub, recorded: RecordedMission, flown_with_faults: Flown, number: int
) -> None:
    at_s = INSTANTS_S[number]
    live = flown_with_faults.live[at_s]
    hub.play(at_s, None)
    shown = page(hub._document())
    expected = page(dict(live.page))
    for key, value in expected.items():
        assert shown[key] == value, key
    query = recorded._session.query
    assert query(MAP_POINT, PLACE) == live.point
    assert query(MAP_LAYER, MapLayerQuery(layer=MapLayer.STD, step=7)) == live.std
    assert query(MAP_REALISATIONS, RealisationsQuery(count=2)) == live.drawn
    if live.checked is not None:
        assert query(MAP_CROSS_VALIDATION, CrossValidationQuery()) == live.checked
    track = query(TRACK, MapTrackQuery()).model_dump(exclude={"plan_ends"})
    assert live.track is not None
    assert track == live.track.model_dump(exclude={"plan_ends"})


def test_the_alarms_of_a_recording_are_those_that_the_page_showed(
    hub: Hub, recorded: RecordedMission, flown_with_faults: Flown
) -> None:
    found = recorded_alarms(flown_with_faults.path)
    hub.play((recorded.end_ns - recorded.begin_ns) / SECOND, None)
    assert {alarm.kind for alarm in found.current} == {alarm.kind for alarm in hub._alarms.current}
    assert all(alarm.ended_at is not None and alarm.ended_at >= alarm.raised_at for alarm in found.history)


def test_areas_of_interest_and_earlier_maps_are_those_of_the_time(recorded: RecordedMission) -> None:
    begin = recorded.begin_ns
    recorded.jump(begin + round(0.4 * HOUR_S * SECOND))
    assert recorded.set_interest() == ()
    early = recorded.history().revisions[-1]
    recorded.jump(begin + round(0.6 * HOUR_S * SECOND))
    assert [area.area_id for area in recorded.set_interest()] == ["look-here"]
    recorded.jump(recorded.end_ns)
    assert recorded.point(40, 30, as_of=early.revision).revision == early.revision
    assert recorded.history().revisions[-1].revision > early.revision


def test_the_log_is_that_of_the_time_with_every_event_once(hub: Hub, recorded: RecordedMission) -> None:
    hub.play(INSTANTS_S[9], None)
    log, page = recorded.log(), hub._document()
    assert [entry.model_dump(mode="json") for entry in log.entries] == page["entries"] != []
    assert [change.model_dump(mode="json") for change in log.modes] == page["modes"] != []
    heard = [(each.event.kind.value, each.received_at) for each in log.events]
    assert sorted(heard) == sorted((each["kind"], each["received_at"]) for each in page["events"]) != []


def test_nothing_that_changes_a_mission_is_answered(recorded: RecordedMission) -> None:
    for change in (
        lambda: recorded.command("pause"), lambda: recorded.set_link(loss=0.5), lambda: recorded.set_clock_rate(2.0),
        lambda: recorded.set_interest("a", [(1, 1), (9, 1), (1, 9)]), lambda: recorded.take_authority(),
    ):  # fmt: skip
        with pytest.raises(NotAllowed, match="expected a running mission, got a recording"):
            change()


def test_a_time_or_a_pace_that_the_recording_does_not_have_is_refused(hub: Hub) -> None:
    hub.play(60.0, 0.0)
    with pytest.raises(InvalidInput, match="at: expected a time within the recording"):
        hub.play(1e9, None)
    with pytest.raises(InvalidInput, match="pace: expected 0 to 100000"):
        hub.play(None, 1e6 - 1)
    assert hub.play(None, None)["at_s"] == 60.0


def test_time_goes_on_at_the_pace_that_is_set_and_stands_at_the_end(recorded: RecordedMission) -> None:
    state = recorded.state()
    recorded.jump(recorded.begin_ns)
    recorded.set_pace(100_000.0)
    while recorded.pace:
        state.refresh()
    state.refresh()
    assert state.status is not None
    assert state.status.is_over
    assert recorded.now_ns == recorded.end_ns
    recorded.set_pace(0.0)

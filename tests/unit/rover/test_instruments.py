"""Instruments that do not reply, refuse, or reply too late."""

from __future__ import annotations

from schemas.topics import MEASURE, TERRAIN
from services.runtime.node import (
    NoReply,
)
from tests.unit.rover.simulated_moon import START, Moon, east, plan_of, round_plan


def test_a_silent_instrument_is_asked_again_and_reported_once():
    moon = Moon()
    moon.refuses[MEASURE] = (NoReply.TIMEOUT, "")
    moon.plan(plan_of(1, east(1, 5.5, 10.5), east(2, 10.5, 15.5)))
    moon.run(2000)
    asked = [ask for ask in moon.asked if ask.topic is MEASURE]
    assert len(asked) > 20
    assert {ask.request.sample_id for ask in asked} == {"r1s1"}
    assert moon.kinds("instrument_silent") == ["instrument_silent"]
    assert "no answer in time" in moon.event("instrument_silent").detail
    moon.refuses.clear()
    moon.run()
    assert [sample.sample_id for sample in moon.samples] == ["r1s1", "r2s1"]
    assert moon.kinds("instrument_silent") == ["instrument_silent"]


def test_without_terrain_the_rover_does_not_move():
    moon = Moon()
    moon.refuses[TERRAIN] = (NoReply.NO_ROUTE, "")
    moon.plan(plan_of(1, east(1, 5.5, 10.5)))
    moon.run(3600)
    assert moon.state.driven_m == 0.0
    moon.refuses.clear()
    moon.run()
    assert len(moon.samples) == 1


def test_a_sample_that_the_instrument_refuses_is_skipped_and_the_round_goes_on():
    moon = Moon()
    moon.refuses[MEASURE] = (NoReply.REFUSED, "outside")
    moon.plan(plan_of(1, round_plan(1, [START, (15.5, 5.5)], (8.5, 5.5), (12.5, 5.5))))
    moon.run(700)
    moon.refuses.clear()
    moon.run()
    skipped = moon.event("sample_skipped")
    assert (skipped.sample_id, skipped.detail) == ("r1s1", "outside")
    assert [sample.sample_id for sample in moon.samples] == ["r1s2"]
    assert moon.event("round_completed").samples_done == ("r1s2",)


def test_a_reply_to_a_withdrawn_query_changes_nothing():
    moon = Moon()
    moon.refuses[MEASURE] = (NoReply.TIMEOUT, "")
    moon.plan(plan_of(1, east(1, 5.5, 10.5)))
    moon.run(1000)
    stale = next(ask for ask in moon.asked if ask.topic is MEASURE)
    moon.refuses.clear()
    answer = moon._reply(stale)
    assert moon.rover.handle(answer, moon.now) == []
    moon.run()
    assert len(moon.samples) == 1

"""What a display can rely on: who is silent, whether there is contact, how old the rover's word is."""

from __future__ import annotations

import time
from random import Random
from typing import Any

import pytest

from schemas.ground import GroundStatus, MissionPhase, Presence
from schemas.link import ClockMode, ClockState, DirectionConditions, DirectionCounts, LinkConditions, LinkStatus
from schemas.telemetry import RoverMode, RoverState
from schemas.topics import EARTH_CLOCK, EARTH_PRESENCE, GROUND_STATUS, LINK_STATUS, STATE
from schemas.wire import Header
from services.console.client.liveness import Condition, liveness
from services.console.client.mission_state import MissionState

SECOND = 1_000_000_000
START = 1_893_456_000 * SECOND


def header(made_at: int, source: str = "ground") -> Header:
    return Header(mission="m", source=source, incarnation=1, sequence=0, made_at=made_at)


def ground(phase: MissionPhase = MissionPhase.EXECUTING) -> GroundStatus:
    return GroundStatus(
        phase=phase, planner="rrt", round=0, rounds=3, samples=0, samples_total=9, driven_m=0.0,
        budget_m=None, plan_revision=0, plans_in_work=0, map_revision=0, mean_std_ppb=None, kernel=None,
        score=None, rover=None, rover_made_at=None,
    )  # fmt: skip


def link(
    contact: bool = True, changes_at: int | None = None, forced: bool | None = None, loss: float = 0.0
) -> LinkStatus:
    each = DirectionConditions(loss=loss)
    return LinkStatus(
        conditions=LinkConditions(up=each, down=each), contact=contact, contact_changes_at=changes_at,
        contact_forced=forced, up=DirectionCounts(), down=DirectionCounts(), in_flight=(), incarnation=1,
    )  # fmt: skip


def rover() -> RoverState:
    return RoverState(
        mode=RoverMode.DRIVING, x_m=1.0, y_m=2.0, heading_deg=0.0, energy_wh=4000.0, capacity_wh=5000.0, driven_m=0.0,
        drilled_m=0.0, round=1, plan_revision=1, rounds_on_board=0, samples_done=0, queue_depth=0,
    )  # fmt: skip


def presence(name: str) -> Presence:
    return Presence(name=name, side="earth", incarnation=1, software="1", pid=1, host="h", refused=0, events=0)


def at(now: int) -> ClockState:
    return ClockState(mode=ClockMode.LOCKSTEP, rate=0.0, anchor_wall_ns=1, anchor_mission_ns=now, start_ns=START)


@pytest.fixture
def state(session: Any) -> MissionState:
    """A mission in which all processes were heard just now, at START."""
    state = MissionState(session.client)
    state.follow()
    session.send(EARTH_CLOCK, header(START, "link"), at(START))
    session.send(GROUND_STATUS, header(START), ground())
    session.send(LINK_STATUS, header(START, "link"), link())
    for name in ("link", "ground"):
        session.send(EARTH_PRESENCE, header(START, name), presence(name))
    return state


def later(monkeypatch: pytest.MonkeyPatch, wall_s: float) -> None:
    moment = time.monotonic() + wall_s
    monkeypatch.setattr("services.console.client.mission_state.time.monotonic", lambda: moment)


def test_a_mission_whose_processes_are_heard_is_live(state: MissionState) -> None:
    assert liveness(state).condition is Condition.LIVE
    assert liveness(state).text == "live, 1.28 s of light time"


@pytest.mark.parametrize(
    ("silent", "heard", "condition"),
    [("ground", "link", Condition.GROUND_SILENT), ("link", "ground", Condition.LINK_SILENT)],
)
def test_a_process_without_a_heartbeat_for_over_three_seconds_is_named(
    state: MissionState, session: Any, monkeypatch: pytest.MonkeyPatch, silent: str, heard: str, condition: Condition
) -> None:
    later(monkeypatch, 3.5)
    session.send(EARTH_PRESENCE, header(START, heard), presence(heard))
    assert liveness(state).condition is condition
    assert liveness(state).text == f"{silent} silent for 4 s"
    session.send(EARTH_PRESENCE, header(START, silent), presence(silent))
    assert liveness(state).condition is Condition.LIVE


def test_a_mission_of_which_nothing_is_heard_is_silent(state: MissionState, monkeypatch: pytest.MonkeyPatch) -> None:
    later(monkeypatch, 5.0)
    assert liveness(state).condition is Condition.MISSION_SILENT


@pytest.mark.parametrize(
    ("status", "text"),
    [
        (link(contact=False, changes_at=START + 90 * SECOND), "out of contact for another 1 min 30 s"),
        (link(contact=False), "out of contact, no end is known"),
        (link(contact=False, changes_at=START + 90 * SECOND, forced=False), "out of contact, no end is known"),
    ],
)
def test_out_of_contact_the_time_of_the_next_contact_is_said_where_it_is_known(
    state: MissionState, session: Any, status: LinkStatus, text: str
) -> None:
    session.send(LINK_STATUS, header(START + 1, "link"), status)
    assert (liveness(state).condition, liveness(state).text) == (Condition.OUT_OF_CONTACT, text)


@pytest.mark.parametrize(("period_s", "overdue_s"), [(60, 182), (600, 1802), (5, 17)])
def test_the_rover_is_overdue_after_three_of_its_own_reporting_periods(
    state: MissionState, session: Any, monkeypatch: pytest.MonkeyPatch, period_s: int, overdue_s: int
) -> None:
    last = START + 4 * period_s * SECOND
    for number in range(5):
        session.send(STATE, header(START + number * period_s * SECOND, "rover"), rover())
    assert state.report_period_s == period_s
    for age_s, condition in ((overdue_s - 2, Condition.LIVE), (overdue_s, Condition.ROVER_OVERDUE)):
        now = last + age_s * SECOND
        session.send(EARTH_CLOCK, header(now, "link"), at(now))
        later(monkeypatch, 1.1)  # what has arrived within a second may have waited in this computer
        assert liveness(state).condition is condition


def test_reports_that_are_lost_do_not_make_the_period_longer(state: MissionState, session: Any) -> None:
    for number in (0, 1, 2, 5, 6, 9, 10, 11):
        session.send(STATE, header(START + number * 60 * SECOND, "rover"), rover())
    assert state.report_period_s == 60.0


@pytest.mark.parametrize("loss", [0.3, 0.6])
def test_losses_that_the_link_states_make_no_rover_overdue_and_a_rover_that_is_silent_becomes_so(
    state: MissionState, session: Any, monkeypatch: pytest.MonkeyPatch, loss: float
) -> None:
    """20 hours of reports, one a minute and one more with each change of mode, which some links repeat."""
    chance, heard = Random(4), START
    session.send(LINK_STATUS, header(START + 1, "link"), link(loss=loss))
    for minute in range(1, 1200):
        for after_s in (0, 0, chance.choice((3, 20, 41)))[: chance.choice((1, 1, 2, 3))]:
            made = START + (60 * minute + after_s) * SECOND
            if chance.random() >= loss:
                session.send(STATE, header(made, "rover"), rover())
                heard = made
        now = START + (60 * minute + 59) * SECOND
        session.send(EARTH_CLOCK, header(now, "link"), at(now))
        later(monkeypatch, 1.1)
        for name in ("link", "ground"):
            session.send(EARTH_PRESENCE, header(now, name), presence(name))
        assert liveness(state).condition is Condition.LIVE, f"minute {minute}"
    now = heard + 60 * 60 * SECOND
    session.send(EARTH_CLOCK, header(now, "link"), at(now))
    later(monkeypatch, 1.1)
    assert liveness(state).condition is Condition.ROVER_OVERDUE


def test_a_mission_that_is_over_is_over_until_nothing_is_heard_then_its_services_have_ended(
    state: MissionState, session: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.send(GROUND_STATUS, header(START + 1), ground(MissionPhase.COMPLETED))
    assert liveness(state).condition is Condition.OVER
    later(monkeypatch, 60.0)
    assert liveness(state).condition is Condition.ENDED

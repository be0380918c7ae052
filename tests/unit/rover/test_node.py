"""The rover on a small Moon: plans, telecommands, hazards, energy and silent instruments, event by event."""

from __future__ import annotations

import heapq
import itertools
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.frames import SiteGrid
from he3.measurement import sample_noise
from he3.reference import Region
from schemas.commands import CommandKind, CommandReport, CommandStage, Telecommand
from schemas.plans import MissionPlan, PlannedSample, RoundPlan
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState, SampleReport
from schemas.topics import COMMAND, COMMAND_REPORT, EVENT, MEASURE, PLAN, SAMPLE, STATE, TERRAIN, Topic
from schemas.wire import Header
from services.field.node import FieldNode
from services.mission.scenario import FieldConfig, RoverConfig
from services.rover.activities import SAMPLE_TOLERANCE_M
from services.rover.node import RoverNode
from services.runtime.node import (
    SECOND,
    Effect,
    Event,
    Finish,
    NoReply,
    QueryFailed,
    QueryReceived,
    QueueDepthChanged,
    Received,
    RefuseQuery,
    ReplyReceived,
    Send,
    SendQuery,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
    seconds,
)
from tests.waiting import expect_within

GRID = SiteGrid(60, 60)
START = (5.5, 5.5)
BITE_S, ANALYSIS_S = 360.0, 300.0
SAMPLE_S = BITE_S + ANALYSIS_S  # one bite of 0.1 m, and its analysis
DAY_S = 86_400.0

Closed = Callable[[float, float], bool]


def region(closed: Closed = lambda x, y: False) -> Region:
    """A flat region of 1 m cells, closed where the function says so of a cell's centre, with 5 + x/10 ppb."""
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    flat = np.zeros(GRID.shape)
    return Region(
        name="plain",
        title="plain",
        provenance="made for tests",
        grid=GRID,
        he3_ppb=5.0 + x / 10,
        orbital_ppb=flat.copy(),
        elevation_m=flat.copy(),
        slope_deg=flat.copy(),
        traversable=~np.vectorize(closed)(x, y).astype(np.bool_),
    )


class Moon:
    """A rover, a field, and a heap of what happens when; instruments can fall silent."""

    def __init__(self, closed: Closed = lambda x, y: False, land: Region | None = None, **config: Any) -> None:
        self.config = RoverConfig.model_validate({"state_period_s": 1e6} | config)
        self.field = FieldNode(land or region(closed), FieldConfig(), 1, START)
        self.rover = RoverNode(self.config, GRID, START, 0)
        self.now = 0
        self.events: list[RoverEvent] = []
        self.samples: list[SampleReport] = []
        self.states: list[RoverState] = []
        self.reports: list[CommandReport] = []
        self.finished: list[Finish] = []
        self.asked: list[SendQuery] = []
        self.refuses: dict[Topic, tuple[NoReply, str]] = {}
        """Instruments that do not answer, and why."""
        self.history: list[tuple[int, Event]] = []
        self._heap: list[tuple[int, int, Event]] = []
        self._order = itertools.count()
        self._timers: dict[str, int] = {}
        self.put(0.0, Started(1))

    def put(self, at_s: float, event: Event) -> None:
        heapq.heappush(self._heap, (seconds(at_s), next(self._order), event))

    def plan(self, plan: MissionPlan, at_s: float = 0.0) -> None:
        self.put(at_s, Received(PLAN, header(seconds(at_s)), plan))

    def command(
        self, kind: str, at_s: float, command_id: str | None = None, made_s: float | None = None, **fields: Any
    ) -> str:
        command_id = command_id or f"{kind}-{next(self._order)}"
        if "expires_s" in fields:
            fields["expires_at"] = seconds(fields.pop("expires_s"))
        body = Telecommand(command_id=command_id, kind=CommandKind(kind), **fields)
        self.put(at_s, Received(COMMAND, header(seconds(at_s if made_s is None else made_s)), body))
        return command_id

    def run(self, until_s: float = DAY_S) -> Moon:
        while self._heap and self._heap[0][0] <= seconds(until_s):
            self.now, _, event = heapq.heappop(self._heap)
            if isinstance(event, TimerFired):
                if self._timers.get(event.timer) != self.now:
                    continue
                del self._timers[event.timer]
            self.history.append((self.now, event))
            for effect in self.rover.handle(event, self.now):
                self._carry_out(effect)
        return self

    def _carry_out(self, effect: Effect) -> None:
        match effect:
            case Send(topic, body):
                logs: dict[Topic, list[Any]] = {
                    EVENT: self.events, SAMPLE: self.samples, STATE: self.states, COMMAND_REPORT: self.reports,
                }  # fmt: skip
                logs[topic].append(body)
            case SendQuery():
                self.asked.append(effect)
                heapq.heappush(self._heap, (self.now, next(self._order), self._answer(effect)))
            case SetTimer(timer, None):
                self._timers.pop(timer, None)
            case SetTimer(timer, at):
                assert at is not None
                self._timers[timer] = at
                heapq.heappush(self._heap, (at, next(self._order), TimerFired(timer)))
            case Finish():
                self.finished.append(effect)

    def _answer(self, ask: SendQuery) -> Event:
        if ask.topic in self.refuses:
            why, detail = self.refuses[ask.topic]
            return QueryFailed(ask.topic, ask.query, why, detail)
        (effect,) = self.field.handle(QueryReceived(ask.topic, ask.request, 0), self.now)
        if isinstance(effect, RefuseQuery):
            return QueryFailed(ask.topic, ask.query, NoReply.REFUSED, effect.why)
        assert isinstance(effect, SendReply)
        return ReplyReceived(ask.topic, ask.query, effect.reply)

    # --- what to look at afterwards

    def kinds(self, *wanted: str) -> list[str]:
        return [event.kind.value for event in self.events if not wanted or event.kind.value in wanted]

    def event(self, kind: str) -> RoverEvent:
        (found,) = [event for event in self.events if event.kind.value == kind]
        return found

    def stages(self, command_id: str) -> list[str]:
        return [report.stage.value for report in self.reports if report.command_id == command_id]

    def why(self, command_id: str) -> str:
        return [report.why for report in self.reports if report.command_id == command_id][-1]

    def modes(self) -> list[str]:
        return [mode for mode, _ in itertools.groupby(state.mode.value for state in self.states)]

    @property
    def state(self) -> RoverState:
        """As a restart would have it told, here and now."""
        (told,) = self.rover.handle(Started(2), self.now)
        assert isinstance(told, Send)
        assert isinstance(told.body, RoverState)
        return told.body

    @property
    def place(self) -> tuple[float, float]:
        return self.state.x_m, self.state.y_m


def header(made_at: int) -> Header:
    return Header(mission="m", source="ground", incarnation=1, sequence=made_at % 1000, made_at=made_at)


def round_plan(number: int, path: list[tuple[float, float]], *samples: tuple[float, float], depth=0.1) -> RoundPlan:
    return RoundPlan(
        round=number,
        path_m=tuple(path),
        samples=tuple(
            PlannedSample(sample_id=f"r{number}s{k}", x_m=x, y_m=y, depth_m=depth)
            for k, (x, y) in enumerate(samples, 1)
        ),
        information_nats=0.0,
    )


def plan_of(revision: int, *rounds: RoundPlan, last: bool = False) -> MissionPlan:
    return MissionPlan(revision=revision, rounds=rounds, last=last, samples_known=0, planned_at=0)


def east(number: int, begin: float, end: float, y: float = 5.5) -> RoundPlan:
    """A round straight east, with a sample at its end."""
    return round_plan(number, [(begin, y), (end, y)], (end, y))


STAGED = ["received", "accepted", "started", "completed"]


# --- rounds -------------------------------------------------------------------------------------------------------


def test_a_round_is_driven_drilled_analysed_and_reported():
    moon = Moon()
    moon.plan(plan_of(1, round_plan(1, [(5.5, 5.5), (15.5, 5.5), (15.5, 15.5)], (10.5, 5.5), (15.5, 10.5))))
    moon.run()
    assert moon.kinds() == ["plan_accepted", "round_started", "round_completed", "parked"]
    first, second = moon.samples
    assert (first.sample_id, first.x_m, first.y_m, first.driven_m) == ("r1s1", 10.5, 5.5, 5.0)
    assert first.measured_at == seconds(50 + SAMPLE_S)
    assert first.helium3_ppb == pytest.approx(5.0 + 1.05 + sample_noise(1, "r1s1", 0.1))
    assert (second.sample_id, second.x_m, second.y_m, second.driven_m) == ("r1s2", 15.5, 10.5, 15.0)
    assert second.measured_at == seconds(150 + 2 * SAMPLE_S)
    assert (second.round, second.plan_revision, second.depth_m, second.noise_std_ppb) == (1, 1, 0.1, 0.1)
    done = moon.event("round_completed")
    assert done.samples_done == ("r1s1", "r1s2")
    assert (done.x_m, done.y_m, done.driven_m) == (15.5, 15.5, 20.0)
    assert done.at == seconds(200 + 2 * SAMPLE_S)
    assert moon.modes() == ["idle", "driving", "drilling", "analysing"] * 1 + ["driving", "drilling", "analysing"] + [
        "driving",
        "parked",
    ]
    state = moon.state
    assert (state.round, state.samples_done, state.rounds_on_board, state.plan_revision) == (1, 2, 0, 1)
    assert state.drilled_m == pytest.approx(0.2)
    assert state.heading_deg == pytest.approx(0.0)
    assert not moon.finished


def test_the_rover_looks_at_each_piece_once_before_it_drives_it():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 40.5)))
    moon.run()
    assert len([ask for ask in moon.asked if ask.topic is TERRAIN]) == 4
    assert len([ask for ask in moon.asked if ask.topic is MEASURE]) == 1


def test_a_deep_hole_takes_its_bites():
    moon = Moon()
    moon.plan(plan_of(1, round_plan(1, [START, (6.5, 5.5)], (6.5, 5.5), depth=0.35)))
    moon.run()
    assert moon.samples[0].measured_at == pytest.approx(seconds(10 + 0.35 * 3600 + ANALYSIS_S), abs=10)
    assert moon.state.drilled_m == pytest.approx(0.35)


def test_several_samples_at_one_place_are_drilled_one_after_the_other():
    moon = Moon()
    moon.plan(plan_of(1, round_plan(1, [START], START, START)))
    moon.run()
    assert [sample.sample_id for sample in moon.samples] == ["r1s1", "r1s2"]
    assert moon.state.driven_m == 0.0


def test_rounds_on_board_are_executed_one_after_the_other_and_the_last_completes_the_mission():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), east(2, 10.5, 15.5), east(3, 15.5, 20.5), last=True))
    moon.run()
    assert moon.kinds() == ["plan_accepted", *["round_started", "round_completed"] * 3, "mission_completed"]
    assert [finish.ok for finish in moon.finished] == [True]
    assert moon.state.mode is RoverMode.PARKED
    assert [sample.round for sample in moon.samples] == [1, 2, 3]


def test_a_state_is_told_each_period_and_at_each_change_of_mode():
    moon = Moon(state_period_s=60.0)
    moon.plan(plan_of(1, east(1, 5.5, 15.5)))
    moon.run(600)
    assert len(moon.states) == 1 + 10 + 3  # at the start, each minute, and at each change: driving, drilling, analysing
    at_one_minute = moon.states[2]
    assert (at_one_minute.mode, at_one_minute.x_m) == (RoverMode.DRIVING, pytest.approx(11.5))
    assert at_one_minute.driven_m == pytest.approx(6.0)
    assert at_one_minute.heading_deg == pytest.approx(90.0)


def test_the_state_tells_the_last_known_depth_of_the_queue():
    moon = Moon(state_period_s=60.0)
    moon.put(1.0, QueueDepthChanged(7))
    assert moon.run(60).state.queue_depth == 7


def test_a_restart_in_the_middle_goes_on_as_if_there_had_been_none():
    plan = plan_of(1, round_plan(1, [START, (25.5, 5.5)], (10.5, 5.5), (20.5, 5.5), depth=0.3), last=True)
    undisturbed = Moon()
    undisturbed.plan(plan)
    undisturbed.run()
    instants = sorted({at for at, _ in undisturbed.history if at > 0})
    assert len(instants) > 10
    for instant in instants:
        moon = Moon()
        moon.plan(plan)
        moon.run(instant / SECOND - 1e-9)
        reborn = RoverNode(moon.config, GRID, START, 0)
        for at, event in moon.history:
            reborn.handle(event, at)
        assert len(reborn.handle(Started(2), moon.now)) == 1
        moon.rover = reborn
        moon.run()
        assert moon.samples == undisturbed.samples
        assert moon.events == undisturbed.events


# --- plans --------------------------------------------------------------------------------------------------------


def rejection(plan: MissionPlan, *before: MissionPlan, closed_areas: bool = False) -> str:
    moon = Moon()
    for k, earlier in enumerate(before):
        moon.plan(earlier, 2000.0 * k)
    if closed_areas:
        moon.command("set_keep_out", 5000.0, area_id="pit", polygon_m=((20.0, 0.0), (30.0, 0.0), (30.0, 60.0)))
    moon.plan(plan, 50_000.0)
    moon.run(60_000.0)
    event = moon.event("plan_rejected")
    assert event.plan_revision == plan.revision
    assert event.round == plan.rounds[0].round
    assert "\n" not in event.detail
    assert moon.state.mode in (RoverMode.IDLE, RoverMode.PARKED)
    assert moon.state.plan_revision == max((p.revision for p in before), default=0)
    return event.detail


def test_a_plan_of_an_older_revision_is_rejected():
    assert "newer than 3, got 2" in rejection(plan_of(2, east(2, 10.5, 15.5)), plan_of(3, east(1, 5.5, 10.5)))


def test_another_plan_under_the_same_revision_is_rejected():
    assert "newer than 3, got 3" in rejection(plan_of(3, east(2, 10.5, 15.5)), plan_of(3, east(1, 5.5, 10.5)))


def test_the_same_plan_again_changes_nothing_and_says_nothing():
    moon = Moon()
    for at in (0.0, 10.0, 5000.0):
        moon.plan(plan_of(1, east(1, 5.5, 10.5)), at)
    moon.run()
    assert moon.kinds() == ["plan_accepted", "round_started", "round_completed", "parked"]
    assert len(moon.samples) == 1


def test_a_plan_that_leaves_out_a_round_is_rejected():
    assert "round 1 next, got 2" in rejection(plan_of(1, east(2, 5.5, 10.5)))


def test_a_plan_whose_rounds_have_all_begun_is_rejected():
    assert "all have begun" in rejection(plan_of(2, east(1, 10.5, 15.5)), plan_of(1, east(1, 5.5, 10.5)))


def test_a_plan_that_begins_elsewhere_is_rejected_with_the_distance():
    why = rejection(plan_of(1, east(1, 8.5, 15.5)))
    assert "(5.50, 5.50)" in why
    assert "3.0 m away" in why


def test_a_plan_may_begin_a_little_beside_the_rover():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 6.5, 10.5)))
    moon.run()
    assert moon.samples[0].driven_m == pytest.approx(5.0)


def test_a_plan_whose_rounds_do_not_join_is_rejected():
    assert "round 2 to begin within" in rejection(plan_of(1, east(1, 5.5, 10.5), east(2, 20.5, 25.5)))


def test_a_plan_that_leaves_the_site_is_rejected():
    assert "0..60 m east" in rejection(plan_of(1, east(1, 5.5, 60.5)))


def test_a_plan_with_a_sample_off_its_path_is_rejected():
    assert "sample r1s1" in rejection(plan_of(1, round_plan(1, [START, (15.5, 5.5)], (10.5, 8.5))))


def test_a_plan_that_repeats_a_measured_sample_is_rejected():
    again = RoundPlan(
        round=2,
        path_m=((10.5, 5.5), (15.5, 5.5)),
        samples=(PlannedSample(sample_id="r1s1", x_m=12.5, y_m=5.5, depth_m=0.1),),
        information_nats=0.0,
    )
    assert "r1s1, which is measured already" in rejection(plan_of(2, again), plan_of(1, east(1, 5.5, 10.5)))


def test_a_plan_through_a_keep_out_is_rejected():
    assert "enters keep-out pit" in rejection(plan_of(1, east(1, 5.5, 40.5)), closed_areas=True)


def test_a_plan_of_absurd_length_is_rejected():
    path = [START, *[(50.5, 5.5), START] * 600]
    assert "at most 50000 m" in rejection(plan_of(1, round_plan(1, path)))


def test_a_newer_plan_replaces_the_rounds_that_have_not_begun_and_leaves_the_one_under_way():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 15.5), east(2, 15.5, 20.5), east(3, 20.5, 25.5)))
    north = round_plan(2, [(15.5, 5.5), (15.5, 15.5)], (15.5, 15.5))
    moon.plan(plan_of(2, north), 50.0)
    moon.run()
    assert [(s.sample_id, s.plan_revision, s.x_m, s.y_m) for s in moon.samples] == [
        ("r1s1", 1, 15.5, 5.5),
        ("r2s1", 2, 15.5, 15.5),
    ]
    assert moon.kinds("round_started", "round_completed", "round_aborted") == ["round_started", "round_completed"] * 2


def test_of_a_newer_plan_the_rounds_that_have_begun_meanwhile_are_passed_over():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), east(2, 10.5, 15.5)))
    # It comes while round 2 is under way, made when that had not begun; round 3 fits where round 2 ends.
    moon.plan(plan_of(2, east(2, 10.5, 15.5), east(3, 15.5, 20.5)), 50 + SAMPLE_S + 10)
    moon.run()
    assert [(s.sample_id, s.plan_revision) for s in moon.samples] == [("r1s1", 1), ("r2s1", 1), ("r3s1", 2)]


def test_a_newer_plan_that_does_not_fit_what_has_begun_is_rejected_and_the_older_stays():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), east(2, 10.5, 15.5), east(3, 15.5, 20.5)))
    other = [round_plan(2, [(10.5, 5.5), (10.5, 30.5)], (10.5, 30.5)), east(3, 10.5, 20.5, y=30.5)]
    moon.plan(plan_of(2, *other), 50 + SAMPLE_S + 10)
    moon.run()
    assert "round 3 to begin within" in moon.event("plan_rejected").detail
    assert [(s.sample_id, s.plan_revision) for s in moon.samples] == [("r1s1", 1), ("r2s1", 1), ("r3s1", 1)]


def test_a_mission_that_was_completed_goes_on_with_a_newer_plan():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), last=True))
    moon.plan(plan_of(2, east(2, 10.5, 15.5), last=True), 10_000)
    moon.run()
    assert moon.kinds("mission_completed", "parked") == ["mission_completed"] * 2
    assert len(moon.samples) == 2


def test_a_mission_is_completed_once_whatever_the_rover_does_afterwards():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 10.5), last=True))
    moon.command("go_to", 5000, target_m=START)
    moon.run()
    assert moon.kinds("mission_completed", "parked") == ["mission_completed", "parked"]
    assert len(moon.finished) == 1


# --- terrain ------------------------------------------------------------------------------------------------------


def wall(x: float, y: float) -> bool:
    return 20 <= x < 22 and y < 40


def test_the_rover_stops_before_terrain_that_contradicts_the_plan_and_goes_safe():
    moon = Moon(wall)
    moon.plan(plan_of(1, round_plan(1, [START, (40.5, 5.5)], (10.5, 5.5), (30.5, 5.5)), east(2, 40.5, 45.5)))
    moon.run()
    assert moon.kinds() == [
        "plan_accepted",
        "round_started",
        "blocked",
        "round_aborted",
        "safe_mode_entered",
    ]
    blocked = moon.event("blocked")
    assert blocked.obstacle_m is not None
    assert wall(*blocked.obstacle_m)
    assert math.dist(blocked.obstacle_m, (20.0, 5.5)) < 0.8  # the nearest of them, at the side
    assert (blocked.x_m, blocked.y_m) == pytest.approx((10.5, 5.5))
    assert blocked.samples_done == ("r1s1",)
    assert (blocked.round, blocked.plan_revision) == (1, 1)
    assert moon.event("round_aborted").samples_done == ("r1s1",)
    assert moon.state.mode is RoverMode.SAFE
    assert moon.state.rounds_on_board == 0


def test_from_safe_mode_before_an_obstacle_a_newer_plan_leads_on():
    moon = Moon(wall)
    moon.plan(plan_of(1, east(1, 5.5, 40.5)))
    moon.run(5000)
    here = moon.place
    around = round_plan(2, [here, (here[0], 45.5), (30.5, 45.5)], (30.5, 45.5))
    moon.plan(plan_of(2, around), 5000)
    moon.run()
    assert moon.kinds("safe_mode_left", "round_completed") == ["safe_mode_left", "round_completed"]
    assert [sample.sample_id for sample in moon.samples] == ["r2s1"]


def test_a_round_that_was_aborted_may_be_planned_again_for_what_it_lacks():
    moon = Moon(wall)
    moon.plan(plan_of(1, round_plan(1, [START, (40.5, 5.5)], (10.5, 5.5), (30.5, 5.5))))
    moon.run(5000)
    here = moon.place
    rest = RoundPlan(
        round=1,
        path_m=(here, (here[0], 45.5)),
        samples=(PlannedSample(sample_id="r1s2", x_m=here[0], y_m=45.5, depth_m=0.1),),
        information_nats=0.0,
    )
    moon.plan(plan_of(2, rest, last=True), 5000)
    moon.run()
    assert [sample.sample_id for sample in moon.samples] == ["r1s1", "r1s2"]
    assert len(moon.finished) == 1


def test_a_rover_that_stands_on_bad_ground_may_leave_it():
    moon = Moon(lambda x, y: x < 7)
    moon.plan(plan_of(1, east(1, 5.5, 15.5)))
    moon.run()
    assert moon.kinds("blocked", "round_completed") == ["round_completed"]


# --- energy -------------------------------------------------------------------------------------------------------

# Full sun bears drilling; at half of it a bite takes (150 + 200 - 225) W.
THIRSTY: dict[str, Any] = {"solar_w": 225.0, "capacity_wh": 100.0, "reserve": 0.5, "resume_charge": 0.9}


def test_on_low_energy_the_rover_goes_safe_charges_and_goes_on_where_it_stopped():
    moon = Moon(**THIRSTY)
    moon.plan(plan_of(1, round_plan(1, [START, (10.5, 5.5)], (10.5, 5.5), depth=1.0)))
    moon.run()
    around_one_stop = ["low_energy", "safe_mode_entered", "charged", "safe_mode_left"]
    low = moon.kinds("low_energy", "safe_mode_entered", "charged", "safe_mode_left")
    assert low == around_one_stop * (len(low) // 4)
    assert len(low) >= 8
    assert moon.kinds("round_completed", "round_aborted") == ["round_completed"]
    assert len(moon.samples) == 1
    assert moon.state.drilled_m == pytest.approx(1.0)
    assert min(state.energy_wh for state in moon.states) >= 50.0 - 1e-6
    assert "charging" in moon.modes()
    entered = next(event for event in moon.events if event.kind is EventKind.SAFE_MODE_ENTERED)
    left = next(event for event in moon.events if event.kind is EventKind.SAFE_MODE_LEFT)
    assert entered.at < left.at


def test_the_way_is_counted_in_before_it_is_driven():
    # In the dark a piece of 10 m takes 100 s at 150 W and 2400 J: 4.83 Wh.
    moon = Moon(solar_w=0.0, capacity_wh=100.0, reserve=0.9, resume_charge=0.95)
    moon.plan(plan_of(1, east(1, 5.5, 45.5)))
    moon.run()
    assert moon.state.driven_m == pytest.approx(20.0)
    assert moon.state.mode is RoverMode.SAFE
    assert "4.8 Wh" in moon.event("low_energy").detail
    assert moon.kinds("charged") == []


def test_a_step_that_no_battery_can_bear_leaves_the_rover_safe_until_a_plan_that_it_can():
    moon = Moon(solar_w=160.0, capacity_wh=10.0, drill_w=1000.0, reserve=0.2, resume_charge=0.9)
    moon.plan(plan_of(1, east(1, 5.5, 10.5)))
    moon.run()
    assert moon.state.mode is RoverMode.SAFE
    assert moon.kinds("safe_mode_entered") == ["safe_mode_entered"]


def test_pausing_a_charging_rover_keeps_it_standing_when_it_is_charged():
    moon = Moon(**THIRSTY)
    moon.plan(plan_of(1, round_plan(1, [START, (10.5, 5.5)], (10.5, 5.5), depth=1.0)))
    moon.run(2000)
    assert moon.state.mode is RoverMode.CHARGING
    rejected = moon.command("resume", 2000)
    moving = moon.command("go_to", 2001, target_m=(20.5, 20.5))
    paused = moon.command("pause", 2010)
    moon.run(50_000)
    assert moon.stages(rejected) == ["received", "rejected"]
    assert "goes on by itself" in moon.why(rejected)
    assert "charges" in moon.why(moving)
    assert moon.stages(paused) == STAGED
    assert moon.state.mode is RoverMode.PAUSED
    moon.command("resume", 50_000)
    moon.run(200_000)
    assert len(moon.samples) == 1


# --- instruments --------------------------------------------------------------------------------------------------


def test_a_silent_instrument_is_asked_again_and_told_of_once():
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


def test_an_answer_to_an_outdated_question_changes_nothing():
    moon = Moon()
    moon.refuses[MEASURE] = (NoReply.TIMEOUT, "")
    moon.plan(plan_of(1, east(1, 5.5, 10.5)))
    moon.run(1000)
    stale = next(ask for ask in moon.asked if ask.topic is MEASURE)
    moon.refuses.clear()
    answer = moon._answer(stale)
    assert moon.rover.handle(answer, moon.now) == []
    moon.run()
    assert len(moon.samples) == 1


# --- telecommands -------------------------------------------------------------------------------------------------


def under_way(depth: float = 0.5, **config: Any) -> Moon:
    """A rover that drives 20 m and drills half a metre: driving to 200 s, drilling to 2000 s, analysing to 2300 s."""
    moon = Moon(**config)
    moon.plan(plan_of(1, round_plan(1, [START, (25.5, 5.5)], (25.5, 5.5), depth=depth), east(2, 25.5, 35.5)))
    return moon


def test_pause_takes_effect_at_the_end_of_the_piece_and_resume_goes_on():
    moon = under_way()
    pause = moon.command("pause", 30)
    moon.run(5000)
    assert moon.stages(pause) == STAGED
    assert [report.at for report in moon.reports] == [seconds(30), seconds(30), seconds(100), seconds(100)]
    assert moon.state.mode is RoverMode.PAUSED
    assert moon.place == pytest.approx((15.5, 5.5))
    resume = moon.command("resume", 5000)
    moon.run()
    assert moon.stages(resume) == STAGED
    assert moon.kinds("paused", "resumed", "round_completed") == ["paused", "resumed", *["round_completed"] * 2]
    assert moon.samples[0].measured_at == seconds(2300 + 4900)


def test_pause_takes_effect_at_the_end_of_the_bite():
    moon = under_way()
    moon.command("pause", 300)
    moon.run(5000)
    assert moon.event("paused").at == seconds(560)
    assert moon.state.drilled_m == pytest.approx(0.1)
    moon.command("resume", 5000)
    moon.run()
    assert moon.samples[0].measured_at == seconds(5000 + 4 * BITE_S + ANALYSIS_S)
    assert moon.samples[0].depth_m == 0.5


def test_pause_takes_effect_at_the_end_of_the_analysis_and_the_number_is_asked_for_afterwards():
    moon = under_way()
    moon.command("pause", 2100)
    moon.run(5000)
    assert moon.event("paused").at == seconds(2300)
    assert not moon.samples
    moon.command("resume", 5000)
    moon.run(5000)
    assert moon.samples[0].measured_at == seconds(5000)


def test_a_rover_that_waits_for_a_silent_instrument_pauses_at_once():
    moon = under_way()
    moon.refuses[MEASURE] = (NoReply.TIMEOUT, "")
    moon.command("pause", 2417)
    moon.run(3000)
    assert moon.event("paused").at == seconds(2417)
    asked = len(moon.asked)
    moon.run(10_000)
    assert len(moon.asked) == asked
    moon.refuses.clear()
    moon.command("resume", 10_000)
    moon.run()
    assert [sample.sample_id for sample in moon.samples] == ["r1s1", "r2s1"]


def test_a_paused_rover_takes_plans_on_board_and_begins_none():
    moon = Moon()
    moon.command("pause", 1)
    moon.plan(plan_of(1, east(1, 5.5, 10.5)), 10)
    moon.run(5000)
    assert moon.kinds() == ["paused", "plan_accepted"]
    assert moon.state.rounds_on_board == 1
    moon.command("resume", 5000)
    moon.run()
    assert len(moon.samples) == 1


def test_pausing_twice_is_pausing_once():
    moon = under_way()
    moon.command("pause", 30)
    second = moon.command("pause", 500)
    moon.run(1000)
    assert moon.stages(second) == STAGED
    assert moon.kinds("paused") == ["paused"]


def test_resume_of_a_rover_that_nothing_holds_is_rejected():
    moon = under_way()
    resume = moon.command("resume", 30)
    moon.run()
    assert moon.stages(resume) == ["received", "rejected"]
    assert "neither" in moon.why(resume)


def test_abort_round_drops_the_round_at_the_next_safe_point_and_those_behind_it():
    moon = under_way()
    abort = moon.command("abort_round", 300)
    moon.run()
    assert moon.stages(abort) == STAGED
    assert moon.kinds() == ["plan_accepted", "round_started", "round_aborted", "parked"]
    assert moon.event("round_aborted").at == seconds(560)
    assert moon.state.rounds_on_board == 0
    assert not moon.samples
    moon.plan(plan_of(2, east(2, 25.5, 30.5)), DAY_S)
    moon.run(2 * DAY_S)
    assert [sample.sample_id for sample in moon.samples] == ["r2s1"]


def test_abort_of_no_round_is_rejected():
    moon = Moon()
    abort = moon.command("abort_round", 1)
    assert "no round" in moon.run().why(abort)


def test_a_paused_round_can_be_aborted_and_the_rover_stays_paused():
    moon = under_way()
    moon.command("pause", 30)
    abort = moon.command("abort_round", 500)
    moon.run(1000)
    assert moon.stages(abort) == STAGED
    assert moon.state.mode is RoverMode.PAUSED
    moon.command("resume", 1000)
    assert moon.run().state.mode is RoverMode.PARKED


def test_go_to_drives_straight_there_and_completes_on_arrival():
    moon = Moon()
    go = moon.command("go_to", 10, target_m=(5.5, 35.5))
    moon.run()
    assert moon.stages(go) == STAGED
    assert moon.reports[-1].at == seconds(310)
    assert moon.place == (5.5, 35.5)
    assert moon.kinds() == ["parked"]


def test_go_to_gives_up_the_round_under_way():
    moon = under_way()
    go = moon.command("go_to", 30, target_m=(15.5, 15.5))
    moon.run()
    assert moon.stages(go) == STAGED
    assert moon.kinds() == ["plan_accepted", "round_started", "round_aborted", "parked"]
    assert go in moon.event("round_aborted").detail


def test_go_to_leaves_safe_mode():
    moon = Moon(wall)
    moon.plan(plan_of(1, east(1, 5.5, 40.5)))
    go = moon.command("go_to", 5000, target_m=START)
    moon.run()
    assert moon.stages(go) == STAGED
    assert moon.kinds("safe_mode_entered", "safe_mode_left") == ["safe_mode_entered", "safe_mode_left"]
    assert moon.place == START


def test_go_to_stops_before_closed_terrain_and_fails():
    moon = Moon(wall)
    go = moon.command("go_to", 10, target_m=(40.5, 5.5))
    moon.run()
    assert moon.stages(go) == ["received", "accepted", "started", "failed"]
    assert "closed terrain" in moon.why(go)
    assert moon.event("blocked").round == 0
    assert moon.state.mode is RoverMode.SAFE
    assert moon.place[0] < 20 - 0.8


def test_go_to_beyond_the_site_is_rejected():
    moon = Moon()
    go = moon.command("go_to", 10, target_m=(61.0, 5.5))
    moon.run()
    assert moon.stages(go) == ["received", "rejected"]
    assert "0..60 m east" in moon.why(go)


def test_go_to_replaces_a_go_to_under_way():
    moon = Moon()
    first = moon.command("go_to", 10, target_m=(5.5, 55.5))
    second = moon.command("go_to", 20, target_m=(55.5, 15.5))
    moon.run()
    assert moon.stages(first) == ["received", "accepted", "started", "failed"]
    assert second in moon.why(first)
    assert moon.stages(second) == STAGED
    assert moon.place == (55.5, 15.5)


def test_a_paused_errand_is_resumed():
    moon = Moon()
    go = moon.command("go_to", 10, target_m=(5.5, 55.5))
    moon.command("pause", 20)
    moon.command("resume", 5000)
    moon.run()
    assert moon.stages(go) == STAGED
    assert moon.reports[-1].at == seconds(5000 + 400)


def test_plans_on_board_that_an_errand_makes_useless_are_told_of():
    moon = Moon()
    moon.command("pause", 1)
    moon.plan(plan_of(1, east(1, 5.5, 10.5)), 10)
    moon.command("go_to", 20, target_m=(30.5, 30.5))
    moon.run()
    assert "will not be where" in moon.event("plan_rejected").detail
    assert moon.state.rounds_on_board == 0


def test_a_plan_from_where_an_errand_leads_is_executed_after_it():
    moon = Moon()
    moon.command("go_to", 10, target_m=(5.5, 25.5))
    moon.plan(plan_of(1, east(1, 5.5, 10.5, y=25.5)), 20)
    moon.run()
    assert len(moon.samples) == 1


def test_return_to_start_drives_the_own_track_back():
    moon = Moon(state_period_s=5.0)
    track = [START, (25.5, 5.5), (25.5, 25.5), (15.5, 25.5)]
    moon.plan(plan_of(1, round_plan(1, track)))
    home = moon.command("return_to_start", 1000)
    moon.run(5000)
    assert moon.stages(home) == STAGED
    assert moon.place == START
    assert moon.state.driven_m == pytest.approx(100.0)
    for state in moon.states:
        assert any(
            min(math.dist((state.x_m, state.y_m), (a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])))
                for s in np.linspace(0, 1, 401)) < 0.1
            for a, b in itertools.pairwise(track)
        )  # fmt: skip


def test_at_the_start_return_to_start_completes_at_once():
    moon = Moon()
    home = moon.command("return_to_start", 10)
    moon.run()
    assert moon.stages(home) == STAGED
    assert {report.at for report in moon.reports} == {seconds(10)}


def test_safe_holds_the_rover_against_newer_plans_until_resume():
    moon = under_way()
    safe = moon.command("safe", 30)
    moon.plan(plan_of(2, east(2, 25.5, 40.5)), 1000)
    moon.run(5000)
    assert moon.stages(safe) == STAGED
    assert moon.state.mode is RoverMode.SAFE
    assert moon.kinds("plan_accepted", "plan_rejected") == ["plan_accepted"] * 2
    pause = moon.command("pause", 5000)
    resume = moon.command("resume", 5100)
    moon.run()
    assert "safe mode already" in moon.why(pause)
    assert moon.stages(resume) == STAGED
    assert [(s.sample_id, s.x_m) for s in moon.samples] == [("r1s1", 25.5), ("r2s1", 40.5)]


def test_resume_before_an_obstacle_parks_the_rover_there():
    moon = Moon(wall)
    moon.plan(plan_of(1, east(1, 5.5, 40.5)))
    moon.command("resume", 5000)
    moon.run()
    assert moon.kinds()[-2:] == ["safe_mode_left", "parked"]


# --- keep-outs ----------------------------------------------------------------------------------------------------

PIT = ((20.0, 0.0), (30.0, 0.0), (30.0, 20.0), (20.0, 20.0))


def test_a_keep_out_set_on_the_way_stops_the_rover_before_it():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 50.5)))
    area = moon.command("set_keep_out", 50, area_id="pit", polygon_m=PIT)
    moon.run()
    assert moon.stages(area) == STAGED
    assert {report.at for report in moon.reports} == {seconds(50)}
    assert "keep-out pit" in moon.event("blocked").detail
    assert moon.state.mode is RoverMode.SAFE
    assert moon.place == pytest.approx((15.5, 5.5))
    assert moon.event("blocked").obstacle_m == pytest.approx((20.0 - 0.8, 5.5), abs=0.02)


def test_a_keep_out_set_over_the_rover_stops_it_and_lets_a_newer_plan_lead_it_out():
    moon = Moon()
    moon.plan(plan_of(1, east(1, 5.5, 50.5)))
    wide = ((20.0, 0.0), (45.0, 0.0), (45.0, 20.0), (20.0, 20.0))
    moon.command("set_keep_out", 230, area_id="pit", polygon_m=wide)
    moon.run(5000)
    assert moon.state.mode is RoverMode.SAFE
    assert moon.place == pytest.approx((35.5, 5.5))
    here = moon.place
    moon.plan(plan_of(2, round_plan(2, [here, (here[0], 40.5)], (here[0], 40.5))), 5000)
    moon.run()
    assert [sample.sample_id for sample in moon.samples] == ["r2s1"]


def test_a_keep_out_that_is_removed_is_open_again():
    moon = Moon()
    moon.command("set_keep_out", 1, area_id="pit", polygon_m=PIT)
    closed = moon.command("go_to", 2, target_m=(25.5, 5.5))
    across = moon.command("go_to", 3, target_m=(50.5, 5.5))
    moon.command("set_keep_out", 4, area_id="pit")
    moon.command("go_to", 5, target_m=(50.5, 5.5))
    moon.run()
    assert "within a keep-out" in moon.why(closed)
    assert "enters keep-out pit" in moon.why(across)
    assert moon.place == (50.5, 5.5)


def test_removing_a_keep_out_that_is_not_there_is_rejected():
    moon = Moon()
    area = moon.command("set_keep_out", 1, area_id="pit")
    assert "no keep-out pit" in moon.run().why(area)


# --- at most once, in order, in time ------------------------------------------------------------------------------


def test_a_command_that_comes_after_its_time_expires():
    moon = under_way()
    pause = moon.command("pause", 30, expires_s=29.0)
    moon.run()
    assert moon.stages(pause) == ["received", "expired"]
    assert moon.kinds("paused") == []


def test_a_command_for_which_no_safe_point_comes_in_time_expires():
    moon = under_way()
    pause = moon.command("pause", 30, expires_s=60.0)
    moon.run()
    assert moon.stages(pause) == ["received", "accepted", "expired"]
    assert moon.kinds("paused") == []


def test_a_command_is_carried_out_at_the_very_instant_at_which_it_expires():
    moon = Moon()
    pause = moon.command("pause", 30, expires_s=30.0)
    assert moon.run().stages(pause) == STAGED


def test_a_command_received_twice_is_executed_once_and_reported_on_again():
    moon = under_way()
    moon.command("pause", 30, "c1")
    moon.command("resume", 500, "c2")
    moon.command("pause", 600, "c1", made_s=30)
    moon.run()
    assert moon.kinds("paused") == ["paused"]
    assert moon.stages("c1") == [*STAGED, "completed"]
    first, again = (
        [report for report in moon.reports if report.stage is CommandStage.COMPLETED][:2][0],
        moon.reports[-1],
    )
    assert first == again


def test_another_command_under_a_known_id_is_ignored():
    moon = under_way()
    moon.command("pause", 30, "c1")
    moon.command("abort_round", 500, "c1")
    moon.run()
    assert moon.stages("c1") == STAGED
    assert moon.kinds("round_aborted") == []


def test_a_pause_that_comes_after_the_resume_that_was_to_end_it_is_rejected():
    moon = under_way()
    resume = moon.command("resume", 30, made_s=20)
    pause = moon.command("pause", 40, made_s=10)
    moon.run()
    assert moon.stages(resume) == ["received", "rejected"]
    assert moon.stages(pause) == ["received", "rejected"]
    assert f"resume {resume} was made later" in moon.why(pause)
    assert len(moon.samples) == 2


def test_going_safe_is_never_out_of_date():
    moon = under_way()
    moon.command("pause", 30, made_s=20)
    safe = moon.command("safe", 40, made_s=10)
    moon.run()
    assert moon.stages(safe) == STAGED


def test_an_older_word_on_a_keep_out_does_not_undo_a_newer_one():
    moon = Moon()
    moon.command("set_keep_out", 30, area_id="pit", polygon_m=PIT, made_s=20)
    older = moon.command("set_keep_out", 40, area_id="pit", polygon_m=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)), made_s=10)
    other = moon.command("set_keep_out", 50, area_id="hole", polygon_m=PIT, made_s=15)
    moon.run()
    assert moon.stages(older) == ["received", "rejected"]
    assert moon.stages(other) == STAGED


def test_commands_that_wait_are_carried_out_in_their_order():
    moon = under_way()
    pause, resume = moon.command("pause", 30), moon.command("resume", 40)
    moon.run()
    assert moon.stages(pause) == moon.stages(resume) == STAGED
    assert moon.kinds("paused", "resumed") == ["paused", "resumed"]
    assert moon.samples[0].measured_at == seconds(2300)


def test_a_command_that_waited_and_no_longer_makes_sense_fails():
    moon = under_way()
    moon.command("pause", 30)
    first, second = moon.command("resume", 31), moon.command("resume", 32)
    moon.run()
    assert moon.stages(first) == STAGED
    assert moon.stages(second) == ["received", "accepted", "failed"]


def test_the_queue_of_commands_is_bounded():
    moon = under_way()
    ids = [moon.command("pause", 30 + k / 10) for k in range(40)]
    moon.run(1000)
    assert [moon.stages(name)[-1] for name in ids] == ["completed"] * 32 + ["rejected"] * 8
    assert "at most 32" in moon.why(ids[-1])


# --- the watchdog -------------------------------------------------------------------------------------------------


def test_without_a_word_from_the_ground_a_parked_rover_goes_safe_and_a_plan_ends_that():
    moon = Moon(watchdog_s=1000.0)
    moon.plan(plan_of(1, east(1, 5.5, 10.5)), 900)
    moon.plan(plan_of(2, east(2, 10.5, 15.5)), 20_000)
    moon.run(21_000)
    parked = moon.events[3]
    assert parked.kind is EventKind.PARKED
    entered, left = moon.event("safe_mode_entered"), moon.event("safe_mode_left")
    assert entered.at == parked.at + seconds(1000)
    assert left.at == seconds(20_000)
    assert len(moon.samples) == 2


def test_a_rover_with_something_to_do_needs_no_word_from_the_ground():
    moon = Moon(watchdog_s=1000.0)
    moon.plan(plan_of(1, *(east(k, 5.5 * k, 5.5 * (k + 1)) for k in range(1, 8))))
    moon.run(7 * (55 + SAMPLE_S))
    assert moon.kinds("safe_mode_entered") == []
    assert len(moon.samples) == 7


# --- whatever the plan and the terrain ----------------------------------------------------------------------------

inner = st.floats(1.0, 59.0)


@st.composite
def rough_regions(draw: st.DrawFn) -> Region:
    boulders = draw(st.lists(st.tuples(inner, inner, st.floats(0.3, 6)), max_size=12))

    def closed(x: float, y: float) -> bool:
        if math.dist((x, y), START) < 2.5:
            return False
        return any(math.dist((x, y), (bx, by)) <= radius for bx, by, radius in boulders)

    return region(closed)


@st.composite
def any_rounds(draw: st.DrawFn) -> list[RoundPlan]:
    place, rounds = START, []
    for number in range(1, draw(st.integers(1, 3)) + 1):
        path = [place, *draw(st.lists(st.tuples(inner, inner), min_size=1, max_size=5))]
        vertices = sorted(draw(st.sets(st.integers(0, len(path) - 1), max_size=3)))
        rounds.append(round_plan(number, path, *(path[k] for k in vertices)))
        place = path[-1]
    return rounds


@settings(max_examples=60)
@given(rough_regions(), any_rounds(), st.floats(0.1, 1.0))
def test_the_rover_never_enters_closed_terrain_and_its_odometer_is_the_way_it_drove(land, rounds, radius):
    moon = Moon(land=land, state_period_s=4.0, footprint_radius_m=radius, drill_s_per_m=10.0, analysis_s=1.0)
    moon.plan(plan_of(1, *rounds, last=True))
    for until_s in range(500, 12_000, 500):
        if moon.run(until_s).finished or moon.states[-1].mode is RoverMode.SAFE:
            break
    right = np.radians([state.heading_deg + 90 for state in moon.states])
    middle = np.array([(state.x_m, state.y_m) for state in moon.states])
    for side in (-0.9, 0.0, 0.9):
        covered = middle + side * radius * np.column_stack((np.sin(right), np.cos(right)))
        assert land.traversable[GRID.cells_of(np.clip(covered, 0, 60))].all()
    way = [START, *[vertex for planned in rounds for vertex in planned.path_m]]
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(way))
    count = sum(len(planned.samples) for planned in rounds)
    # A sample may be taken where the path first comes near to it; then the rover drives there and back.
    detours_m = 2 * SAMPLE_TOLERANCE_M * count
    if moon.finished:
        assert -1e-6 <= moon.state.driven_m - length <= detours_m + 1e-6
        assert len(moon.samples) == count
    else:
        assert moon.state.mode is RoverMode.SAFE
        assert moon.state.driven_m < length + detours_m
    drilled = {(sample.x_m, sample.y_m) for sample in moon.samples}
    assert drilled <= {(s.x_m, s.y_m) for planned in rounds for s in planned.samples}


KINDS = [kind.value for kind in CommandKind]


@settings(max_examples=60)
@given(
    any_rounds(),
    st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 6000), st.integers(0, 6000), inner, inner), max_size=15),
    st.booleans(),
)
def test_whatever_is_commanded_every_command_ends_once_and_no_sample_is_taken_twice(rounds, commands, hungry):
    moon = Moon(wall, **(THIRSTY if hungry else {}))
    moon.plan(plan_of(1, *rounds, last=True))
    for k, (kind, at, made, x, y) in enumerate(commands):
        fields: dict[str, Any] = {}
        if kind == "go_to":
            fields = {"target_m": (x, y)}
        elif kind == "set_keep_out":
            fields = {"area_id": "a", "polygon_m": ((x, y), (x + 4, y), (x, y + 4))}
        moon.command(kind, at, f"c{k}", made_s=made, **fields)
    moon.run(20 * DAY_S)
    ends = {"completed", "failed", "rejected", "expired"}
    for k in range(len(commands)):
        stages = moon.stages(f"c{k}")
        under_hold = moon.state.mode in (RoverMode.PAUSED, RoverMode.SAFE)
        assert sum(stage in ends for stage in stages) == 1 or (under_hold and stages[-1] == "started"), stages
        assert stages[0] == "received"
    ids = [sample.sample_id for sample in moon.samples]
    assert len(ids) == len(set(ids))
    assert moon.state.mode in (RoverMode.PARKED, RoverMode.PAUSED, RoverMode.SAFE)


# --- speed --------------------------------------------------------------------------------------------------------


def test_a_mission_of_15_km_and_150_samples_costs_the_rover_less_than_a_second():
    corners = [START, (55.5, 5.5), (55.5, 55.5), (5.5, 55.5)]
    moon = Moon(state_period_s=60.0)
    rounds = [
        round_plan(k, [*corners, *corners, *corners[:2], START][:11], *corners[:3], *corners[:2]) for k in range(1, 31)
    ]
    moon.plan(plan_of(1, *rounds, last=True))
    spent = 0.0
    handle = moon.rover.handle

    def timed(event: Event, now: int) -> list[Effect]:
        nonlocal spent
        begin = time.process_time()
        effects = handle(event, now)
        spent += time.process_time() - begin
        return effects

    moon.rover.handle = timed  # type: ignore[method-assign]
    moon.run(10 * DAY_S)
    assert moon.finished
    assert moon.states[-1].samples_done == 150
    assert moon.states[-1].driven_m >= 15_000
    expect_within(1.0, spent, "the rover of a mission of 15 km", time.process_time)

"""The ground station through a whole mission, with a rover that executes every plan at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from he3.errors import He3Error, InvalidInput, NoRoute
from he3.frames import SiteGrid
from he3.reference import Region
from schemas.codec import decode, encode
from schemas.commands import CommandKind, CommandReport, CommandStage, CommandStatus, NoParameters, Telecommand
from schemas.ground import GroundStatus, InterestChange, MissionPhase
from schemas.maps import MapPointQuery
from schemas.plans import MissionPlan, PlanDecision, PlannedSample, PlanProposal, PlanReview, PlanVerdict, RoundPlan
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState, SampleReport
from schemas.topics import (
    COMMAND,
    COMMAND_REPORT,
    COMMAND_STATUS,
    DECIDE_PLAN,
    EVENT,
    GROUND_STATUS,
    ISSUE_COMMAND,
    LIST_COMMANDS,
    MAP_POINT,
    MAP_SCORE,
    PLAN,
    SAMPLE,
    SET_INTEREST,
    SHOW_PLAN,
    STATE,
    TRACK,
    Side,
    Topic,
)
from schemas.wire import Header, Wire
from services.ground.map.snapshot import MapSnapshot
from services.ground.node import GroundNode, build_node
from services.ground.planners.interface import PlannedRound, Planner, PlanningRequest
from services.ground.planners.traversability import OpenGround
from services.mission.mission_time import SECOND, seconds
from services.mission.scenario import Scenario
from services.runtime.drivers.simulation import Simulation
from services.runtime.node import (
    Effect,
    Event,
    Finish,
    Interface,
    Level,
    QueryReceived,
    Received,
    Send,
    SendReply,
    SetTimer,
    TimerFired,
)
from services.runtime.state_codec import StateCodec

GRID = SiteGrid(60, 60)
START = (5.0, 5.0)


def region(closed: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None) -> Region:
    field = smooth_field()
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    open_cells = np.ones(GRID.shape, dtype=np.bool_) if closed is None else ~closed(x, y)
    return Region(
        name="test",
        title="a test",
        provenance="made for tests",
        grid=GRID,
        he3_ppb=field,
        orbital_ppb=np.full(GRID.shape, float(field.mean())),
        elevation_m=np.zeros(GRID.shape),
        slope_deg=np.zeros(GRID.shape),
        traversable=open_cells,
    )


def smooth_field() -> np.ndarray:
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    return 8.0 + 2.0 * np.sin(x / 9.0) * np.cos(y / 11.0) + 0.02 * x


def scenario(**changes: dict[str, object]) -> Scenario:
    base = Scenario(name="test", region="unused.npz", rounds=4, samples_per_round=3, start_m=START, seed=11)
    return base.changed(**changes) if changes else base


def straight(request: PlanningRequest) -> PlannedRound:
    """A planner: places at random in the open, straight from one to the next over open ground."""
    rng = np.random.default_rng(request.seed)
    ground = OpenGround(request.grid, request.traversable)
    cells = np.argwhere(request.traversable)
    for _ in range(1000):
        chosen = cells[rng.choice(len(cells), size=request.samples, replace=False)]
        places = (chosen[:, ::-1] + 0.5) * request.grid.resolution_m
        path = np.vstack((np.array([request.start_m]), places))
        if ground.segments_free(np.vstack((ground.footing(request.start_m), places[:-1])), places).all():
            break
    if float(np.hypot(*np.diff(path, axis=0).T).sum()) > request.budget_m:
        raise NoRoute(f"the budget of {request.budget_m:g} m does not reach")
    return PlannedRound(path, places, 1.0)


class Rover:
    """Executes every round that it is given, in order: an hour a round, half a light time away."""

    def __init__(self, field: np.ndarray, light_s: float = 1.0, round_s: float = 3600.0) -> None:
        self.interface = Interface("rover", (Side.EARTH,), subscribes=(PLAN, COMMAND))
        self.plans: list[tuple[int, MissionPlan]] = []
        self.commands: list[Telecommand] = []
        self.begun = 0
        self.on_board: list[RoundPlan] = []
        self.place = START
        self.driven = 0.0
        self.executing: RoundPlan | None = None
        self.revision = 0
        self.trouble: Callable[[RoundPlan], str | None] = lambda planned: None
        self.reject: Callable[[MissionPlan], str | None] = lambda plan: None
        self.obstacle_ahead_m = 3.0
        self.shuffle = False
        self.twice = False
        self.skip: set[str] = set()
        self.idle_s = 0.0
        self.idle_since: int | None = None
        self._field = field
        self._light_s = light_s
        self._round_s = round_s
        self._last = 0
        self._queue: list[tuple[int, Send]] = []
        self._arriving: list[tuple[int, Received]] = []

    def handle(self, event: Event, now: int) -> Iterable[Effect]:
        match event:
            case Received(_, _, Telecommand() as command):
                self.commands.append(command)
            case Received(_, _, MissionPlan()):
                self._arriving.append((now + seconds(self._light_s), event))
            case TimerFired("round"):
                yield from self._round_over(now)
        for due, message in [entry for entry in self._arriving if entry[0] <= now]:
            self._arriving.remove((due, message))
            yield from self._told(message.body, now)
        yield from self._downlinked(now)
        times = [at for at, _ in self._queue] + [at for at, _ in self._arriving]
        yield SetTimer("wake", min(times) if times else None)

    def _downlinked(self, now: int) -> Iterable[Effect]:
        due = [entry for entry in self._queue if entry[0] <= now]
        self._queue = [entry for entry in self._queue if entry[0] > now]
        if self.shuffle:
            due.reverse()
        for _, send in due:
            yield send
            if self.twice:
                yield send

    def _down(self, send: Send, now: int) -> None:
        self._queue.append((now + seconds(self._light_s), send))

    def _say(self, kind: EventKind, now: int, **more: object) -> None:
        fields: dict[str, object] = {
            "kind": kind, "at": now, "x_m": self.place[0], "y_m": self.place[1], "driven_m": self.driven,
            "plan_revision": self.revision, "round": self.begun,
        }  # fmt: skip
        self._down(Send(EVENT, RoverEvent(**{**fields, **more})), now)

    def _told(self, body: object, now: int) -> Iterable[Effect]:
        if not isinstance(body, MissionPlan):
            return []
        self.plans.append((now, body))
        why = self.reject(body)
        if why is None and body.revision <= self.revision:
            why = "stale"
        rounds = [planned for planned in body.rounds if planned.round > self.begun]
        end = self.executing.path_m[-1] if self.executing else self.place
        if why is None and not rounds:
            why = "all have begun"
        if why is None and np.hypot(rounds[0].path_m[0][0] - end[0], rounds[0].path_m[0][1] - end[1]) > 2.0:
            why = "it begins elsewhere"
        if why is not None:
            self._say(EventKind.PLAN_REJECTED, now, plan_revision=body.revision, detail=why)
            return []
        self.revision, self.on_board = body.revision, rounds
        self._last = rounds[-1].round if body.last else 0
        self._say(EventKind.PLAN_ACCEPTED, now)
        return self._next(now) if self.executing is None else []

    def _next(self, now: int) -> Iterable[Effect]:
        if not self.on_board:
            self.idle_since = now
            return []
        if self.idle_since is not None:
            self.idle_s += (now - self.idle_since) / SECOND
            self.idle_since = None
        self.executing = self.on_board.pop(0)
        self.begun = self.executing.round
        self._say(EventKind.ROUND_STARTED, now)
        return [SetTimer("round", now + seconds(self._round_s))]

    def _round_over(self, now: int) -> Iterable[Effect]:
        planned = self.executing
        assert planned is not None
        self.executing = None
        trouble = self.trouble(planned)
        done = planned.samples[:1] if trouble else planned.samples
        taken = [sample for sample in done if sample.sample_id not in self.skip]
        for sample in done:
            if sample.sample_id in self.skip:
                self._say(EventKind.SAMPLE_SKIPPED, now, sample_id=sample.sample_id, detail="no answer")
                continue
            self._measured(planned, sample, now)
        ids = tuple(sample.sample_id for sample in taken)
        if trouble:
            self.on_board = []
            ahead = (self.place[0] + self.obstacle_ahead_m, self.place[1])
            self._say(EventKind.BLOCKED, now, detail=trouble, obstacle_m=ahead, samples_done=ids)
            self._say(EventKind.ROUND_ABORTED, now, detail=trouble, samples_done=ids)
            return []
        self.place = planned.path_m[-1]
        self._say(EventKind.ROUND_COMPLETED, now, samples_done=ids)
        if planned.round == self._last:
            self._say(EventKind.MISSION_COMPLETED, now)
        return self._next(now)

    def _measured(self, planned: RoundPlan, sample: PlannedSample, now: int) -> None:
        self.driven += float(np.hypot(sample.x_m - self.place[0], sample.y_m - self.place[1]))
        self.place = (sample.x_m, sample.y_m)
        row, column = int(sample.y_m), int(sample.x_m)
        report = SampleReport(
            sample_id=sample.sample_id, round=planned.round, plan_revision=self.revision, x_m=sample.x_m,
            y_m=sample.y_m, depth_m=sample.depth_m, helium3_ppb=float(self._field[row, column]), noise_std_ppb=0.1,
            measured_at=now, driven_m=self.driven,
        )  # fmt: skip
        self._down(Send(SAMPLE, report), now)


class Mission:
    """Ground and rover, and the messages between them."""

    def __init__(self, plan: Scenario, site: Region | None = None, planner: Planner = straight, **rover: float) -> None:
        self.region = site or region()
        self.ground: GroundNode = build_node(plan, self.region, planner)
        self.rover = Rover(self.region.he3_ppb, **rover)
        self.simulation = Simulation([self.ground, self.rover], plan.name, plan.start_ns)
        self.statuses: list[GroundStatus] = []
        self._tellers = 0
        self.simulation.tap(self._listen)

    def _listen(self, topic: object, side: Side, payload: bytes, now: int) -> None:
        if topic is GROUND_STATUS:
            self.statuses.append(decode(GROUND_STATUS, payload, "test")[1])

    def run(self) -> Finish:
        limit = self.simulation.now + seconds(400 * 3600.0)
        self.simulation.run(until=limit, stop=lambda: "ground" in self.simulation.finished)
        return self.simulation.finished["ground"]

    @property
    def snapshot(self) -> MapSnapshot:
        shown = self.simulation.snapshots["ground"]
        assert isinstance(shown, MapSnapshot)
        return shown

    @property
    def status(self) -> GroundStatus:
        return self.statuses[-1]

    def warnings(self) -> list[str]:
        return [note.text for _, _, note in self.simulation.log_records if note.level is Level.WARNING]

    def tell_ground(self, topic: Topic, body: Wire, made_at: int | None = None) -> None:
        """Send the ground a message as from another start of the rover; it is handled at once."""
        made = self.simulation.now if made_at is None else made_at
        self._tellers += 1
        incarnation = 1 + self._tellers
        header = Header(mission="test", source="rover", incarnation=incarnation, sequence=0, made_at=made)
        self.simulation.inject(topic, Side.EARTH, encode(header, body))
        self.simulation.step()


# --- a mission from beginning to end ----------------------------------------------------------------------------


def test_a_mission_ends_with_every_sample_in_the_map_and_a_better_one_than_at_first() -> None:
    mission = Mission(scenario())
    end = mission.run()
    assert end == Finish(True, "12 of 12 samples are in the map")
    assert len(mission.snapshot.samples) == 12
    history = mission.snapshot.score_history
    assert [score.samples for score in history] == [3, 6, 9, 12]
    assert history[-1].rmse_ppb < history[0].rmse_ppb
    assert mission.status.phase is MissionPhase.COMPLETED
    assert mission.status.round == 4
    assert [plan.last for _, plan in mission.rover.plans] == [False, False, False, True]


def test_the_phase_tells_waiting_planning_and_executing_apart() -> None:
    mission = Mission(scenario())
    mission.run()
    phases = [status.phase for status in mission.statuses]
    assert phases[0] is MissionPhase.WAITING
    assert {MissionPhase.PLANNING, MissionPhase.EXECUTING} < set(phases)


def test_repeated_and_reordered_messages_do_not_change_a_byte_of_the_map() -> None:
    plain, shaken = Mission(scenario()), Mission(scenario())
    shaken.rover.shuffle = shaken.rover.twice = True
    assert plain.run() == shaken.run()
    assert shaken.rover.plans == plain.rover.plans
    for layer in ("mean_ppb", "std_ppb"):
        assert getattr(plain.snapshot, layer).tobytes() == getattr(shaken.snapshot, layer).tobytes()
    assert plain.snapshot.score == shaken.snapshot.score or plain.snapshot.revision != shaken.snapshot.revision


def test_the_same_seed_plans_the_same_places_and_another_seed_others() -> None:
    def places(seed: int) -> list[tuple[float, float]]:
        mission = Mission(scenario(top={"seed": seed}))
        mission.run()
        return [(sample.x_m, sample.y_m) for sample in mission.snapshot.samples]

    assert places(5) == places(5)
    assert places(5) != places(6)


def test_driven_and_planned_paths_together_are_the_whole_way() -> None:
    mission = Mission(scenario())
    mission.run()
    assert mission.snapshot.planned_path_m == ()
    driven = np.array(mission.snapshot.driven_path_m)
    assert float(np.hypot(*np.diff(driven, axis=0).T).sum()) == pytest.approx(mission.rover.driven, abs=0.05)
    assert mission.status.driven_m == pytest.approx(mission.rover.driven)


@pytest.mark.parametrize("light_s", [1.0, 1200.0])
def test_sample_ids_are_never_used_for_two_places(light_s: float) -> None:
    mission = Mission(scenario(top={"rounds": 6}, ground={"pipeline": 2}), light_s=light_s)
    mission.rover.trouble = lambda planned: "a boulder" if planned.round in (2, 4) else None
    mission.simulation.run_for(4900.0)
    x, y = mission.rover.on_board[0].path_m[1]
    area = ((x - 1, y - 1), (x + 1, y - 1), (x + 1, y + 1), (x - 1, y + 1))
    keep_out = Telecommand(command_id="k", kind=CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=area)
    mission.simulation.ask(ISSUE_COMMAND, keep_out)
    mission.run()
    places: dict[str, tuple[float, float]] = {}
    for _, plan in mission.rover.plans:
        for planned in plan.rounds:
            for sample in planned.samples:
                assert places.setdefault(sample.sample_id, (sample.x_m, sample.y_m)) == (sample.x_m, sample.y_m)


# --- the pipeline -----------------------------------------------------------------------------------------------


def test_a_plan_made_ahead_names_the_pending_measurements_that_it_counts_in() -> None:
    mission = Mission(scenario(ground={"pipeline": 1}))
    mission.run()
    first, second = mission.rover.plans[0][1], mission.rover.plans[1][1]
    assert (first.samples_known, first.samples_pending) == (0, ())
    assert (second.samples_known, second.samples_pending) == (0, ("r01s1", "r01s2", "r01s3"))
    assert second.rounds[-1].path_m[0] == first.rounds[0].path_m[-1]
    assert second.rounds[-1].round == 2


def test_stop_and_wait_counts_in_measured_samples_only() -> None:
    mission = Mission(scenario())
    mission.run()
    assert [(plan.samples_known, plan.samples_pending) for _, plan in mission.rover.plans] == [
        (0, ()), (3, ()), (6, ()), (9, ()),
    ]  # fmt: skip


@pytest.mark.parametrize(("pipeline", "rounds"), [(0, 1), (1, 2), (3, 4)])
def test_no_more_rounds_than_asked_for_are_planned_ahead(pipeline: int, rounds: int) -> None:
    mission = Mission(scenario(top={"rounds": 8}, ground={"pipeline": pipeline}))
    mission.simulation.run_for(3000.0)
    assert mission.rover.plans[-1][1].rounds[-1].round == rounds
    assert mission.run().ok


def test_with_rounds_on_board_the_rover_never_waits_however_long_the_light_takes() -> None:
    stop_and_wait = Mission(scenario(), light_s=1200.0)
    ahead = Mission(scenario(ground={"pipeline": 1}), light_s=1200.0)
    assert stop_and_wait.run().ok
    assert ahead.run().ok
    assert stop_and_wait.rover.idle_s == pytest.approx(3 * (2 * 1200 + 30), abs=1)
    assert ahead.rover.idle_s == 0.0


def test_places_that_will_be_measured_lower_the_uncertainty_that_a_planner_sees() -> None:
    seen: list[PlanningRequest] = []

    def planner(request: PlanningRequest) -> PlannedRound:
        seen.append(request)
        return straight(request)

    Mission(scenario(ground={"pipeline": 2}), planner=planner).simulation.run_for(200.0)
    assert [len(request.observed_m) for request in seen] == [0, 3, 6]
    for request in seen[1:]:
        rows, columns = GRID.cells_of(request.observed_m)
        assert (request.std_ppb[rows, columns] < 0.1 * seen[0].std_ppb[rows, columns]).all()


# --- when the rover cannot do what was planned -----------------------------------------------------------------------


def test_a_rejected_plan_is_made_again_from_where_the_rover_stands() -> None:
    mission = Mission(scenario())
    mission.rover.place = (30.0, 20.0)
    assert mission.run().ok
    assert mission.rover.plans[1][1].rounds[0].path_m[0] == (30.0, 20.0)
    assert mission.rover.plans[1][1].rounds[0].round == 1
    assert len(mission.snapshot.samples) == 12


def test_a_rover_that_rejects_everything_ends_the_mission_with_the_reason() -> None:
    mission = Mission(scenario())
    mission.rover.reject = lambda plan: "not today"
    end = mission.run()
    assert not end.ok
    assert "not today" in end.why
    assert len(mission.rover.plans) == 11
    assert mission.status.phase is MissionPhase.FAILED


def test_a_rover_that_goes_on_rejecting_is_given_more_time_each_time() -> None:
    mission = Mission(scenario())
    mission.rover.reject = lambda plan: "I am elsewhere"
    mission.run()
    at = [when / SECOND for when, _ in mission.rover.plans]
    waits = [later - earlier for earlier, later in pairwise(at)]
    assert waits[:4] == [32.0, 62.0, 92.0, 152.0]
    assert max(waits) == 3600.0 + 32.0
    assert mission.status.detail.startswith("0 of 12 samples are in the map; 11 plans in a row were rejected")


def test_rounds_without_a_sample_are_tried_again_forty_times_at_most() -> None:
    mission = Mission(scenario(top={"samples_per_round": 1}), round_s=600.0)
    mission.rover.skip = {f"r{number:02d}s1" for number in range(3, 10_000)}
    end = mission.run()
    assert len(mission.snapshot.samples) == 2
    assert "40 rounds in a row brought no sample" in end.why
    assert mission.status.round == mission.status.rounds > 40, "never more rounds than there are"


def test_when_the_last_round_ran_from_an_older_plan_the_mission_still_ends() -> None:
    mission = Mission(scenario(top={"rounds": 2}, ground={"pipeline": 1}), light_s=1200.0)
    mission.simulation.run_for(4000.0)
    second = mission.rover.on_board[0]
    assert second.round == 2
    mission.simulation.run_for(900.0)  # it is executing round 2, and the ground cannot know
    assert mission.rover.executing is second
    x, y = second.path_m[-1]
    area = ((x - 1, y - 1), (x + 1, y - 1), (x + 1, y + 1), (x - 1, y + 1))
    keep_out = Telecommand(command_id="k", kind=CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=area)
    mission.simulation.ask(ISSUE_COMMAND, keep_out)
    assert mission.run().ok
    assert len(mission.snapshot.samples) == 6


def test_a_rover_that_an_obstacle_met_at_its_side_goes_back_the_way_it_came_before_it_goes_on() -> None:
    mission = Mission(scenario())
    mission.rover.obstacle_ahead_m = 0.9  # within the map's margin of where the rover stands
    blocked: list[RoundPlan] = []

    def trouble(planned: RoundPlan) -> str | None:
        if planned.round != 2:
            return None
        blocked.append(planned)
        return "a boulder"

    mission.rover.trouble = trouble
    assert mission.run() == Finish(True, "12 of 12 samples are in the map")
    (x, y), (here_x, here_y) = blocked[0].path_m[
        :2
    ]  # the rover drove this leg to its first sample, and met the boulder
    after = next(plan.rounds[0] for _, plan in mission.rover.plans if plan.rounds[0].path_m[0] == (here_x, here_y))
    back_x, back_y = after.path_m[1]
    leg = np.hypot(here_x - x, here_y - y)
    assert np.hypot(back_x - x, back_y - y) + np.hypot(here_x - back_x, here_y - back_y) == pytest.approx(leg)
    assert 0.0 < np.hypot(here_x - back_x, here_y - back_y) < 5.0


def test_an_obstacle_closes_its_ground_and_the_missing_samples_are_replaced() -> None:
    mission = Mission(scenario(ground={"pipeline": 1}))
    mission.rover.trouble = lambda planned: "a boulder" if planned.round == 2 else None
    assert mission.run().ok
    snapshot = mission.snapshot
    assert len(snapshot.samples) == 12
    stood = next(sample for sample in snapshot.samples if sample.round == 2)
    assert not snapshot.traversable[int(stood.y_m), int(stood.x_m + 3.0)]
    after = next(plan for _, plan in mission.rover.plans if plan.rounds[0].path_m[0] == (stood.x_m, stood.y_m))
    assert after.rounds[0].round == 3
    assert max(planned.round for _, plan in mission.rover.plans for planned in plan.rounds) == 5


def test_a_skipped_sample_is_replaced_by_another() -> None:
    mission = Mission(scenario())
    mission.rover.skip = {"r04s2"}
    assert mission.run().ok
    assert len(mission.snapshot.samples) == 12
    assert "r04s2" not in {sample.sample_id for sample in mission.snapshot.samples}


def test_a_rover_that_dropped_its_rounds_without_a_report_is_sent_new_ones() -> None:
    mission = Mission(scenario(top={"rounds": 2}, ground={"pipeline": 1}))
    mission.simulation.run_for(500.0)
    assert [planned.round for planned in mission.rover.on_board] == [2]
    mission.rover.on_board = []
    mission.simulation.run_for(10_000.0)
    assert (mission.status.samples, len(mission.rover.plans)) == (3, 2)
    mission.tell_ground(STATE, state(mission.rover.revision, mission.rover.place, round_=1))
    assert mission.run().ok
    assert len(mission.snapshot.samples) == 6


def test_a_round_that_had_begun_before_it_was_replaced_is_planned_on_from() -> None:
    mission = Mission(scenario(ground={"pipeline": 1}), light_s=600.0)
    mission.simulation.run_for(3600.0)
    second = mission.rover.on_board[0]
    mission.simulation.run_for(1300.0)
    assert mission.rover.executing is second  # and the ground does not know it yet
    x, y = second.path_m[1]
    area = ((x - 1, y - 1), (x + 1, y - 1), (x + 1, y + 1), (x - 1, y + 1))
    keep_out = Telecommand(command_id="k", kind=CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=area)
    mission.simulation.ask(ISSUE_COMMAND, keep_out)
    assert mission.run().ok
    assert {"r02s1", "r02s2", "r02s3"} <= {sample.sample_id for sample in mission.snapshot.samples}
    assert len(mission.snapshot.samples) == 12


def state(revision: int, place: tuple[float, float] = START, round_: int = 0, mode: str = "parked") -> RoverState:
    return RoverState(
        mode=RoverMode(mode), x_m=place[0], y_m=place[1], heading_deg=0.0, energy_wh=4000.0, capacity_wh=5000.0,
        driven_m=0.0, drilled_m=0.0, round=round_, plan_revision=revision, rounds_on_board=0, samples_done=0,
        queue_depth=0,
    )  # fmt: skip


# --- budgets and ends -------------------------------------------------------------------------------------------


def test_a_budget_in_metres_is_never_overdrawn_and_completes_the_mission_early() -> None:
    mission = Mission(scenario(ground={"budget_m": 250.0}))
    end = mission.run()
    assert end.ok
    assert "budget of" in end.why
    assert 0 < len(mission.snapshot.samples) < 12
    assert mission.rover.driven <= 250.0


def test_a_budget_in_hours_limits_what_is_planned() -> None:
    seen: list[PlanningRequest] = []

    def planner(request: PlanningRequest) -> PlannedRound:
        seen.append(request)
        return straight(replace(request, budget_m=1e9))

    mission = Mission(scenario(ground={"budget_h": 2.5}), planner=planner, round_s=2700.0)
    end = mission.run()
    assert end.ok
    assert "2.5 h" in end.why
    assert [request.samples_left for request in seen] == sorted((r.samples_left for r in seen), reverse=True)
    assert all(0 < request.budget_m < 0.1 * 2.5 * 3600 for request in seen)
    # A round is planned only while there is time for it; this rover takes longer than that for the last one alone.
    assert mission.rover.plans[-1][0] - scenario().start_ns < seconds(2.5 * 3600 - 660)
    assert mission.simulation.now - scenario().start_ns < seconds(2.5 * 3600 + 2700 - 660)


def test_when_no_route_is_left_the_mission_ends_with_what_it_has() -> None:
    def planner(request: PlanningRequest) -> PlannedRound:
        if len(request.observed_m) >= 6:
            raise NoRoute("walled in at (1, 2)")
        return straight(request)

    mission = Mission(scenario(), planner=planner)
    end = mission.run()
    assert end.ok
    assert end.why.startswith("6 of 12 samples are in the map; round 3 could not be planned: walled in")


def test_a_planner_that_breaks_is_tried_again_with_another_seed_and_then_fails_the_mission() -> None:
    seeds: list[int] = []

    def planner(request: PlanningRequest) -> PlannedRound:
        seeds.append(request.seed)
        raise ArithmeticError("nothing but zeros")

    mission = Mission(scenario(), planner=planner)
    end = mission.run()
    assert not end.ok
    assert "nothing but zeros" in end.why
    assert len(set(seeds)) == 3


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        (lambda r: PlannedRound(r.path_m + 3.0, r.samples_m, 1.0), "expected a path from"),
        (lambda r: PlannedRound(r.path_m, np.vstack((r.samples_m, r.samples_m)), 1.0), "1 to 3 samples, got 4 and 6"),
        (lambda r: PlannedRound(r.path_m, r.samples_m + 100.0, 1.0), "expected samples on the path"),
        (lambda r: PlannedRound(np.add(r.path_m, [[0], [0], [0], [60]]), r.samples_m, 1.0), "within the region"),
        (lambda r: "a plan", "expected a PlannedRound, got str"),
    ],
)
def test_what_a_planner_answers_is_checked_before_it_goes_up(
    fault: Callable[[PlannedRound], PlannedRound], complaint: str
) -> None:
    mission = Mission(scenario(), planner=lambda request: fault(straight(request)))
    end = mission.run()
    assert not end.ok
    assert complaint in end.why
    assert mission.rover.plans == []


def test_a_start_outside_the_region_is_refused_before_anything_begins() -> None:
    with pytest.raises(InvalidInput, match=r"start_m: expected a place within 0\.\.60 m east"):
        build_node(scenario(top={"start_m": [80.0, 5.0]}), region())


def test_a_start_from_which_most_open_ground_is_out_of_reach_is_said_from_the_first_status_on() -> None:
    mission = Mission(scenario(), site=region(closed=lambda x, y: (x > 20) & (x < 22)))
    said = "from the start (5, 5) m only 33.9% of the open ground can be reached; from (23.5, 4.5) m it is 66.1%"
    mission.simulation.run(until=mission.simulation.now + SECOND)
    assert mission.statuses[0].detail == said
    assert mission.warnings()[0] == said
    mission.run()
    assert mission.status.detail == f"12 of 12 samples are in the map; {said}"


IN_DEGREES = ((-30.76, 20.19), (-30.72, 20.19), (-30.72, 20.21))
IN_ONE_LINE = ((10.0, 10.0), (20.0, 20.0), (40.0, 40.0))
SPECK = ((10.1, 10.1), (10.3, 10.1), (10.3, 10.3))
ELSEWHERE = (
    r"expected an area of the site, which is 0\.\.60 m east and 0\.\.60 m north, "
    r"got one at -30\.76\.\.-30\.72 m east and 20\.19\.\.20\.21 m north"
)
GOOD_AREA = ((10.0, 10.0), (20.0, 10.0), (20.0, 20.0))


@pytest.mark.parametrize(
    ("polygon", "complaint"), [(IN_DEGREES, ELSEWHERE), (IN_ONE_LINE, "expected corners around some ground")]
)
def test_a_keep_out_of_the_scenario_that_closes_nothing_is_refused_with_its_key(
    polygon: tuple[tuple[float, float], ...], complaint: str
) -> None:
    with pytest.raises(InvalidInput, match=rf"^scenario 'test': ground\.keep_outs_m\.1: {complaint}"):
        build_node(scenario(ground={"keep_outs_m": [GOOD_AREA, polygon]}), region())
    build_node(scenario(ground={"keep_outs_m": [GOOD_AREA, SPECK]}), region())


@pytest.mark.parametrize(("polygon", "complaint"), [(IN_DEGREES, ELSEWHERE), (SPECK, "expected an area that holds")])
def test_an_interest_of_the_scenario_that_holds_nothing_is_refused_with_its_key(
    polygon: tuple[tuple[float, float], ...], complaint: str
) -> None:
    interest = [{"polygon_m": GOOD_AREA, "weight": 2.0}, {"polygon_m": polygon, "weight": 2.0}]
    with pytest.raises(InvalidInput, match=rf"^scenario 'test': ground\.interest\.1: {complaint}"):
        build_node(scenario(ground={"interest": interest}), region())


EVERYWHERE = ((0.0, 0.0), (60.0, 0.0), (60.0, 60.0), (0.0, 60.0))


def test_a_scenario_in_which_no_open_ground_is_of_interest_is_refused() -> None:
    nothing = {"polygon_m": EVERYWHERE, "weight": 0.0}
    closed = region(lambda x, y: x > 30.0)
    beyond = {"polygon_m": ((40.0, 10.0), (50.0, 10.0), (50.0, 20.0)), "weight": 1.0}
    for areas, site in (([nothing], region()), ([nothing, beyond], closed)):
        with pytest.raises(InvalidInput, match=r"ground\.interest: expected a weight above 0 somewhere on open ground"):
            build_node(scenario(ground={"interest": areas}), site)
    build_node(scenario(ground={"interest": [nothing, beyond]}), region())


def test_no_change_of_interest_may_leave_nothing_worth_measuring() -> None:
    mission = Mission(scenario(ground={"interest": [{"polygon_m": EVERYWHERE, "weight": 0.0},
                                                    {"polygon_m": GOOD_AREA, "weight": 2.0}]}))  # fmt: skip
    mission.simulation.run_for(10.0)
    before = mission.simulation.ask(SET_INTEREST, InterestChange())
    for change, complaint in (
        (InterestChange(area_id="scenario-2"), "weight: expected a weight above 0"),
        (InterestChange(area_id="scenario-2", polygon_m=GOOD_AREA, weight=0.0), "weight: expected a weight above 0"),
        (InterestChange(area_id="all", polygon_m=EVERYWHERE, weight=0.0), "weight: expected a weight above 0"),
        (InterestChange(area_id="speck", polygon_m=SPECK), "polygon_m: expected an area that holds the centre"),
    ):
        with pytest.raises(He3Error, match=complaint):
            mission.simulation.ask(SET_INTEREST, change)
    assert mission.simulation.ask(SET_INTEREST, InterestChange()) == before
    mission.simulation.ask(SET_INTEREST, InterestChange(area_id="scenario-1"))
    mission.simulation.ask(SET_INTEREST, InterestChange(area_id="scenario-2"))
    assert mission.run().ok


# --- impossible telemetry --------------------------------------------------------------------------------------------


def sample_report(**changes: object) -> SampleReport:
    fields: dict[str, object] = {
        "sample_id": "r01s1", "round": 1, "plan_revision": 1, "x_m": 10.0, "y_m": 10.0, "depth_m": 0.1,
        "helium3_ppb": 8.0, "noise_std_ppb": 0.1, "measured_at": scenario().start_ns, "driven_m": 5.0,
    }  # fmt: skip
    return SampleReport(**{**fields, **changes})


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"sample_id": "r77s1"}, "expected one that was planned"),
        ({"x_m": 61.0}, "expected a place within"),
        ({"helium3_ppb": 1e9}, "expected -1000 to 1.001e+06 ppb"),
    ],
)
def test_an_impossible_sample_is_left_out_and_changes_nothing(changes: dict[str, object], complaint: str) -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(100.0)
    before, revision = mission.snapshot, mission.status.map_revision
    mission.tell_ground(SAMPLE, sample_report(**changes))
    assert complaint in mission.warnings()[-1]
    assert mission.snapshot.mean_ppb is before.mean_ppb
    assert (mission.status.samples, mission.status.map_revision) == (0, revision)


@pytest.mark.parametrize("pipeline", [0, 1])
def test_an_impossible_reading_is_not_waited_for_and_another_is_taken_in_its_place(pipeline: int) -> None:
    field = smooth_field()
    mission = Mission(scenario(ground={"pipeline": pipeline}))
    mission.rover.twice = True
    spoilt: list[str] = []

    def measured(planned: RoundPlan, sample: PlannedSample, now: int) -> None:
        mission.rover._field = field if spoilt else np.full_like(field, -5000.0)
        spoilt.append(sample.sample_id)
        Rover._measured(mission.rover, planned, sample, now)

    mission.rover._measured = measured  # type: ignore[method-assign]
    end = mission.run()
    assert end == Finish(True, "12 of 12 samples are in the map")
    assert spoilt[0] == "r01s1"
    taken = [sample.sample_id for sample in mission.snapshot.samples]
    assert sorted(taken) == sorted(spoilt[1:])
    assert len(taken) == 12
    assert sum("r01s1 is left out" in text for text in mission.warnings()) == 1


def test_an_event_of_a_round_never_planned_or_from_outside_the_region_changes_nothing() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(100.0)
    at = mission.simulation.now
    plans = len(mission.rover.plans)
    for event in (
        RoverEvent(kind=EventKind.ROUND_ABORTED, at=at, x_m=5.0, y_m=5.0, round=9, plan_revision=1),
        RoverEvent(kind=EventKind.BLOCKED, at=at, x_m=500.0, y_m=5.0, round=1, plan_revision=1),
    ):
        mission.tell_ground(EVENT, event)
        assert mission.warnings()[-1].startswith(f"event {event.kind.value}: expected")
    mission.simulation.run_for(100.0)
    assert len(mission.rover.plans) == plans
    assert mission.run().ok


def test_an_older_state_does_not_replace_a_newer_one() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(100.0)
    now = mission.simulation.now
    mission.tell_ground(STATE, state(1, (20.0, 20.0), 1, "driving"), made_at=now)
    mission.tell_ground(STATE, state(1, (10.0, 10.0), 1, "driving"), made_at=now - 5)
    assert mission.status.rover is not None
    assert (mission.status.rover.x_m, mission.status.rover_made_at) == (20.0, now)


def test_silence_of_the_rover_is_reported_once_and_ends_when_it_is_heard() -> None:
    mission = Mission(scenario(ground={"rover_timeout_s": 600.0}))
    mission.simulation.run_for(3000.0)
    assert sum("nothing heard" in text for text in mission.warnings()) == 1
    assert mission.status.detail.startswith("the rover is silent")
    mission.simulation.run_for(700.0)
    assert "silent" not in mission.status.detail


def test_a_silent_instrument_is_said_until_the_rover_has_a_measurement_or_drives() -> None:
    mission = Mission(scenario(ground={"rover_timeout_s": 1e6}))
    mission.simulation.run_for(100.0)
    now = mission.simulation.now
    silent = RoverEvent(
        kind=EventKind.INSTRUMENT_SILENT, at=now, x_m=5.0, y_m=5.0, driven_m=7.0, detail="moon/field/terrain: timeout"
    )
    for driven_m, made_at, said in ((7.0, now + 5, True), (7.5, now - 5, True), (7.5, now + 9, False)):
        mission.tell_ground(EVENT, silent, made_at=now)
        here = state(1, (6.0, 5.0), 1, "driving").model_copy(update={"driven_m": driven_m})
        mission.tell_ground(STATE, here, made_at=made_at)
        assert mission.status.detail.startswith("instrument silent: moon/field/terrain") is said


# --- commands ---------------------------------------------------------------------------------------------------


def command(kind: CommandKind = CommandKind.PAUSE, name: str = "c1", **more: object) -> Telecommand:
    return Telecommand(command_id=name, kind=kind, **more)


def test_a_command_goes_up_once_and_its_stages_are_listed_in_the_order_in_which_they_were_passed() -> None:
    mission = Mission(scenario())
    told: list[CommandStatus] = []
    mission.simulation.tap(
        lambda topic, side, payload, now: (
            told.append(decode(COMMAND_STATUS, payload, "test")[1]) if topic is COMMAND_STATUS else None
        )
    )
    mission.simulation.run_for(10.0)
    first = mission.simulation.ask(ISSUE_COMMAND, command())
    again = mission.simulation.ask(ISSUE_COMMAND, command())
    assert first == again
    at = mission.simulation.now
    for stage, delay in ((CommandStage.ACCEPTED, 3), (CommandStage.RECEIVED, 2), (CommandStage.ACCEPTED, 3)):
        mission.tell_ground(COMMAND_REPORT, CommandReport(command_id="c1", stage=stage, at=at + delay))
    listed = mission.simulation.ask(LIST_COMMANDS, NoParameters())
    assert [report.stage.value for report in listed.commands[0].stages] == [
        "queued", "released", "received", "accepted",
    ]  # fmt: skip
    assert mission.rover.commands == [command()]
    assert told[-1] == listed.commands[0]
    assert len(told) == 3


def test_a_command_that_cannot_be_executed_is_refused_and_not_sent() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(10.0)
    mission.simulation.ask(ISSUE_COMMAND, command())
    past = mission.simulation.now - 2 * SECOND
    for bad, complaint in (
        (command(CommandKind.SAFE), "expected a new id"),
        (command(name="c2", expires_at=past), "expected an expiry ahead, got one 2 s ago"),
        (command(CommandKind.GO_TO, "c3", target_m=(70.0, 3.0)), "expected a target within"),
        (command(CommandKind.SET_KEEP_OUT, "c4", area_id="a", polygon_m=IN_DEGREES), f"c4: polygon_m: {ELSEWHERE}"),
        (
            command(CommandKind.SET_KEEP_OUT, "c5", area_id="a", polygon_m=IN_ONE_LINE),
            "c5: polygon_m: expected corners",
        ),
    ):
        with pytest.raises(He3Error, match=complaint):
            mission.simulation.ask(ISSUE_COMMAND, bad)
    mission.simulation.step()
    assert mission.rover.commands == [command()]


def test_the_rover_is_not_sent_to_or_straight_over_ground_that_the_map_knows_as_closed() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(10.0)
    x, y = mission.rover.place
    wall = ((x + 8, 0.0), (x + 12, 0.0), (x + 12, 60.0), (x + 8, 60.0))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=wall))
    for name, target, complaint in (
        ("into", (x + 10, y), "into: expected a target on open ground"),
        ("over", (x + 20, y), "over: expected open ground on the straight way"),
    ):
        with pytest.raises(He3Error, match=complaint):
            mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.GO_TO, name, target_m=target))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.GO_TO, "beside", target_m=(x, y + 10)))
    assert [status.command.command_id for status in listed(mission)] == ["c1", "beside"]


def listed(mission: Mission) -> Sequence[CommandStatus]:
    return mission.simulation.ask(LIST_COMMANDS, NoParameters()).commands


def test_a_command_without_a_report_is_lost_after_its_time() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(10.0)
    expires = mission.simulation.now + 100 * SECOND
    mission.simulation.ask(ISSUE_COMMAND, command(expires_at=expires))
    mission.simulation.run_for(100.0)
    assert stages(mission) == ["queued", "released"]
    mission.simulation.run_for(100.0)
    assert stages(mission) == ["queued", "released", "lost"]


def stages(mission: Mission) -> list[str]:
    listed = mission.simulation.ask(LIST_COMMANDS, NoParameters())
    return [report.stage.value for report in listed.commands[0].stages]


def test_a_keep_out_closes_ground_and_rounds_that_lead_through_it_are_planned_anew() -> None:
    mission = Mission(scenario(ground={"pipeline": 1}))
    mission.simulation.run_for(200.0)
    second = mission.rover.on_board[0]
    x, y = second.path_m[1]
    area = ((x - 2, y - 2), (x + 2, y - 2), (x + 2, y + 2), (x - 2, y + 2))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=area))
    mission.simulation.run_for(200.0)
    assert not mission.snapshot.traversable[int(y), int(x)]
    assert mission.rover.on_board[0].round == 2
    assert mission.rover.on_board[0].samples[0].sample_id.startswith("r02v")
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, "c2", area_id="a"))
    mission.simulation.step()
    assert not mission.snapshot.traversable[int(y), int(x)]
    done = CommandReport(command_id="c2", stage=CommandStage.COMPLETED, at=mission.simulation.now)
    mission.tell_ground(COMMAND_REPORT, done)
    assert mission.snapshot.traversable.all()
    assert mission.run().ok


def test_the_report_that_a_keep_out_was_set_changes_no_plan() -> None:
    mission = Mission(scenario(ground={"planning_s": 500.0}))
    corner = ((50.0, 50.0), (55.0, 50.0), (55.0, 55.0))
    mission.simulation.run_for(10.0)
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=corner))
    mission.simulation.run_for(300.0)
    before = mission.snapshot
    done = CommandReport(command_id="c1", stage=CommandStage.COMPLETED, at=mission.simulation.now)
    mission.tell_ground(COMMAND_REPORT, done)
    assert mission.snapshot is before
    mission.simulation.run_for(250.0)
    assert len(mission.rover.plans) == 1


def test_while_the_rover_is_sent_elsewhere_nothing_is_planned_and_then_from_there() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(10.0)
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.GO_TO, target_m=(40.0, 41.0)))
    at = mission.simulation.now
    mission.tell_ground(COMMAND_REPORT, CommandReport(command_id="c1", stage=CommandStage.STARTED, at=at))
    mission.simulation.run_for(1000.0)
    assert mission.rover.plans == []
    mission.rover.place = (40.0, 41.0)
    done = CommandReport(command_id="c1", stage=CommandStage.COMPLETED, at=mission.simulation.now)
    mission.tell_ground(COMMAND_REPORT, done)
    assert mission.run().ok
    assert mission.rover.plans[0][1].rounds[0].path_m[0] == (40.0, 41.0)


# --- the live map -----------------------------------------------------------------------------------------------


def test_a_point_query_answers_with_the_map_as_it_is() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(4000.0)
    point = mission.simulation.ask(MAP_POINT, MapPointQuery(x=12.25, y=40.75))
    snapshot = mission.snapshot
    assert point.mean_ppb == float(snapshot.mean_ppb[40, 12])
    assert point.std_ppb == float(snapshot.std_ppb[40, 12])
    assert (point.samples, point.revision) == (3, snapshot.revision)
    track = mission.simulation.ask(TRACK, NoParameters())
    assert len(track.samples) == 3
    assert track.plan_ends is not None
    assert track.plan_ends > mission.simulation.now


def test_without_a_reference_there_is_no_score_and_a_query_for_it_says_so() -> None:
    mission = Mission(scenario(ground={"score": False}))
    mission.simulation.run_for(100.0)
    assert mission.status.score is None
    with pytest.raises(He3Error, match="no reference field"):
        mission.simulation.ask(MAP_SCORE, NoParameters())


def test_a_published_map_never_changes() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(4000.0)
    shown = mission.snapshot
    before = (shown.mean_ppb.tobytes(), shown.std_ppb.tobytes(), shown.traversable.tobytes(), shown.samples)
    mission.run()
    assert mission.snapshot.revision > shown.revision
    assert (shown.mean_ppb.tobytes(), shown.std_ppb.tobytes(), shown.traversable.tobytes(), shown.samples) == before
    with pytest.raises(ValueError, match="read-only"):
        shown.mean_ppb[0, 0] = 1.0


# --- plan review ------------------------------------------------------------------------------------------------


class Reviewed(Mission):
    """A mission in which every plan waits for an operator."""

    def __init__(self, **ground: object) -> None:
        super().__init__(scenario(ground={"approval": "operator", **ground}))

    def waits(self) -> PlanProposal:
        """The plan that waits, once there is one."""
        limit = self.simulation.now + seconds(10 * 3600.0)
        self.simulation.run(until=limit, stop=lambda: self.shown() is not None)
        proposal = self.shown()
        assert proposal is not None
        return proposal

    def shown(self) -> PlanProposal | None:
        review: PlanReview = self.simulation.ask(SHOW_PLAN, NoParameters())
        return review.proposal

    def decide(self, proposal: PlanProposal, verdict: str = "approve", **changes: Any) -> PlanReview:
        decision = PlanDecision(proposal=proposal.proposal, verdict=PlanVerdict(verdict), by="anna", **changes)
        review: PlanReview = self.simulation.ask(DECIDE_PLAN, decision)
        return review


def test_a_plan_waits_for_its_approval_however_long_and_the_mission_says_so() -> None:
    mission = Reviewed(patience_h=1.0)
    proposal = mission.waits()
    mission.simulation.run_for(20 * 3600.0)
    assert mission.rover.plans == []
    assert mission.shown() == proposal
    assert mission.status.proposal == proposal.proposal
    assert mission.status.detail == "the plan of round 1 waits for approval"
    assert not mission.simulation.finished
    assert mission.decide(proposal) == PlanReview()
    mission.simulation.run_for(10.0)
    assert [planned for _, plan in mission.rover.plans for planned in plan.rounds] == [proposal.plan]
    while "ground" not in mission.simulation.finished:
        mission.simulation.run_for(600.0)
        if (following := mission.shown()) is not None:
            mission.decide(following)
    assert mission.simulation.finished["ground"] == Finish(True, "12 of 12 samples are in the map")
    assert [plan.last for _, plan in mission.rover.plans] == [False, False, False, True]


def test_dropped_samples_are_not_taken_and_others_replace_them_in_later_rounds() -> None:
    mission = Reviewed()
    proposal = mission.waits()
    assert proposal.length_m == pytest.approx(float(np.hypot(*np.diff(proposal.plan.path_m, axis=0).T).sum()))
    dropped = proposal.plan.samples[1].sample_id
    for drop, complaint in (
        (("r09s9",), "expected samples among r01s1, r01s2, r01s3, got r09s9"),
        (tuple(sample.sample_id for sample in proposal.plan.samples), "at least one sample that is kept"),
    ):
        with pytest.raises(He3Error, match=complaint):
            mission.decide(proposal, drop=drop)
    mission.decide(proposal, drop=(dropped,))
    mission.simulation.run_for(10.0)
    sent = mission.rover.plans[0][1].rounds[0]
    assert [sample.sample_id for sample in sent.samples] == ["r01s1", "r01s3"]
    assert sent.path_m == proposal.plan.path_m
    assert sent.information_nats > 0
    rounds = 1
    while "ground" not in mission.simulation.finished:
        mission.simulation.run_for(600.0)
        if (following := mission.shown()) is not None:
            rounds += 1
            mission.decide(following)
    taken = [sample.sample_id for sample in mission.snapshot.samples]
    assert (len(taken), dropped in taken, rounds) == (12, False, 5)


def test_a_revised_plan_samples_the_places_that_the_operator_chose_and_waits_for_approval_again() -> None:
    mission = Reviewed(budget_m=300.0)
    mission.waits()
    corner = ((0.2, 0.2), (2.8, 0.2), (2.8, 2.8), (0.2, 2.8))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="corner", polygon_m=corner))
    proposal = mission.waits()
    first, second, third = ((sample.x_m, sample.y_m) for sample in proposal.plan.samples)
    start, grid = proposal.plan.path_m[0], mission.snapshot.grid
    far = ((grid.width_m - 0.5, grid.height_m - 0.5), (grid.width_m - 0.5, 0.5))
    for places, complaint in (
        (((1e3, 1.0),), r"plan: expected places within the region, got \(1000, 1\) m"),
        (((1.5, 1.5),), r"plan: expected a place on open ground, got \(1.5, 1.5\) m"),
        ((first,) * 13, "plan: expected 1 to 12 places to sample, as many as are left, got 13"),
        (far * 6, r"plan: expected [\d.]+ m at most, got"),
    ):
        with pytest.raises(He3Error, match=complaint):
            mission.decide(proposal, "revise", places_m=places)
        assert mission.shown() == proposal
    added = (start[0] + 1.0, start[1])
    chosen = (added, third, first, second)
    revised = mission.decide(proposal, "revise", places_m=chosen).proposal
    assert revised is not None
    assert revised.proposal > proposal.proposal
    assert [(sample.x_m, sample.y_m) for sample in revised.plan.samples] == [pytest.approx(place) for place in chosen]
    assert revised.plan.path_m[0] == start
    assert revised.plan.information_nats > 0
    assert revised.length_m > proposal.length_m
    assert mission.rover.plans == []
    with pytest.raises(He3Error, match="got a decision on proposal"):
        mission.decide(proposal)
    mission.decide(revised)
    mission.simulation.run_for(10.0)
    assert mission.rover.plans[0][1].rounds[0] == revised.plan
    waits = mission.waits()
    assert {sample.sample_id for sample in waits.plan.samples}.isdisjoint(
        sample.sample_id for sample in revised.plan.samples
    )


def test_a_plan_that_is_sent_back_is_made_again_and_a_decision_on_the_former_one_is_refused() -> None:
    mission = Reviewed()
    first = mission.waits()
    mission.decide(first, "send_back")
    second = mission.waits()
    assert second.plan.round == first.plan.round
    assert second.plan.samples != first.plan.samples
    with pytest.raises(He3Error, match=f"proposal {second.proposal} waits, got a decision on proposal"):
        mission.decide(first)
    mission.decide(second)
    with pytest.raises(He3Error, match="no plan waits for approval"):
        mission.decide(second)


def test_a_plan_that_waits_is_made_again_when_its_ground_is_closed() -> None:
    mission = Reviewed()
    first = mission.waits()
    x, y = first.plan.path_m[-1]
    around_end = ((x - 1, y - 1), (x + 1, y - 1), (x + 1, y + 1), (x - 1, y + 1))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=around_end))
    assert mission.shown() is None
    assert mission.waits().proposal != first.proposal


def test_a_plan_that_waits_is_in_a_checkpoint() -> None:
    mission = Reviewed()
    proposal = mission.waits()
    other = build_node(scenario(ground={"approval": "operator"}), mission.region, straight)
    codec = StateCodec((*other.state_types, Finish), other.functions)
    other.restore(codec.decode(codec.encode(mission.ground.checkpoint())))
    effects = list(other.handle(QueryReceived(SHOW_PLAN, NoParameters(), 1), mission.simulation.now))
    assert SendReply(1, PlanReview(proposal=proposal)) in effects

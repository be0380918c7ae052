"""The ground station through a whole mission, with a rover that executes every plan at once."""

from __future__ import annotations

import numpy as np
import pytest

from he3.errors import He3Error
from schemas.commands import CommandKind, NoParameters, Telecommand
from schemas.ground import MissionPhase
from schemas.maps import CrossValidationQuery, MapPointQuery
from schemas.topics import (
    ISSUE_COMMAND,
    MAP_CROSS_VALIDATION,
    MAP_POINT,
    MAP_SCORE,
    TRACK,
)
from services.ground.planners.interface import PlannedRound, PlanningRequest
from services.runtime.node import (
    Finish,
)
from tests.unit.ground.stand_in_mission import GRID, Mission, scenario, straight

# --- a mission from beginning to end ----------------------------------------------------------------------------------


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


# --- the pipeline -----------------------------------------------------------------------------------------------------


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


# --- the live map -----------------------------------------------------------------------------------------------------


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


def test_each_sample_of_the_map_is_told_with_what_the_others_say_of_it() -> None:
    mission = Mission(scenario(ground={"score": False}))
    mission.run()
    told = mission.simulation.ask(MAP_CROSS_VALIDATION, CrossValidationQuery())
    snapshot = mission.snapshot
    assert snapshot.process is not None
    assert [each.sample_id for each in told.samples] == [each.sample_id for each in snapshot.samples]
    assert np.array_equal(snapshot.process.places_m, [(each.x_m, each.y_m) for each in snapshot.samples])
    assert told.revision == snapshot.revision
    assert 0.0 < told.rmse_ppb < 3.0
    assert told.within_95 > 0.7


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

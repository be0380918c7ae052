"""What the ground plans where the rover cannot do what was planned."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from schemas.commands import CommandKind, Telecommand
from schemas.ground import MissionPhase
from schemas.plans import RoundPlan
from schemas.topics import (
    ISSUE_COMMAND,
    STATE,
)
from services.mission.mission_time import SECOND
from services.runtime.node import (
    Finish,
)
from tests.unit.ground.stand_in_mission import Mission, scenario, state


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

"""Budgets, ends of a mission, and scenarios that are refused before it begins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from he3.errors import He3Error, InvalidInput, NoRoute
from schemas.ground import InterestChange
from schemas.topics import (
    SET_INTEREST,
)
from services.ground.node import build_node
from services.ground.planners.interface import PlannedRound, PlanningRequest
from services.mission.mission_time import SECOND, seconds
from tests.unit.ground.stand_in_mission import (
    ELSEWHERE,
    GOOD_AREA,
    IN_DEGREES,
    IN_ONE_LINE,
    SPECK,
    Mission,
    region,
    scenario,
    straight,
)


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

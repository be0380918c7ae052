"""What the ground predicts that driving takes, and what the rover then takes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from he3.driving import DriveFigures, DrivenGround
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.reference import Region
from he3.terrain import slope_deg
from schemas.codec import decode
from schemas.ground import GroundStatus
from schemas.plans import RoundPlan
from schemas.telemetry import RoverState
from schemas.topics import GROUND_STATUS, PLAN, STATE, Side, Topic
from services.ground.budget import Budget, Committed
from services.ground.driving_costs import DrivingCosts
from services.ground.round_log import RoundLog
from services.mission.in_process import InProcessMission, build_nodes
from services.mission.mission_time import MissionTime
from services.mission.scenario import Scenario, checked_scenario

GRID = SiteGrid(80, 80, 2.0)
CHARGED = 0.5  # share of the battery at the beginning, so that it is neither full nor empty at any time


def region(heights: FloatArray) -> Region:
    field = 5.0 + ndimage.gaussian_filter(np.random.default_rng(1).normal(size=GRID.shape), 4) * 20.0
    return Region(
        name="made", title="Made", provenance="made by the test", grid=GRID, he3_ppb=field, orbital_ppb=field.copy(),
        elevation_m=heights, slope_deg=slope_deg(heights, GRID.resolution_m), traversable=np.ones(GRID.shape, np.bool_),
    )  # fmt: skip


def hills() -> FloatArray:
    return ndimage.gaussian_filter(np.random.default_rng(2).normal(size=GRID.shape), 5) * 18.0


def scenario(**ground: object) -> Scenario:
    return checked_scenario({
        "name": "driving", "region": "t1", "rounds": 2, "samples_per_round": 3, "start_m": [20.0, 20.0],
        "rover": {"initial_charge": CHARGED, "solar_w": 150.0, "drill_w": 0.0, "analysis_w": 0.0},
        "ground": {"planner": "rrtstar", "cost": "energy", **ground},
    }, "test")  # fmt: skip


@pytest.mark.parametrize("heights", [np.zeros(GRID.shape), hills()], ids=["level", "hills"])
def test_the_rover_takes_the_time_and_the_energy_that_the_plans_foresaw(heights: FloatArray) -> None:
    """The sun gives just the base load, and only driving takes more: what the battery loses is the driving's."""
    wanted, ground = scenario(), region(heights)
    mission = InProcessMission(wanted, nodes=build_nodes(wanted, ground))
    states: list[RoverState] = []
    plans: dict[int, RoundPlan] = {}
    statuses: list[GroundStatus] = []

    def listen(topic: Topic, side: Side, payload: bytes, _now: MissionTime) -> None:
        if topic is STATE and side is Side.MOON:
            states.append(decode(topic, payload, wanted.name)[1])
        elif topic is PLAN and side is Side.EARTH:
            plans.update({planned.round: planned for planned in decode(topic, payload, wanted.name)[1].rounds})
        elif topic is GROUND_STATUS:
            statuses.append(decode(topic, payload, wanted.name)[1])

    mission.simulation.tap(listen)
    mission.run()
    terrain = DrivenGround(GRID, ground.slope_deg, ground.elevation_m, wanted.rover.driving)
    foreseen = sum((terrain.figures(planned.path_m) for planned in plans.values()), DriveFigures())
    spent_j = (CHARGED * wanted.rover.capacity_wh - states[-1].energy_wh) * 3600.0
    assert foreseen.length_m > 50.0
    assert spent_j == pytest.approx(foreseen.motion_j, rel=2e-3)
    tally = statuses[-1].cost
    assert tally is not None
    assert (tally.kind, tally.unit) == ("energy", "Wh")
    assert tally.spent * 3600.0 == pytest.approx(foreseen.energy_j, rel=2e-3)
    work_s = 6 * (wanted.sample_depth_m * wanted.rover.drill_s_per_m + wanted.rover.analysis_s)
    assert mission.mission_time_s > foreseen.duration_s + work_s
    if not heights.any():
        assert foreseen.duration_s == pytest.approx(foreseen.length_m / wanted.rover.speed_m_s)


def test_an_energy_budget_is_kept_and_what_it_leaves_is_counted_in_level_metres() -> None:
    wanted, ground = scenario(budget_wh=100.0), region(hills())
    terrain = DrivenGround(GRID, ground.slope_deg, ground.elevation_m, wanted.rover.driving)
    costs = DrivingCosts("energy", terrain, ground.traversable)
    budget = Budget(wanted, 25_600.0, 5.0, costs.unit, costs.level_metres_a_metre)
    level_wh = (150.0 / 0.1 + 240.0) / 3600.0
    ahead = terrain.figures([(20.0, 20.0), (60.0, 60.0)])
    left = budget.left(wanted.start_ns, 50.0, Committed(0.0, 3, 1, ahead), 6, spent=30.0)
    assert left.metres == pytest.approx((70.0 - ahead.energy_j / 3600.0) / level_wh, abs=0.1)
    none = budget.left(wanted.start_ns, 50.0, Committed(0.0, 3, 1, ahead), 6, spent=100.0)
    assert (none.samples, none.why) == (0, "the budget of 100 Wh is spent or promised")


def test_hours_are_counted_by_the_slopes_of_the_rounds_that_are_planned() -> None:
    wanted, ground = scenario(cost="time", budget_h=10.0, pipeline=1), region(hills())
    terrain = DrivenGround(GRID, ground.slope_deg, ground.elevation_m, wanted.rover.driving)
    costs = DrivingCosts("time", terrain, ground.traversable)
    mean_deg = float(ground.slope_deg.mean())
    budget = Budget(wanted, 25_600.0, mean_deg, costs.unit, costs.level_metres_a_metre)
    ahead = terrain.figures([(20.0, 20.0), (60.0, 60.0)])
    nothing = budget.left(wanted.start_ns, 0.0, Committed(0.0, 0, 0), 6).metres
    less = budget.left(wanted.start_ns, 0.0, Committed(0.0, 0, 0, ahead), 6).metres
    assert nothing == pytest.approx((36_000 - 6 * (360 + 300)) * 0.1, rel=1e-6)  # level metres at the level speed
    assert nothing - less == pytest.approx(ahead.duration_s * 0.1, rel=1e-6)
    assert budget.lasts_s(Committed(0.0, 0, 0, ahead)) == pytest.approx(ahead.duration_s)


def test_without_another_cost_the_ground_counts_metres() -> None:
    ground = region(hills())
    terrain = DrivenGround(GRID, ground.slope_deg, ground.elevation_m, scenario().rover.driving)
    costs = DrivingCosts("distance", terrain, ground.traversable)
    assert costs.terrain is None
    assert (costs.unit.unit, costs.spent(RoundLog(), 12.5)) == ("m", 12.5)


@pytest.mark.parametrize(
    ("ground", "expected"),
    [
        ({"cost": "energy", "budget_m": 100.0}, 'expected budget_wh with cost "energy", got budget_m'),
        ({"cost": "time", "budget_m": 100.0}, 'expected budget_h with cost "time", got budget_m'),
        ({"cost": "time", "budget_wh": 100.0}, 'expected cost "energy" with budget_wh, got "time"'),
        ({"cost": "energy", "planner": "rrt"}, 'expected cost "distance" with planner rrt'),
        ({"cost": "money"}, "ground.cost"),
    ],
)
def test_a_budget_or_a_planner_that_does_not_go_with_the_cost_is_refused(
    ground: dict[str, object], expected: str
) -> None:
    with pytest.raises(InvalidInput, match=expected):
        scenario(**ground)

"""Budgets in metres and hours."""

from __future__ import annotations

from math import inf

import pytest

from services.ground.budget import Budget, Committed
from services.mission.mission_time import SECOND
from services.mission.scenario import Scenario

NOTHING = Committed(0.0, 0, 0)


def budget(**ground: float) -> Budget:
    base = Scenario(name="test", region="t1").changed(
        ground=ground, rover={"speed_m_s": 0.1, "drill_s_per_m": 3600.0, "analysis_s": 240.0}
    )
    return Budget(base, open_area_m2=225_000.0, mean_slope_deg=0.0)


START = Scenario(name="test", region="t1").start_ns


def test_without_a_budget_everything_may_be_planned() -> None:
    allowance = budget().left(START, 1e6, NOTHING, 150)
    assert (allowance.samples, allowance.metres) == (150, inf)


def test_metres_driven_and_committed_are_deducted() -> None:
    allowance = budget(budget_m=1000.0).left(START, 300.0, Committed(250.0, 5, 1), 100)
    assert allowance.samples == 100
    assert allowance.metres == pytest.approx(450.0, abs=0.1)


def test_a_budget_in_metres_that_is_committed_allows_no_sample_and_says_why() -> None:
    allowance = budget(budget_m=1000.0).left(START, 300.0, Committed(700.0, 5, 1), 100)
    assert (allowance.samples, allowance.metres) == (0, 0.0)
    assert allowance.why == "the budget of 1000 m is spent or promised"


def test_hours_are_spent_on_samples_first_and_the_rest_is_driven() -> None:
    # 150 samples of 600 s are 25 h; with pipelining the 75 h left over are driven at 0.1 m/s.
    allowance = budget(budget_h=100.0, pipeline=1).left(START, 0.0, NOTHING, 150)
    assert allowance.samples == 150
    assert allowance.metres == pytest.approx(75 * 3600 * 0.1)


def test_where_the_hours_do_not_suffice_fewer_samples_are_planned_and_each_keeps_a_leg_of_a_tour() -> None:
    allowance = budget(budget_h=10.0, pipeline=1).left(START, 0.0, NOTHING, 150)
    leg_s = 0.7124 * (225_000 / 150) ** 0.5 / 0.1
    assert allowance.samples == int(36_000 / (600 + leg_s))
    assert allowance.metres >= allowance.samples * leg_s * 0.1


def test_time_that_has_passed_or_is_committed_is_deducted() -> None:
    whole = budget(budget_h=100.0, pipeline=1).left(START, 0.0, NOTHING, 10).metres
    later = budget(budget_h=100.0, pipeline=1).left(START + 3600 * SECOND, 0.0, Committed(100.0, 2, 1), 10).metres
    assert whole - later == pytest.approx(360.0 + 100.0 + 120.0)


def test_after_its_hours_a_mission_may_plan_nothing() -> None:
    allowance = budget(budget_h=1.0).left(START + 3601 * SECOND, 0.0, NOTHING, 10)
    assert (allowance.samples, allowance.why) == (0, "the budget of 1 h is spent or promised")


def test_of_two_budgets_the_tighter_counts() -> None:
    both = budget(budget_h=100.0, budget_m=500.0, pipeline=1).left(START, 0.0, NOTHING, 10)
    assert both.metres == pytest.approx(500.0, abs=0.1)


def hungry(charge_wh: float, solar_w: float = 250.0, **ground: float) -> Budget:
    """100 W beyond the base load, 400 W to drill for 360 s and nothing to analyse: each sample is 30 Wh short."""
    rover = {
        "speed_m_s": 0.1,
        "drill_s_per_m": 3600.0,
        "analysis_s": 0.0,
        "drill_w": 400.0,
        "traction_j_per_m": 1000.0,
        "solar_w": solar_w,
        "base_load_w": 150.0,
        "capacity_wh": 200.0,
        "reserve": 0.2,
        "resume_charge": 0.5,
    }
    changed = Scenario(name="test", region="t1").changed(ground={"pipeline": 1, **ground}, rover=rover)
    hours = Budget(changed, open_area_m2=225_000.0, mean_slope_deg=0.0)
    hours.heard(charge_wh)
    return hours


def test_what_the_battery_holds_beyond_its_reserve_need_not_be_charged() -> None:
    assert hungry(100.0).lasts_s(Committed(0.0, 2, 1)) == pytest.approx(720.0)
    assert hungry(40.0).lasts_s(NOTHING) == 0.0


def test_a_rover_that_runs_short_charges_to_its_level_each_time() -> None:
    one_charge_s = 60.0 * 3600 / 100
    assert hungry(99.0).lasts_s(Committed(0.0, 2, 1)) == pytest.approx(720.0 + one_charge_s)
    assert hungry(40.0).lasts_s(Committed(0.0, 5, 1)) == pytest.approx(5 * 360.0 + 3 * one_charge_s)


def test_driving_on_the_sun_alone_takes_no_charging() -> None:
    assert hungry(40.0).lasts_s(Committed(5000.0, 0, 1)) == pytest.approx(50_000.0)


def test_without_sun_a_rover_does_what_its_battery_allows() -> None:
    dark = hungry(200.0, solar_w=150.0, budget_h=10.0)
    assert dark.lasts_s(Committed(0.0, 4, 1)) == pytest.approx(4 * 360.0)
    assert dark.lasts_s(Committed(0.0, 5, 1)) == inf
    allowance = dark.left(START, 0.0, NOTHING, 50)
    assert 1 <= allowance.samples < 4
    energy_j = allowance.metres * 1000.0 + allowance.samples * 360.0 * 400.0
    assert energy_j == pytest.approx(160.0 * 3600)

"""The command-loss watchdog of a rover with nothing to do."""

from __future__ import annotations

from schemas.telemetry import EventKind
from services.mission.mission_time import seconds
from tests.unit.rover.simulated_moon import SAMPLE_S, Moon, east, plan_of


def test_a_parked_rover_that_hears_nothing_enters_safe_mode_until_a_plan_comes():
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


def test_the_watchdog_does_not_run_while_the_rover_has_something_to_do():
    moon = Moon(watchdog_s=1000.0)
    moon.plan(plan_of(1, *(east(k, 5.5 * k, 5.5 * (k + 1)) for k in range(1, 8))))
    moon.run(7 * (55 + SAMPLE_S))
    assert moon.kinds("safe_mode_entered") == []
    assert len(moon.samples) == 7

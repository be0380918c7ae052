"""How many samples and metres the rest of the mission may take, from budgets in metres, hours or both."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from services.node import SECOND, MissionTime
from services.scenario import Scenario

TOUR_CONSTANT = 0.7124
"""Length of the shortest tour through n random places in an area A is about this times sqrt(n A)
(Beardwood, Halton & Hammersley 1959)."""

ROUNDING_M = 0.05
"""Paths go up rounded to the millimetre; so much may be lost by it in a round [m]."""


@dataclass(frozen=True, slots=True)
class Committed:
    """What is already promised to rounds that are planned and not over."""

    metres: float
    samples: int
    rounds: int


@dataclass(frozen=True, slots=True)
class Allowance:
    """What is left beyond that; with no samples left, `why` says what ran out."""

    samples: int
    metres: float
    why: str = ""


class Budget:
    """The scenario's budgets, ready to be asked."""

    def __init__(self, scenario: Scenario, open_area_m2: float, mean_slope_deg: float) -> None:
        rover, ground, link = scenario.rover, scenario.ground, scenario.link
        self._metres = ground.budget_m
        self._ends: MissionTime | None = None
        if ground.budget_h is not None:
            self._ends = scenario.start_ns + round(ground.budget_h * 3600 * SECOND)
        self._hours = ground.budget_h
        self._sample_s = scenario.sample_depth_m * rover.drill_s_per_m + rover.analysis_s
        self._speed_m_s = rover.speed_m_s / (1 + rover.slope_slowdown * mean_slope_deg / rover.slope_limit_deg)
        self._leg_m = TOUR_CONSTANT * (open_area_m2 / scenario.samples) ** 0.5
        self._per_round = scenario.samples_per_round
        # Stop-and-wait pays planning and a round trip for every round; a pipeline hides them.
        idle = ground.planning_s + link.up.one_way_light_time_s + link.down.one_way_light_time_s
        self._round_s = idle if ground.pipeline == 0 else 0.0

    def lasts_s(self, committed: Committed) -> float:
        """How long that is going to take at the pace to be expected on this terrain [s]."""
        return committed.metres / self._speed_m_s + committed.samples * self._sample_s

    def left(self, now: MissionTime, driven_m: float, committed: Committed, samples_wanted: int) -> Allowance:
        """What may still be planned, of the samples that are still wanted.

        Hours are turned into metres at the pace to be expected on this terrain; where they do not suffice for all
        samples, as many are planned as fit with legs of a good tour between them.
        """
        metres = inf
        if self._metres is not None:
            metres = self._metres - driven_m - committed.metres - ROUNDING_M
            if metres <= 0:
                return Allowance(0, 0.0, f"the budget of {self._metres:g} m is spent or promised")
        if self._ends is None:
            return Allowance(samples_wanted, metres)
        time_s = (self._ends - now) / SECOND - self.lasts_s(committed) - committed.rounds * self._round_s
        each_s = self._sample_s + self._round_s / self._per_round
        samples = min(samples_wanted, int(max(0.0, time_s) / (each_s + self._leg_m / self._speed_m_s)))
        if samples < 1:
            return Allowance(0, 0.0, f"the budget of {self._hours:g} h is spent or promised")
        return Allowance(samples, min(metres, (time_s - samples * each_s) * self._speed_m_s))

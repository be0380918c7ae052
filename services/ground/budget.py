"""How many samples and metres the rest of the mission may take, from budgets in metres, hours or both."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace
from math import ceil, inf, isfinite, pi, radians, tan
from typing import TYPE_CHECKING

from he3.driving import J_PER_WH, DriveFigures
from services.mission.mission_time import SECOND, MissionTime

if TYPE_CHECKING:
    from he3.driving_cost import CostUnit
    from services.mission.scenario import Scenario
    from services.runtime.node import SavedState

TOUR_CONSTANT = 0.7124
"""Length of the shortest tour through n random places in an area A is about this times sqrt(n A)
(Beardwood, Halton & Hammersley 1959)."""

MAX_HALVINGS = 100
MIN_M = 1e-6
"""Precision to which the metres that fit into the hours are computed [m]."""

ROUNDING_M = 0.05
"""Reserve per round [m], because paths are sent rounded to the millimetre and may become longer."""


NO_DRIVE = DriveFigures()


@dataclass(frozen=True, slots=True)
class Committed:
    """Metres and samples that the planned and unfinished rounds will still take."""

    metres: float
    """Not those of `driving`."""
    samples: int
    rounds: int
    driving: DriveFigures = NO_DRIVE
    """What driving over the terrain takes, where it is known in detail."""


@dataclass(frozen=True, slots=True)
class RemainingBudget:
    """What may still be planned besides committed rounds; if no sample may, `why` says which budget is used up."""

    samples: int
    metres: float
    """Level metres, where legs cost time or energy (``he3.driving_cost``)."""
    why: str = ""


@dataclass(frozen=True, slots=True)
class ExpectedDrive:
    """A drive, and the charging that it needs."""

    duration_s: float
    """Charging included; infinite if the sun never charges the rover enough."""
    energy_wh: float
    """Without the base load."""
    charge_wh: float
    """Of the battery at its end."""


class Budget:
    """The scenario's budgets. Climbs are those on a plane of the mean slope, averaged over all headings."""

    def __init__(
        self,
        scenario: Scenario,
        open_area_m2: float,
        mean_slope_deg: float,
        unit: CostUnit | None = None,
        level_metres: float = 1.0,
    ) -> None:
        """unit: of the mission's cost. level_metres: cost of a metre of open ground [level m]."""
        rover, ground, link = scenario.rover, scenario.ground, scenario.link
        self._metres = ground.budget_m
        self._ends: MissionTime | None = None
        if ground.budget_h is not None:
            self._ends = scenario.start_ns + round(ground.budget_h * 3600 * SECOND)
        self._hours = ground.budget_h
        self._energy_wh = ground.budget_wh
        self._unit = unit
        self._level_metres = level_metres
        drill_s = scenario.sample_depth_m * rover.drill_s_per_m
        self._sample_s = drill_s + rover.analysis_s
        self._speed_m_s = rover.speed_m_s / (1 + rover.slope_slowdown * mean_slope_deg / rover.slope_limit_deg)
        self._sample_j = drill_s * rover.drill_w + rover.analysis_s * rover.analysis_w
        self._metre_j = rover.traction_j_per_m + rover.climb_j_per_m * tan(radians(mean_slope_deg)) / pi
        self._surplus_w = rover.solar_w - rover.base_load_w
        self._capacity_wh = rover.capacity_wh
        self._reserve_wh = rover.reserve * rover.capacity_wh
        self._charged_j = (rover.resume_charge - rover.reserve) * rover.capacity_wh * J_PER_WH
        self._charge_wh = rover.initial_charge * rover.capacity_wh
        self._leg_m = TOUR_CONSTANT * (open_area_m2 / scenario.samples) ** 0.5
        self._per_round = scenario.samples_per_round
        # With stop-and-wait every round costs the planning and a round trip of light; a pipeline hides them.
        idle = ground.planning_s + link.up.one_way_light_time_s + link.down.one_way_light_time_s
        self._round_s = idle if ground.pipeline == 0 else 0.0

    def heard(self, charge_wh: float) -> None:
        """Note the battery charge [Wh] that the rover has reported."""
        self._charge_wh = min(charge_wh, self._capacity_wh)

    def lasts_s(self, committed: Committed) -> float:
        """Expected duration [s] of the committed rounds on this terrain, charging included.

        When the battery is down to its reserve the rover stands and charges, each time up to the same level; infinite
        if the sun never charges it.
        """
        driving = committed.driving
        work_s = committed.metres / self._speed_m_s + committed.samples * self._sample_s + driving.duration_s
        need_j = committed.metres * self._metre_j + committed.samples * self._sample_j + driving.motion_j
        usable_j = max(0.0, self._charge_wh - self._reserve_wh) * J_PER_WH
        missing_j = need_j - self._surplus_w * work_s - usable_j
        if missing_j <= 0:
            return work_s
        if self._surplus_w <= 0:
            return inf
        return work_s + ceil(missing_j / self._charged_j) * self._charged_j / self._surplus_w

    def drive(self, driving: DriveFigures) -> ExpectedDrive:
        """The expected duration and energy of a drive with those figures from now on."""
        duration_s = self.lasts_s(Committed(0.0, 0, 0, driving))
        energy_wh = driving.motion_j / J_PER_WH
        if not isfinite(duration_s):
            return ExpectedDrive(duration_s, energy_wh, min(self._charge_wh, self._reserve_wh))
        charge_wh = self._charge_wh + self._surplus_w * duration_s / J_PER_WH - energy_wh
        return ExpectedDrive(duration_s, energy_wh, min(max(0.0, charge_wh), self._capacity_wh))

    def left(
        self, now: MissionTime, driven_m: float, committed: Committed, samples_wanted: int, spent: float = 0.0
    ) -> RemainingBudget:
        """The number of wanted samples, and the metres, that may still be planned.

        spent: what driving has cost so far, in the unit.
        Hours are converted into metres at the pace expected on this terrain, less the time for charging. Where they do
        not suffice for all samples, as many are planned as fit with the legs of a good tour between them.
        """
        metres = inf
        if self._metres is not None:
            metres = self._metres - driven_m - committed.metres - ROUNDING_M
            if metres <= 0:
                return RemainingBudget(0, 0.0, f"the budget of {self._metres:g} m is spent or promised")
        if self._energy_wh is not None and self._unit is not None:
            left_wh = self._energy_wh - spent - self._unit.of(committed.driving)
            metres = left_wh / self._unit.per_level_metre - ROUNDING_M
            if metres <= 0:
                return RemainingBudget(0, 0.0, f"the budget of {self._energy_wh:g} Wh is spent or promised")
        if self._ends is None:
            return RemainingBudget(samples_wanted, metres)
        time_s = (self._ends - now) / SECOND

        def fits(more_m: float, more: int) -> bool:
            more_m /= self._level_metres
            planned = replace(committed, metres=committed.metres + more_m, samples=committed.samples + more)
            waits_s = (committed.rounds + more / self._per_round) * self._round_s
            return self.lasts_s(planned) + waits_s <= time_s

        counts = range(1, samples_wanted + 1)
        samples = bisect_left(counts, True, key=lambda count: not fits(count * self._leg_m, count))
        if samples < 1:
            return RemainingBudget(0, 0.0, f"the budget of {self._hours:g} h is spent or promised")
        least, most = samples * self._leg_m, time_s * self._speed_m_s * self._level_metres
        for _ in range(MAX_HALVINGS):
            if most - least <= MIN_M:
                break
            half = (least + most) / 2
            least, most = (half, most) if fits(half, samples) else (least, half)
        return RemainingBudget(samples, min(metres, least))

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "charge_wh": self._charge_wh,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the budget from this state."""
        self._charge_wh = state["charge_wh"]

"""Recognises a stalled mission: a mission in which nothing can change any more must end.

Contact may be over, every message lost or damaged, the battery empty with no sun to charge it: the ground then waits
for reports that never come. It cannot see the reason, but it sees that there is no progress. Progress is a sample, an
event or a command report that arrives, metres driven or drilled, energy gained, and any action of the operator. All of
these but the operator's actions can happen only a finite number of times, because rounds, rejections and rounds without
samples are bounded, and so is the energy between two steps. So every wait ends.

The time without progress that is waited for, in mission time while this process runs, is the scenario's patience, and
on top of it what the light, the link's rate and the rover's own steps may take. At least three contact periods must
have passed, unless no further one comes: then six hours are enough.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.telemetry import RoverMode, RoverState
from services.mission.mission_time import SECOND, MissionTime, seconds

if TYPE_CHECKING:
    from schemas.link import DirectionConditions, LinkStatus
    from services.mission.scenario import Scenario
    from services.runtime.node import SavedState

CONTACT_PERIODS = 3  # that must pass without progress
ROUND_TRIPS = 10  # that must pass: a plan goes up, its first sample comes down, each repeated a few times
LARGEST_PLAN_BITS = 8 * 200_000
CONTACT_OVER_S = 6 * 3600.0  # enough when no contact is to come: only an operator can change that
WALL_S = 300.0  # on the wall clock, at the scenario's rate: the processes of a slow machine need time to start
STEPS = 2  # pieces of path, bites and analyses one after another that the ground may not hear of
ENERGY_SHARE = 1e-4  # of the battery's capacity; a smaller gain is no progress
HELD = frozenset({RoverMode.PAUSED, RoverMode.SAFE})


class StallWatch:
    """How long the mission has stood still, and whether that is too long."""

    def __init__(self, scenario: Scenario) -> None:
        rover, ground = scenario.rover, scenario.ground
        slowest_m_s = rover.speed_m_s / (1.0 + rover.slope_slowdown)
        step_s = rover.look_ahead_m / slowest_m_s + rover.bite_m * rover.drill_s_per_m + rover.analysis_s
        patience_s, wall_s = 3600.0 * ground.patience_h, WALL_S * scenario.rate
        on_top_s = STEPS * step_s + 2.0 * rover.state_period_s
        self._patience_s: float = max(patience_s, wall_s) + on_top_s
        self._contact_over_s: float = max(min(patience_s, CONTACT_OVER_S), wall_s) + on_top_s
        self._conditions = scenario.link
        self._start = scenario.start_ns
        self._longest_tick = 2 * seconds(ground.status_period_s)
        self._ticked_at: MissionTime = scenario.start_ns
        self._waited: MissionTime = 0
        self._since: MissionTime = scenario.start_ns
        self._work: tuple[float, float] = (0.0, 0.0)
        self._most_wh = 0.0

    @property
    def patience_s(self) -> float:
        """Seconds of mission time without progress after which the mission has stalled, while contact is to come."""
        return self._patience_s + self._delivery_s

    @property
    def _delivery_s(self) -> float:
        return _link_s(self._conditions.up) + _link_s(self._conditions.down)

    def progress(self, now: MissionTime) -> None:
        """Something has changed."""
        self._since = now
        self._waited = 0
        self._most_wh = 0.0

    def state(self, state: RoverState, held: bool, now: MissionTime) -> None:
        """Note the rover's state; held: whether a command of the operator holds it still."""
        work = (state.driven_m, state.drilled_m)
        before = self._work
        self._work = (max(before[0], work[0]), max(before[1], work[1]))
        if self._work != before or (held and state.mode in HELD):
            self.progress(now)
        elif state.energy_wh > self._most_wh + ENERGY_SHARE * state.capacity_wh:
            charging = self._most_wh > 0.0
            self._most_wh = state.energy_wh
            if charging:
                self._since, self._waited = now, 0

    def link(self, status: LinkStatus, now: MissionTime) -> None:
        """Note the link's conditions, which the operator may have changed."""
        self._conditions = status.conditions
        if status.contact_forced is not None:
            self._conditions = status.conditions.model_copy(update={"windows": (), "duty_cycle": None})
        if status.contact_forced is False:
            self.progress(now)  # a black-out that the operator began is the operator's to end

    def tick(self, now: MissionTime) -> bool:
        """Whether the mission has stalled; to be called once a status period.

        Time in which this process did not run, as on a machine that was suspended, does not count.
        """
        self._waited += min(now - self._ticked_at, self._longest_tick)
        self._ticked_at = now
        return self.stalled(now)

    def stalled(self, now: MissionTime) -> bool:
        """Whether the mission has stood still for too long."""
        if self._contact_is_over(now):
            return self._waited > seconds(self._contact_over_s + self._delivery_s)
        return self._waited > seconds(self.patience_s) and self._contact_was_enough(now)

    def why(
        self, now: MissionTime, rover: RoverState | None, silent_s: float | None, plan_revision: int, detail: str
    ) -> str:
        """The known reasons of the stall, in one line.

        rover: its newest state; silent_s: since it was last heard from [s], None if never; plan_revision: of the plan
        sent last; detail: the last note for the operator.
        """
        if silent_s is None:
            reasons = ["the rover was never heard from"]
        elif silent_s > self._waited / SECOND / 2.0:
            reasons = [f"the rover was last heard from {silent_s / 3600.0:.0f} h ago"]
        elif rover is not None and rover.plan_revision < plan_revision:
            reasons = [f"plan {plan_revision} has not reached the rover"]
        else:
            reasons = ["the rover reports but does nothing" if rover is None else f"the rover is {rover.mode.value}"]
        if self._contact_is_over(now):
            closed_s = self._conditions.windows[-1].closes_s
            reasons.append(f"the last contact window closed {closed_s:g} s after the mission began")
        if detail:
            reasons.append(detail)
        return f"no progress for {self._waited / SECOND / 3600.0:.0f} h: {'; '.join(reasons)}"[:400]

    def _contact_is_over(self, now: MissionTime) -> bool:
        """Whether the last contact window has closed."""
        windows = self._conditions.windows
        return bool(windows) and self._start + seconds(windows[-1].closes_s) <= now

    def _contact_was_enough(self, now: MissionTime) -> bool:
        """Whether enough contact periods have passed since the last progress, or the contact is not divided."""
        if self._conditions.duty_cycle is not None:
            cycle = self._conditions.duty_cycle
            first = self._start + seconds(cycle.offset_s + cycle.contact_s)
            since, until = ((time - first) // seconds(cycle.period_s) for time in (self._since, now))
            return until - since >= CONTACT_PERIODS
        closes = [self._start + seconds(window.closes_s) for window in self._conditions.windows]
        return not closes or sum(self._since < each <= now for each in closes) >= CONTACT_PERIODS

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "conditions": self._conditions,
            "ticked_at": self._ticked_at,
            "waited": self._waited,
            "since": self._since,
            "work": self._work,
            "most_wh": self._most_wh,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the watch from this state."""
        self._conditions, self._ticked_at = state["conditions"], state["ticked_at"]
        self._waited, self._since = state["waited"], state["since"]
        self._work, self._most_wh = state["work"], state["most_wh"]


def _link_s(direction: DirectionConditions) -> float:
    """Longest delivery time [s] in that direction, a few repetitions included."""
    light_s = 2.0 * direction.one_way_light_time_s + direction.jitter_s
    sending_s = 0.0 if direction.rate_bit_s is None else LARGEST_PLAN_BITS / direction.rate_bit_s
    return ROUND_TRIPS * light_s + sending_s

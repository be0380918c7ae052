"""The mission's goal (`ground.goal`): whether the map is good enough, and what it still takes, as planners foresee it.

The certificate is made anew after each refit, when the hyperparameters account for all samples of the rounds that are
over. Over the cells of an area the stated standard deviation is that of the map; under each kernel of the mixture it is
computed at places that are spread over the area. The means over blocks are computed as such.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from he3.certificate import (
    Certificate,
    Targets,
    blocks_of,
    certified_weight,
    certify,
    likely_distance,
    places_of,
    unseen_share,
)
from he3.errors import InvalidInput
from he3.mixture import ProcessMixture
from schemas.ground import GoalStatus
from services.ground.planners.interface import PlanningGoal
from services.ground.terrain import cells_inside, interest_area_objection
from services.mission.scenario import Blocks
from services.runtime.node import Level, LogRecord

if TYPE_CHECKING:
    from he3.frames import BoolArray, SiteGrid
    from schemas.ground import GoalForecast
    from services.ground.belief import Belief
    from services.ground.planners.interface import PlannedRound
    from services.mission.scenario import GoalConfig, Scenario
    from services.runtime.node import SavedState


@dataclass(frozen=True, slots=True, eq=False)
class GoalGround:
    """The area of a goal."""

    targets: Targets
    cells: BoolArray | None
    """(rows, columns): the area's cells; None for blocks."""


def goal_ground(config: GoalConfig, grid: SiteGrid) -> GoalGround:
    """The area of that goal on the site; raises InvalidInput, in one line, for one that is not on it."""
    if isinstance(config.area, Blocks):
        return GoalGround(blocks_of(grid, config.area.blocks_m), None)
    if config.area == "everywhere":
        cells = np.ones(grid.shape, dtype=np.bool_)
    else:
        if not grid.contains(np.array(config.area)).all():
            raise InvalidInput(
                f"expected corners within 0..{grid.width_m:g} m east and 0..{grid.height_m:g} m north, got one outside"
            )
        if (why := interest_area_objection(grid, config.area)) is not None:
            raise InvalidInput(why)
        cells = cells_inside(grid, config.area)
    return GoalGround(places_of(grid, cells), cells)


class MissionGoal:
    """The goal of a mission and its certificate; without a goal nothing ever holds."""

    def __init__(self, scenario: Scenario, grid: SiteGrid, belief: Belief) -> None:
        """Raises InvalidInput, in one line that names the key, for an area that is not on the site."""
        self._config = scenario.ground.goal
        self._belief = belief
        self._ground: GoalGround | None = None
        if self._config is not None:
            try:
                self._ground = goal_ground(self._config, grid)
            except InvalidInput as error:
                raise InvalidInput(f"scenario '{scenario.name}': ground.goal.area: {error}") from None
        self._noise_ppb = scenario.field.noise_std_ppb
        self._looked = 0
        self._certificate: Certificate | None = None
        self._forecast: GoalForecast | None = None
        self._news: list[str] = []
        self._status: GoalStatus | None = None
        self._made_of: tuple[Certificate | None, GoalForecast | None] = (None, None)
        """What the status was made of, which is asked for at every event."""

    def for_planners(self) -> PlanningGoal | None:
        """What planners are told of it."""
        if self._config is None or self._ground is None:
            return None
        aim_ppb = self._config.std_ppb if self._certificate is None else self._certificate.aim_ppb
        targets = self._ground.targets
        if self._belief.hyperparameters.warps:
            targets = targets.on_map(self._belief.grid, self._belief.map.mean_ppb)
        return PlanningGoal(targets, aim_ppb, self._config.probability)

    @property
    def note(self) -> str:
        """What is remarkable about it from the beginning; may be empty."""
        if self._config is None or isinstance(self._config.area, Blocks) or self._config.std_ppb > self._noise_ppb:
            return ""
        return (
            f"the goal of {self._config.std_ppb:g} ppb is not above the instrument's noise of {self._noise_ppb:g} ppb: "
            "it takes several samples for each place"
        )

    def holds(self) -> bool:
        """Whether the goal is certified, by all rounds that the hyperparameters are fitted to."""
        if self._config is None or self._ground is None:
            return False
        if self._looked != self._belief.fits:
            self._looked = self._belief.fits
            self._certificate = self._certified(self._config, self._ground)
            if self._certificate.holds:
                self._news.append(self.why)
        return self._certificate is not None and self._certificate.holds

    def _certified(self, config: GoalConfig, ground: GoalGround) -> Certificate:
        mixture, extent_m = ProcessMixture.of(self._belief.process), self._belief.grid.extent_m
        if ground.cells is None:
            return certify(mixture, ground.targets, config.std_ppb, config.probability, extent_m)
        std = np.where(ground.cells, self._belief.map.std_ppb, 0.0)
        row, column = np.unravel_index(int(np.argmax(std)), std.shape)
        cell_m = self._belief.grid.resolution_m
        stated = Certificate(
            std_ppb=config.std_ppb,
            probability=config.probability,
            worst_ppb=float(std[row, column]),
            worst_at_m=((float(column) + 0.5) * cell_m, (float(row) + 0.5) * cell_m),
            share=float(np.mean(std[ground.cells] <= config.std_ppb)),
            weight=None,
            likely_ppb=likely_distance(mixture, ground.targets, config.probability),
            unseen=unseen_share(self._belief.places_m, ground.targets, extent_m),
            most_unseen=ground.targets.most_unseen,
        )
        if stated.worst_ppb > config.std_ppb:
            return stated
        return replace(stated, weight=certified_weight(mixture, ground.targets, config.std_ppb))

    @property
    def why(self) -> str:
        """The certificate in words."""
        config, found = self._config, self._certificate
        if config is None or found is None:
            return ""
        blocks = isinstance(config.area, Blocks)
        parts = "the blocks" if blocks else "the area"
        head = f"std at most {config.std_ppb:g} ppb {config.area_text}"
        if found.holds:
            return (
                f"the goal holds: {head} (greatest {found.worst_ppb:.3f} ppb), under {found.weight or 0.0:.1%} of the "
                f"hyperparameters' probability ({config.probability:.1%} wanted); {config.probability:.1%} of {parts} "
                f"{'are' if blocks else 'is'} within {found.within_ppb:.2f} ppb of the map"
            )
        lacks = []
        if found.weight is not None and found.weight < config.probability:
            lacks.append(
                f"under {found.weight:.1%} of the hyperparameters' probability ({config.probability:.1%} wanted)"
            )
        if found.likely_ppb > found.within_ppb:
            lacks.append(f"likely within {found.likely_ppb:.2f} ppb of the map ({found.within_ppb:.2f} wanted)")
        if found.unseen > found.most_unseen:
            lacks.append(f"{found.unseen:.0%} unseen where samples are far ({found.most_unseen:.0%} wanted)")
        reach = f"{found.share:.1%} of {parts} {'reach' if blocks else 'reaches'} it"
        x, y = found.worst_at_m
        but = f", but {', '.join(lacks)}" if lacks else ""
        return f"{head}: greatest {found.worst_ppb:.3f} ppb at ({x:.0f}, {y:.0f}) m, {reach}{but}"

    def planned(self, planned: PlannedRound, now_known: int) -> list[LogRecord]:
        """Note what the planner foresees; a warning when the goal is found to be out of reach.

        now_known: samples in the map.
        """
        if self._config is None or planned.forecast is None:
            return []
        before, self._forecast = self._forecast, planned.forecast
        if planned.forecast.reachable or (before is not None and not before.reachable):
            return []
        text = f"the goal of {self._config.std_ppb:g} ppb cannot be reached: {planned.forecast.text}"
        if not now_known:
            text += ", by what is known before landing"
        self._news.append(text)
        return [LogRecord(Level.WARNING, text)]

    def status(self) -> GoalStatus | None:
        """The goal as operators see it; None if there is none."""
        made_of = self._certificate, self._forecast
        if self._status is None or self._made_of != made_of:
            self._status, self._made_of = self._made_status(), made_of
        return self._status

    def _made_status(self) -> GoalStatus | None:
        config, found = self._config, self._certificate
        if config is None:
            return None
        holds = found is not None and found.holds
        text = self.why or f"std at most {config.std_ppb:g} ppb {config.area_text}"
        if self._forecast is not None and not holds:
            text += f"; {self._forecast.text}"
        return GoalStatus(
            std_ppb=config.std_ppb,
            probability=config.probability,
            area=config.area_text,
            holds=holds,
            worst_ppb=None if found is None else found.worst_ppb,
            share=None if found is None else found.share,
            weight=None if found is None else found.weight,
            likely_ppb=None if found is None else found.likely_ppb,
            unseen=None if found is None else found.unseen,
            within_ppb=found.within_ppb if found is not None and holds else None,
            forecast=None if holds else self._forecast,
            text=text[:500],
        )

    def news(self) -> list[str]:
        """What is to be logged since the last call."""
        news, self._news = self._news, []
        return news

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "looked": self._looked,
            "certificate": self._certificate,
            "forecast": self._forecast,
            "news": list(self._news),
        }

    def restore(self, state: SavedState) -> None:
        """Restore the goal from this state."""
        self._looked, self._certificate = state["looked"], state["certificate"]
        self._forecast, self._news = state["forecast"], list(state["news"])

"""What paths over the ground's terrain cost: planned ones, those under way, and what has been driven."""

from __future__ import annotations

from typing import TYPE_CHECKING

from he3.driving import DriveFigures
from he3.driving_cost import cost_unit, terrain_cost
from services.ground.budget import Committed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from he3.driving import DrivenGround
    from he3.driving_cost import CostKind
    from he3.frames import BoolArray, Place
    from services.ground.round_log import RoundLog
    from services.ground.round_record import RoundRecord


class DrivingCosts:
    """The costs of paths, by the model by which the rover drives."""

    def __init__(self, kind: CostKind, ground: DrivenGround, open_cells: BoolArray) -> None:
        """open_cells (rows, columns): where paths lead. Raises InvalidInput for a cost that driving does not have."""
        self._ground = ground
        self.unit = cost_unit(kind, ground)
        """The unit in which budgets and reports count."""
        self.terrain = terrain_cost(kind, ground)
        """What planners keep low; None: the distance."""
        self.level_metres_a_metre = 1.0 if self.terrain is None else float(self.terrain.rate[open_cells].mean())
        """Cost of a metre of open ground, on average, without rises [level m]."""
        self._driven: dict[int, tuple[float, DriveFigures]] = {}

    def figures(self, path_m: Sequence[Place]) -> DriveFigures:
        """What driving along the path [m] takes."""
        return self._ground.figures(path_m)

    def committed(self, log: RoundLog) -> Committed:
        """What the rounds of the chain will still take: metres alone, or with a cost, driving in detail."""
        committed = log.committed()
        if self.terrain is None:
            return committed
        ahead = [self.figures(record.ahead()) for record in log.chain if not record.ended]
        return Committed(0.0, committed.samples, committed.rounds, sum(ahead, DriveFigures()))

    def spent(self, log: RoundLog, driven_m: float) -> float:
        """The cost of what has been driven, in the unit. driven_m: the odometer [m].

        Metres beside the rounds' paths, such as those of commanded drives, count as those of the paths on average, or
        as level ones before the first round.
        """
        if self.terrain is None:
            return driven_m
        driven = sum((self._of_round(record) for record in log.chain if record.begun), DriveFigures())
        known = self.unit.of(driven)
        beside_m = max(0.0, driven_m - driven.length_m)
        return known + beside_m * (known / driven.length_m if driven.length_m > 0 else self.unit.per_level_metre)

    def _of_round(self, record: RoundRecord) -> DriveFigures:
        """The figures of the part of the round that is driven; computed anew when the rover has moved on."""
        reached_m, figures = self._driven.get(record.introduced, (-1.0, DriveFigures()))
        if reached_m != record.reached_m:
            figures = self.figures(record.driven())
            self._driven[record.introduced] = record.reached_m, figures
        return figures

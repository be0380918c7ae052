"""The cost of driving over terrain, in level metres: the metres of level ground that take as much time or energy.

Of the model of ``he3.driving`` a path of length L with rises takes, per unit of what a level metre takes,

    C = sum over cells of rate(cell) * length in the cell + climb * sum of rises

with rate >= 1, so C >= L: a bound in level metres is one in metres, too, and ellipses of C hold all paths that cost no
more. The rises of a path and of its reverse differ by the difference in height of its ends alone. So legs are compared
by the symmetric cost

    S = sum of rate * length + climb / 2 * sum of |changes of height|,     C = S + climb / 2 * (h_end - h_begin)

in which paths between the same two ends are ordered as by C, and which a tour's order may use, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from he3.driving import J_PER_WH
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid, as_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from he3.driving import DriveFigures, DrivenGround

CostKind = Literal["distance", "time", "energy"]
UnitName = Literal["m", "h", "Wh"]
UNITS: Final[dict[CostKind, UnitName]] = {"distance": "m", "time": "h", "energy": "Wh"}
LegCost = Callable[[float, float, float, float], float]
"""Symmetric cost [level m] of the leg from (ax, ay) to (bx, by) [m]."""

_CHUNK: Final = 400_000  # crossings that are computed at once
_S_PER_H: Final = 3600.0  # s, exact


@dataclass(frozen=True, slots=True, eq=False)
class TerrainCost:
    """What legs over the cells of a site cost."""

    grid: SiteGrid
    rate: FloatArray
    """(rows, columns) level metres a metre, at least 1."""
    elevation_m: FloatArray
    """(rows, columns) [m]."""
    slope_deg: FloatArray
    """(rows, columns) [deg]."""
    climb: float
    """Level metres per metre of rise."""

    def of_legs(self, a_m: FloatArray, b_m: FloatArray) -> FloatArray:
        """Symmetric cost (n,) [level m] of the straight legs from a (n, 2) to b (n, 2) [m]."""
        a, b = as_points(a_m), as_points(b_m)
        costs = np.empty(len(a))
        cells = np.abs(np.floor(b / self.grid.resolution_m) - np.floor(a / self.grid.resolution_m)).sum(axis=1) + 2
        step = max(1, int(_CHUNK / max(1.0, float(cells.max(initial=1.0)))))
        for first in range(0, len(a), step):
            part = slice(first, first + step)
            widths, rows, columns = self._parts(a[part], b[part])
            height = self.elevation_m[rows, columns]
            lengths = np.hypot(*(b[part] - a[part]).T)
            costs[part] = lengths * (widths * self.rate[rows, columns]).sum(axis=1)
            if self.climb:
                costs[part] += 0.5 * self.climb * np.abs(np.diff(height, axis=1)).sum(axis=1)
        return costs

    def of_path(self, path_m: FloatArray) -> float:
        """Cost [level m] of driving the polyline (K, 2) [m] from its first vertex to its last."""
        return float(self.along(path_m)[-1])

    def along(self, path_m: FloatArray) -> FloatArray:
        """Cost (K,) [level m] from the first vertex of the polyline (K, 2) [m] to each vertex."""
        path = as_points(path_m)
        symmetric = np.concatenate(([0.0], np.cumsum(self.of_legs(path[:-1], path[1:]))))
        height = self.heights(path)
        along: FloatArray = symmetric + 0.5 * self.climb * (height - height[0])
        return along

    def metres_for(self, path_m: FloatArray, cost: float) -> float:
        """How many metres of the polyline (K, 2) [m] can be driven at that cost [level m]; its length if all can."""
        path, along = as_points(path_m), self.along(path_m)
        arc = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
        if along[-1] <= cost:
            return float(arc[-1])
        leg = max(1, int(np.argmax(along > cost)))
        low, high = 0.0, 1.0
        for _ in range(40):
            share = 0.5 * (low + high)
            place = path[leg - 1] + share * (path[leg] - path[leg - 1])
            if along[leg - 1] + self.of_path(np.vstack((path[leg - 1], place))) <= cost:
                low = share
            else:
                high = share
        return float(arc[leg - 1] + low * (arc[leg] - arc[leg - 1]))

    def steepest_deg(self, path_m: FloatArray) -> float:
        """The steepest cell [deg] below the polyline (K, 2) [m]."""
        path = as_points(path_m)
        _, rows, columns = self._parts(path[:-1], path[1:]) if len(path) > 1 else (None, *self.grid.cells_of(path))
        return float(self.slope_deg[rows, columns].max())

    def heights(self, places_m: FloatArray) -> FloatArray:
        """Heights (n,) [m] of the cells of the places (n, 2) [m]."""
        heights: FloatArray = self.elevation_m[self.grid.cells_of(places_m)]
        return heights

    def window(self, rows: slice, columns: slice) -> TerrainCost:
        """The cost over a part of the cells, in a frame whose origin is the part's south-west corner."""
        rate = np.ascontiguousarray(self.rate[rows, columns])
        grid = SiteGrid(rate.shape[0], rate.shape[1], self.grid.resolution_m)
        return TerrainCost(grid, rate, self.elevation_m[rows, columns], self.slope_deg[rows, columns], self.climb)

    def leg_cost(self) -> LegCost:
        """The symmetric cost of one leg, for planners that ask tens of thousands of times per second."""
        return _scalar_cost(self)

    def _parts(self, a: FloatArray, b: FloatArray) -> tuple[FloatArray, NDArray[np.intp], NDArray[np.intp]]:
        """Shares (n, m) of each leg in the cells that it crosses in their order, and their rows and columns.

        Legs that cross fewer than m cells end with parts of share 0 in their last one.
        """
        size = self.grid.resolution_m
        p, d = a / size, (b - a) / size
        fractions, count = [], np.zeros(len(a), dtype=np.intp)
        for axis in (0, 1):
            low, high = np.minimum(p[:, axis], p[:, axis] + d[:, axis]), np.maximum(p[:, axis], p[:, axis] + d[:, axis])
            first = np.floor(low) + 1.0
            lines = np.maximum(np.ceil(high) - first, 0.0).astype(np.intp)
            number = np.arange(int(lines.max(initial=0)))
            step = np.where(d[:, axis] == 0.0, 1.0, d[:, axis])
            at = (first[:, None] + number - p[:, axis, None]) / step[:, None]
            fractions.append(np.where(number < lines[:, None], at, 1.0))
            count += lines
        ends = np.sort(np.column_stack((*fractions, np.ones(len(a)))), axis=1)
        begins = np.column_stack((np.zeros(len(a)), ends[:, :-1]))
        middle = 0.5 * (begins + ends)
        beyond = np.arange(middle.shape[1]) > count[:, None]
        middle = np.where(beyond, np.take_along_axis(middle, count[:, None], axis=1), middle)
        columns = np.clip((p[:, :1] + middle * d[:, :1]).astype(np.intp), 0, self.grid.columns - 1)
        rows = np.clip((p[:, 1:] + middle * d[:, 1:]).astype(np.intp), 0, self.grid.rows - 1)
        return ends - begins, rows, columns


@dataclass(frozen=True, slots=True, eq=False)
class CostUnit:
    """What a mission's legs cost: the kind, and what a level metre takes of it."""

    kind: CostKind
    per_level_metre: float
    """Metres, hours or watt hours."""

    @property
    def unit(self) -> UnitName:
        """m, h or Wh."""
        return UNITS[self.kind]

    def of(self, figures: DriveFigures) -> float:
        """The cost of a drive with those figures, in the unit."""
        if self.kind == "distance":
            return figures.length_m
        return figures.duration_s / _S_PER_H if self.kind == "time" else figures.energy_j / J_PER_WH


def cost_unit(kind: CostKind, ground: DrivenGround) -> CostUnit:
    """The unit of that kind of cost; raises InvalidInput if a level metre takes no energy."""
    model = ground.model
    level_j = model.base_load_w / model.speed_m_s + model.traction_j_per_m
    if kind == "energy" and not level_j > 0.0:
        raise InvalidInput("cost 'energy': expected a rover that draws energy on level ground, got one that draws none")
    per_metre: dict[CostKind, float] = {
        "distance": 1.0,
        "time": 1.0 / model.speed_m_s / _S_PER_H,
        "energy": level_j / J_PER_WH,
    }
    return CostUnit(kind, per_metre[kind])


def terrain_cost(kind: CostKind, ground: DrivenGround) -> TerrainCost | None:
    """The cost of legs over that ground; None for ``distance``, which needs no terrain."""
    if kind == "distance":
        return None
    model = ground.model
    slowdown = 1.0 + model.slope_slowdown * ground.slope_deg / model.slope_limit_deg
    if kind == "time":
        return TerrainCost(ground.grid, slowdown, ground.elevation_m, ground.slope_deg, 0.0)
    level_j = cost_unit(kind, ground).per_level_metre * J_PER_WH
    rate = (model.base_load_w / model.speed_m_s * slowdown + model.traction_j_per_m) / level_j
    return TerrainCost(ground.grid, rate, ground.elevation_m, ground.slope_deg, model.climb_j_per_m / level_j)


def _scalar_cost(cost: TerrainCost) -> LegCost:
    scale, columns, rows = 1.0 / cost.grid.resolution_m, cost.grid.columns, cost.grid.rows
    rate, height = cost.rate.ravel().tolist(), cost.elevation_m.ravel().tolist()
    half_climb, size = 0.5 * cost.climb, cost.grid.resolution_m

    def leg(ax: float, ay: float, bx: float, by: float) -> float:
        x, y, dx, dy = ax * scale, ay * scale, (bx - ax) * scale, (by - ay) * scale
        column, row = min(int(x), columns - 1), min(int(y), rows - 1)
        to_column, to_row = min(int(bx * scale), columns - 1), min(int(by * scale), rows - 1)
        at = row * columns + column
        length = (dx * dx + dy * dy) ** 0.5
        crossings = abs(to_column - column) + abs(to_row - row)
        if not crossings:
            return float(rate[at] * length * size)
        if dx > 0.0:
            next_x, per_x, right = (column + 1 - x) / dx, 1.0 / dx, 1
        elif dx < 0.0:
            next_x, per_x, right = (column - x) / dx, -1.0 / dx, -1
        else:
            next_x, per_x, right = 2.0, 0.0, 0
        if dy > 0.0:
            next_y, per_y, up = (row + 1 - y) / dy, 1.0 / dy, columns
        elif dy < 0.0:
            next_y, per_y, up = (row - y) / dy, -1.0 / dy, -columns
        else:
            next_y, per_y, up = 2.0, 0.0, 0
        weighted = changes = begin = 0.0
        here = height[at]
        for _ in range(crossings):
            if next_x < next_y:
                weighted += (next_x - begin) * rate[at]
                begin = next_x
                next_x += per_x
                at += right
            else:
                weighted += (next_y - begin) * rate[at]
                begin = next_y
                next_y += per_y
                at += up
            before, here = here, height[at]
            changes += here - before if here > before else before - here
        weighted += (1.0 - begin) * rate[at]
        return float(weighted * length * size + half_climb * changes)

    return leg

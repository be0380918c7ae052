"""What driving takes: the one model by which the rover drives, and by which the ground plans and predicts.

A path is driven cell by cell. In each cell the speed is

    v = speed / (1 + slope_slowdown * slope / slope_limit)

and from a cell to the next a rise of dh takes ``climb_j_per_m`` dh; a descent returns nothing. So rough ground takes
energy by its many small rises. Traction takes ``traction_j_per_m`` on every metre, and the base load is drawn all the
time. Slopes and heights are those of the cells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from he3.frames import FloatArray, Place, SiteGrid

J_PER_WH: Final = 3600.0  # J, exact
_SAME_PLACE_M: Final = 1e-9  # m; shorter segments are rounding, not driving


@dataclass(frozen=True, slots=True)
class DrivingModel:
    """The vehicle's parameters."""

    speed_m_s: float
    slope_slowdown: float
    slope_limit_deg: float
    traction_j_per_m: float
    climb_j_per_m: float
    base_load_w: float

    def slowdown(self, slope_deg: float) -> float:
        """Factor of the driving time on ground of that slope [deg]."""
        return 1 + self.slope_slowdown * slope_deg / self.slope_limit_deg

    def motion_j(self, length_m: float, climb_m: float) -> float:
        """Energy [J] for traction and climbing, without the base load."""
        return self.traction_j_per_m * length_m + self.climb_j_per_m * climb_m

    def drive(
        self, ends_m: Sequence[float], slopes_deg: Sequence[float], heights_m: Sequence[float], from_height_m: float
    ) -> Drive:
        """The drive over consecutive parts, each within one cell.

        ends_m: distance from the beginning to the end of each part. slopes_deg, heights_m: of its cell.
        from_height_m: of the cell that is driven over before.
        """
        elapsed = begin = climb = 0.0
        height = from_height_m
        ends_s = []
        for end, slope, its_height in zip(ends_m, slopes_deg, heights_m, strict=True):
            elapsed += (end - begin) / self.speed_m_s * self.slowdown(slope)
            climb += max(0.0, its_height - height)
            ends_s.append(elapsed)
            begin, height = end, its_height
        return Drive(tuple(ends_s), climb)


@dataclass(frozen=True, slots=True)
class Drive:
    """What a drive takes."""

    ends_s: tuple[float, ...]
    """Time from the beginning to the end of each part."""
    climb_m: float
    """Sum of all rises."""

    @property
    def duration_s(self) -> float:
        return self.ends_s[-1] if self.ends_s else 0.0


@dataclass(frozen=True, slots=True)
class DriveFigures:
    """The figures of a driven or planned path."""

    length_m: float = 0.0
    duration_s: float = 0.0
    """While it moves: neither charging nor waiting."""
    motion_j: float = 0.0
    """Energy for traction and climbing."""
    base_j: float = 0.0
    """Energy of the base load meanwhile."""
    climb_m: float = 0.0
    steepest_deg: float = 0.0

    @property
    def energy_j(self) -> float:
        """All energy that is drawn while the rover drives [J]."""
        return self.motion_j + self.base_j

    def __add__(self, other: DriveFigures) -> DriveFigures:
        return DriveFigures(
            self.length_m + other.length_m,
            self.duration_s + other.duration_s,
            self.motion_j + other.motion_j,
            self.base_j + other.base_j,
            self.climb_m + other.climb_m,
            max(self.steepest_deg, other.steepest_deg),
        )


@dataclass(frozen=True, slots=True, eq=False)
class DrivenGround:
    """The cells that are driven over, and the vehicle that drives."""

    grid: SiteGrid
    slope_deg: FloatArray
    """(rows, columns) [deg]."""
    elevation_m: FloatArray
    """(rows, columns) [m]."""
    model: DrivingModel

    def figures(self, path_m: Sequence[Place]) -> DriveFigures:
        """What driving along the polyline [m], which lies on the site, takes."""
        size, last_row, last_column = self.grid.resolution_m, self.grid.rows - 1, self.grid.columns - 1
        ends: list[float] = []
        slopes: list[float] = []
        heights: list[float] = []
        driven = 0.0
        for (ax, ay), (bx, by) in pairwise(path_m):
            dx, dy = bx - ax, by - ay
            length = math.hypot(dx, dy)
            if length <= _SAME_PLACE_M:
                continue
            fractions = cell_crossings(ax, ay, dx, dy, size)
            ends += [driven + fraction * length for fraction in fractions]
            for x, y in midpoints(ax, ay, dx, dy, fractions):
                row, column = min(max(int(y / size), 0), last_row), min(max(int(x / size), 0), last_column)
                slopes.append(float(self.slope_deg[row, column]))
                heights.append(float(self.elevation_m[row, column]))
            driven += length
        if not ends:
            return DriveFigures()
        drive = self.model.drive(ends, slopes, heights, heights[0])
        return DriveFigures(
            driven,
            drive.duration_s,
            self.model.motion_j(driven, drive.climb_m),
            self.model.base_load_w * drive.duration_s,
            drive.climb_m,
            max(slopes),
        )


def cell_crossings(x: float, y: float, dx: float, dy: float, cell_m: float) -> list[float]:
    """Fractions of a segment at which it leaves a cell, ascending, its end (1) included."""
    fractions = [1.0]
    for origin, step in ((x, dx), (y, dy)):
        if step:
            low, high = sorted((origin, origin + step))
            lines = range(math.floor(low / cell_m) + 1, math.ceil(high / cell_m))
            fractions += [(line * cell_m - origin) / step for line in lines]
    fractions.sort()
    return fractions


def midpoints(x: float, y: float, dx: float, dy: float, fractions: list[float]) -> list[Place]:
    """The middle of each part of a segment between two of those fractions of it."""
    middles = [(begin + end) / 2 for begin, end in zip([0.0, *fractions], fractions, strict=False)]
    return [(x + middle * dx, y + middle * dy) for middle in middles]

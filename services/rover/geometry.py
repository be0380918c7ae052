"""Plane geometry: segments, polygons, and the distances between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from he3.frames import Place

_ENTRY_TOLERANCE_M: Final = 0.01  # m; how exactly the place is found where a path comes too near to an area


def inside(polygon_m: Sequence[Place], place_m: Place) -> bool:
    """Whether the place lies in the polygon, by the even-odd rule."""
    x, y = place_m
    within = False
    ax, ay = polygon_m[-1]
    for bx, by in polygon_m:
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            within = not within
        ax, ay = bx, by
    return within


@dataclass(frozen=True, slots=True)
class Area:
    """A polygon and its bounding box."""

    polygon_m: tuple[Place, ...]
    south_west_m: Place
    north_east_m: Place

    @classmethod
    def of(cls, polygon_m: Sequence[Place]) -> Area:
        """The area of a polygon of at least three corners."""
        xs, ys = [x for x, _ in polygon_m], [y for _, y in polygon_m]
        return cls(tuple(polygon_m), (min(xs), min(ys)), (max(xs), max(ys)))

    def is_near(self, a: Place, b: Place, margin_m: float) -> bool:
        """Whether the segment from a to b touches the area or comes nearer to it than the margin [m]."""
        (west, south), (east, north) = self.south_west_m, self.north_east_m
        if (
            max(a[0], b[0]) < west - margin_m
            or min(a[0], b[0]) > east + margin_m
            or max(a[1], b[1]) < south - margin_m
            or min(a[1], b[1]) > north + margin_m
        ):
            return False
        if inside(self.polygon_m, a) or inside(self.polygon_m, b):
            return True
        c = self.polygon_m[-1]
        for d in self.polygon_m:
            if _cross(a, b, c, d) or _squared_gap(a, b, c, d) < margin_m * margin_m:
                return True
            c = d
        return False

    def first_near(self, path_m: Sequence[Place], margin_m: float) -> Place | None:
        """Where a path first comes nearer to the area than the margin [m], to a centimetre; None if it keeps clear."""
        for a, b in pairwise(path_m):
            if self.is_near(a, b, margin_m):
                clear, near = (
                    0.0,
                    1.0,
                )  # fractions of the segment: it is clear up to the first, and not up to the second
                while (near - clear) * math.dist(a, b) > _ENTRY_TOLERANCE_M:
                    half = (clear + near) / 2
                    if self.is_near(a, _interpolate(a, b, half), margin_m):
                        near = half
                    else:
                        clear = half
                return _interpolate(a, b, near)
        return None


def _interpolate(a: Place, b: Place, fraction: float) -> Place:
    return a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1])


def _cross(a: Place, b: Place, c: Place, d: Place) -> bool:
    """Whether the segments ab and cd have a point in common, other than by lying along one line."""
    return (_side(a, b, c) * _side(a, b, d) <= 0) and (_side(c, d, a) * _side(c, d, b) < 0)


def _side(a: Place, b: Place, p: Place) -> float:
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _squared_gap(a: Place, b: Place, c: Place, d: Place) -> float:
    """Squared distance [m^2] of two segments that do not cross; it is attained at one of their four ends."""
    return min(
        squared_distance(a, c, d), squared_distance(b, c, d), squared_distance(c, a, b), squared_distance(d, a, b)
    )


def squared_distance(p: Place, a: Place, b: Place) -> float:
    """Squared distance [m^2] of a place from the segment ab."""
    x, y = _interpolate(a, b, nearest_fraction(p, a, b))
    return (x - p[0]) ** 2 + (y - p[1]) ** 2


def nearest_fraction(p: Place, a: Place, b: Place) -> float:
    """Fraction of the segment from a (0) to b (1) at which it is nearest to the place."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    squared = dx * dx + dy * dy
    if squared == 0:
        return 0.0
    return min(1.0, max(0.0, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / squared))

"""Scanning the path: cut off the next section, and choose the places at which its terrain is asked for.

A scan covers every cell that the vehicle would pass over: places on lines along the section no further apart than a
cell, and on rings around each place where it turns or stops.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from he3.driving import cell_crossings, midpoints
from he3.errors import InvalidInput

if TYPE_CHECKING:
    from he3.frames import Place, SiteGrid
    from schemas.measurement import TerrainReply
    from services.mission.scenario import RoverConfig

_LINE_PLACES: Final = 320  # of the 512 places of one terrain query, for the lines along a section
_TURN_PLACES: Final = 176  # of the 512, for the rings at turns and what each turn adds to the lines
_MAX_TURNS: Final = 64  # turns in a section, for a vehicle without width
_DIRECTIONS: Final = 16  # places on a ring
_SAME_PLACE_M: Final = 1e-9  # m; shorter segments are rounding, not driving


@dataclass(frozen=True, slots=True)
class PathSection:
    """The next part of a path: a polyline from where the rover stands, and how many vertices it reaches."""

    points_m: tuple[Place, ...]
    vertices: int
    length_m: float


@dataclass(frozen=True, slots=True)
class ScanPattern:
    """The places to scan before a section is driven: those on its centre line first, then side lines and rings.

    Each place on a line is the middle of the line's part in one cell.
    """

    points_m: tuple[Place, ...]
    centre_count: int
    """Number of places on the centre line."""
    first_side_lines: tuple[tuple[int, int], ...]
    """Index ranges of the places on the lines that begin at the vehicle's sides, where it stands."""
    ends_m: tuple[float, ...]
    """Distance [m] from the section's beginning to the end of each part of the centre line."""


@dataclass(frozen=True, slots=True)
class ScanPlanner:
    """Cuts a path into sections that one terrain query can scan over the vehicle's whole width."""

    offsets_m: tuple[float, ...]
    """Offsets of the side lines from the centre line, positive to the left [m]."""
    ring_m: tuple[Place, ...]
    """Places around a turn, relative to it [m]."""
    site: SiteGrid
    max_length_m: float
    """Longest section [m]."""
    max_vertices: int
    """Most vertices of a section."""

    def next_section(self, place_m: Place, path_m: Sequence[Place], first: int) -> PathSection:
        """The section from the place [m] along the path's vertices from number `first` on."""
        points, used, left = [place_m], 0, self.max_length_m
        x, y = place_m
        for vertex in path_m[first : first + self.max_vertices]:
            step = math.hypot(vertex[0] - x, vertex[1] - y)
            if step > left:
                if left > _SAME_PLACE_M:
                    points.append((x + (vertex[0] - x) * left / step, y + (vertex[1] - y) * left / step))
                    left = 0.0
                break
            used += 1
            if step > _SAME_PLACE_M:
                points.append(vertex)
                x, y = vertex
                left -= step
        return PathSection(tuple(points), used, self.max_length_m - left)

    def pattern(self, section: PathSection) -> ScanPattern:
        """The places to scan before that section is driven."""
        centre: list[Place] = []
        around: list[Place] = []
        side_lines: list[tuple[int, int]] = []
        ends: list[float] = []
        driven = 0.0
        for (ax, ay), (bx, by) in pairwise(section.points_m):
            dx, dy = bx - ax, by - ay
            length = math.hypot(dx, dy)
            fractions = cell_crossings(ax, ay, dx, dy, self.site.resolution_m)
            centre += midpoints(ax, ay, dx, dy, fractions)
            ends += [driven + fraction * length for fraction in fractions]
            for offset in self.offsets_m:
                px, py = ax - dy / length * offset, ay + dx / length * offset
                fractions = cell_crossings(px, py, dx, dy, self.site.resolution_m)
                begin = len(around)
                around += self._on_site(midpoints(px, py, dx, dy, fractions))
                if not driven:
                    side_lines.append((begin, len(around)))
            around += self._on_site([(bx + rx, by + ry) for rx, ry in self.ring_m])
            driven += length
        count = len(centre)
        first_side_lines = tuple((count + i, count + j) for i, j in side_lines)
        return ScanPattern((*centre, *around), count, first_side_lines, tuple(ends))

    def _on_site(self, places_m: list[Place]) -> list[Place]:
        """The places that lie on the site, because terrain beyond its edge is unknown."""
        width, height = self.site.width_m, self.site.height_m
        return [place for place in places_m if 0 <= place[0] <= width and 0 <= place[1] <= height]


def scan_planner(config: RoverConfig, site: SiteGrid) -> ScanPlanner:
    """The scan planner for that vehicle on that site; raises InvalidInput if one query cannot cover its width."""
    cell_m = site.resolution_m
    radius = config.footprint_radius_m
    lines = math.ceil(radius / cell_m) if radius > 0 else 0
    places_a_turn = (_DIRECTIONS + 2) * lines + 1
    if places_a_turn > _TURN_PLACES:
        most = (_TURN_PLACES - 1) // (_DIRECTIONS + 2)
        raise InvalidInput(
            f"rover: expected footprint_radius_m of at most {most} cells of {cell_m:g} m, got {radius:g} m"
        )
    radii = [radius * (k + 1) / lines for k in range(lines)]
    angles = [2 * math.pi * k / _DIRECTIONS for k in range(_DIRECTIONS)]
    cells = (_LINE_PLACES / (2 * lines + 1) - 3) / math.sqrt(2)  # a line n cells long meets at most sqrt(2) n + 2 cells
    return ScanPlanner(
        offsets_m=tuple(sign * r for r in radii for sign in (1, -1)),
        ring_m=tuple((r * math.cos(a), r * math.sin(a)) for r in radii for a in angles),
        site=site,
        # A piece shorter than a cell would show nothing new.
        max_length_m=min(max(config.look_ahead_m, cell_m), max(cells, 1.0) * cell_m),
        max_vertices=_TURN_PLACES // places_a_turn if lines else _MAX_TURNS,
    )


def obstacles(
    pattern: ScanPattern, terrain: TerrainReply, config: RoverConfig, cell_m: float, place_m: Place
) -> list[Place]:
    """The scanned places that the rover may not drive over; empty when the section is clear.

    Bad terrain that the rover stands on already does not stop it. Left out are bad places under the vehicle, and on
    each line those before the first good place; on a side line, only up to one cell beyond the footprint.
    """
    limit = config.slope_limit_deg
    bad = [not open_ or slope > limit for open_, slope in zip(terrain.traversable, terrain.slope_deg, strict=True)]
    if True not in bad:
        return []
    reach = config.footprint_radius_m + math.sqrt(2) * cell_m
    side_lines = [(begin, end, reach) for begin, end in pattern.first_side_lines]
    for begin, end, furthest in ((0, pattern.centre_count, math.inf), *side_lines):
        for index in range(begin, end):
            if not bad[index] or math.dist(pattern.points_m[index], place_m) > furthest:
                break
            bad[index] = False
    under = config.footprint_radius_m * (1 + 1e-9)
    return [
        place
        for index, (place, is_bad) in enumerate(zip(pattern.points_m, bad, strict=True))
        if is_bad and (index < pattern.centre_count or math.dist(place, place_m) > under)
    ]

"""A way, driven in pieces: cut one off, look at all of the ground it would cover, drive it at the pace of its slopes.

A look covers every cell that the vehicle would pass over: lines along the piece no further apart than a cell, and rings
around each place where it turns or stops.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from he3.errors import InvalidInput
from he3.frames import Place, SiteGrid
from schemas.measurement import TerrainReply
from services.mission.scenario import RoverConfig
from services.runtime.node import SECOND, MissionTime

_LINE_PLACES: Final = 320  # of the 512 places of one question, for the lines along a piece
_TURN_PLACES: Final = 176  # and for the rings where it turns, and what each turn adds to the lines
_MAX_TURNS: Final = 64  # of a piece, for a vehicle without width
_DIRECTIONS: Final = 16
_SAME_PLACE_M: Final = 1e-9  # shorter legs are rounding, not driving


@dataclass(frozen=True, slots=True)
class Piece:
    """A stretch of way: its polyline, from where the rover stands, and how many vertices of the way it uses up."""

    points_m: tuple[Place, ...]
    vertices: int
    length_m: float


@dataclass(frozen=True, slots=True)
class Look:
    """What must be looked at before a piece is driven: `middle` stretches on its line first, then sides and rings."""

    points_m: tuple[Place, ...]
    middle: int
    beside: tuple[tuple[int, int], ...]
    """Where among the places those of each line begin and end that starts at the vehicle's side, as it stands."""
    ends_m: tuple[float, ...]
    """Way [m] from the piece's beginning to the end of each middle stretch."""


@dataclass(frozen=True, slots=True)
class Corridor:
    """What the vehicle covers as it drives, and how much of it one look can take in."""

    offsets_m: tuple[float, ...]
    """Of the lines beside the middle one, to the left [m]."""
    ring_m: tuple[Place, ...]
    """Places around a turn, relative to it [m]."""
    site: SiteGrid
    length_m: float
    """Longest piece [m]."""
    turns: int
    """Most vertices of a piece."""

    def cut(self, place_m: Place, ahead_m: Sequence[Place], first: int) -> Piece:
        """The next piece of a way that leads from the place to its vertices from number `first` on."""
        points, used, left = [place_m], 0, self.length_m
        x, y = place_m
        for vertex in ahead_m[first : first + self.turns]:
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
        return Piece(tuple(points), used, self.length_m - left)

    def look(self, piece: Piece) -> Look:
        """The places to look at before that piece is driven: the middle of each stretch of a line in one cell."""
        middle: list[Place] = []
        around: list[Place] = []
        beside: list[tuple[int, int]] = []
        ends: list[float] = []
        driven = 0.0
        for (ax, ay), (bx, by) in pairwise(piece.points_m):
            dx, dy = bx - ax, by - ay
            length = math.hypot(dx, dy)
            shares = _crossings(ax, ay, dx, dy, self.site.resolution_m)
            middle += _middles(ax, ay, dx, dy, shares)
            ends += [driven + share * length for share in shares]
            for offset in self.offsets_m:
                px, py = ax - dy / length * offset, ay + dx / length * offset
                shares = _crossings(px, py, dx, dy, self.site.resolution_m)
                begin = len(around)
                around += self._within(_middles(px, py, dx, dy, shares))
                if not driven:
                    beside.append((begin, len(around)))
            around += self._within([(bx + rx, by + ry) for rx, ry in self.ring_m])
            driven += length
        count = len(middle)
        return Look((*middle, *around), count, tuple((count + i, count + j) for i, j in beside), tuple(ends))

    def _within(self, places_m: list[Place]) -> list[Place]:
        """Those of the places within the site: what sticks out over its edge meets nothing that anybody knows of."""
        width, height = self.site.width_m, self.site.height_m
        return [place for place in places_m if 0 <= place[0] <= width and 0 <= place[1] <= height]


def corridor(config: RoverConfig, site: SiteGrid) -> Corridor:
    """The corridor of that vehicle on that site; raises InvalidInput if one look could not take in its width."""
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
    cells = (_LINE_PLACES / (2 * lines + 1) - 3) / math.sqrt(2)  # a line of n cells' length meets at most sqrt(2) n + 2
    return Corridor(
        offsets_m=tuple(sign * r for r in radii for sign in (1, -1)),
        ring_m=tuple((r * math.cos(a), r * math.sin(a)) for r in radii for a in angles),
        site=site,
        length_m=min(config.look_ahead_m, max(cells, 1.0) * cell_m),
        turns=_TURN_PLACES // places_a_turn if lines else _MAX_TURNS,
    )


def _crossings(x: float, y: float, dx: float, dy: float, cell_m: float) -> list[float]:
    """Shares of a segment at which it leaves a cell, ascending, its end (1) included."""
    shares = [1.0]
    for origin, step in ((x, dx), (y, dy)):
        if step:
            low, high = sorted((origin, origin + step))
            lines = range(math.floor(low / cell_m) + 1, math.ceil(high / cell_m))
            shares += [(line * cell_m - origin) / step for line in lines]
    shares.sort()
    return shares


def _middles(x: float, y: float, dx: float, dy: float, shares: list[float]) -> list[Place]:
    """The middle of each stretch of a segment between two shares of it."""
    halves = [(begin + end) / 2 for begin, end in zip([0.0, *shares], shares, strict=False)]
    return [(x + half * dx, y + half * dy) for half in halves]


def forbidden(look: Look, seen: TerrainReply, config: RoverConfig, cell_m: float, place_m: Place) -> list[Place]:
    """Those of the places looked at that the rover may not cover; empty when the way is clear.

    Ground that it stands on already does not hold it there: bad places under the vehicle are left out, and on each
    line those from where it stands to the first good one, beside the middle line no further than a cell ahead.
    """
    limit = config.slope_limit_deg
    bad = [not open_ or slope > limit for open_, slope in zip(seen.traversable, seen.slope_deg, strict=True)]
    if True not in bad:
        return []
    reach = config.footprint_radius_m + math.sqrt(2) * cell_m
    for begin, end, furthest in ((0, look.middle, math.inf), *((i, j, reach) for i, j in look.beside)):
        for index in range(begin, end):
            if not bad[index] or math.dist(look.points_m[index], place_m) > furthest:
                break
            bad[index] = False
    under = config.footprint_radius_m * (1 + 1e-9)
    return [
        place
        for index, (place, is_bad) in enumerate(zip(look.points_m, bad, strict=True))
        if is_bad and (index < look.middle or math.dist(place, place_m) > under)
    ]


@dataclass(frozen=True, slots=True)
class Drive:
    """A piece under way: where the rover is at any time of it, and the power it takes."""

    piece: Piece
    began: MissionTime
    ends_m: tuple[float, ...]
    ends_s: tuple[float, ...]
    load_w: float

    @property
    def duration_s(self) -> float:
        return self.ends_s[-1]

    def driven_m(self, now: MissionTime) -> float:
        """Way [m] driven of the piece at that time; within a stretch of one slope the speed is constant."""
        elapsed = (now - self.began) / SECOND
        if elapsed >= self.ends_s[-1]:
            return self.piece.length_m
        index = bisect_right(self.ends_s, max(0.0, elapsed))
        t0, s0 = (self.ends_s[index - 1], self.ends_m[index - 1]) if index else (0.0, 0.0)
        return s0 + (self.ends_m[index] - s0) * (max(0.0, elapsed) - t0) / (self.ends_s[index] - t0)

    def place_m(self, now: MissionTime) -> tuple[Place, float]:
        """Place (x, y) [m] and heading [deg clockwise from north] at that time."""
        left = self.driven_m(now)
        a, b = self.piece.points_m[:2]
        for a, b in pairwise(self.piece.points_m):
            step = math.dist(a, b)
            if left <= step:
                break
            left -= step
        else:
            left = math.dist(a, b)
        share = left / math.dist(a, b)
        return (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])), heading_deg(a, b)


def drive(piece: Piece, look: Look, seen: TerrainReply, config: RoverConfig, now: MissionTime) -> Drive:
    """The piece as it will be driven: slower on slopes, with more power where it climbs."""
    elapsed = begin = climb = 0.0
    ends_s = []
    height = seen.elevation_m[0]
    for index, end in enumerate(look.ends_m):
        slowdown = 1 + config.slope_slowdown * seen.slope_deg[index] / config.slope_limit_deg
        elapsed += (end - begin) / config.speed_m_s * slowdown
        climb += max(0.0, seen.elevation_m[index] - height)
        ends_s.append(elapsed)
        begin, height = end, seen.elevation_m[index]
    energy_j = config.traction_j_per_m * piece.length_m + config.climb_j_per_m * climb
    return Drive(piece, now, look.ends_m, tuple(ends_s), energy_j / elapsed)


def heading_deg(a: Place, b: Place) -> float:
    """Direction from a to b [deg clockwise from north], at least 0 and below 360."""
    heading = math.degrees(math.atan2(b[0] - a[0], b[1] - a[1])) % 360
    return heading if heading < 360 else 0.0

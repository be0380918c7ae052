"""One drive: a path section driven at the speed that its slopes allow."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from services.mission.mission_time import SECOND, MissionTime, seconds

if TYPE_CHECKING:
    from he3.frames import Place
    from schemas.measurement import TerrainReply
    from services.mission.scenario import RoverConfig
    from services.rover.path_scan import PathSection, ScanPattern


@dataclass(frozen=True, slots=True)
class Drive:
    """A section being driven: where the rover is at any time, and the power that it draws beside the base load."""

    section: PathSection
    began_at: MissionTime
    ends_m: tuple[float, ...]
    """Distance [m] from the beginning to the end of each part of the section, one part a cell."""
    ends_s: tuple[float, ...]
    """Time [s] from the beginning to the end of each part."""
    load_w: float

    @property
    def duration_s(self) -> float:
        return self.ends_s[-1]

    @property
    def ends_at(self) -> MissionTime:
        return self.began_at + seconds(self.duration_s)

    def driven_m(self, now: MissionTime) -> float:
        """Distance [m] driven of the section at that time; the speed is constant within each part."""
        elapsed = (now - self.began_at) / SECOND
        if elapsed >= self.ends_s[-1]:
            return self.section.length_m
        index = bisect_right(self.ends_s, max(0.0, elapsed))
        t0, s0 = (self.ends_s[index - 1], self.ends_m[index - 1]) if index else (0.0, 0.0)
        return s0 + (self.ends_m[index] - s0) * (max(0.0, elapsed) - t0) / (self.ends_s[index] - t0)

    def place_m(self, now: MissionTime) -> tuple[Place, float]:
        """Place (x, y) [m] and heading [deg clockwise from north] at that time."""
        left = self.driven_m(now)
        a, b = self.section.points_m[:2]
        for a, b in pairwise(self.section.points_m):
            step = math.dist(a, b)
            if left <= step:
                break
            left -= step
        else:
            left = math.dist(a, b)
        fraction = left / math.dist(a, b)
        return (a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1])), heading_deg(a, b)


def drive_over(
    section: PathSection, pattern: ScanPattern, terrain: TerrainReply, config: RoverConfig, now: MissionTime
) -> Drive:
    """The drive over that section from now on: slower on slopes, with more power where it climbs."""
    reached = len(pattern.ends_m)
    heights = terrain.elevation_m[:reached]
    drive = config.driving.drive(pattern.ends_m, terrain.slope_deg[:reached], heights, heights[0])
    motion_j = config.driving.motion_j(section.length_m, drive.climb_m)
    return Drive(section, now, pattern.ends_m, drive.ends_s, motion_j / drive.duration_s)


def heading_deg(a: Place, b: Place) -> float:
    """Direction from a to b [deg clockwise from north], at least 0 and below 360."""
    heading = math.degrees(math.atan2(b[0] - a[0], b[1] - a[1])) % 360
    return heading if heading < 360 else 0.0

"""A drive: its duration, its energy, and where the rover is during it."""

from __future__ import annotations

import math

import pytest

from he3.frames import SiteGrid
from schemas.measurement import TerrainReply
from services.mission.mission_time import seconds
from services.mission.scenario import RoverConfig
from services.rover.drive import drive_over, heading_deg
from services.rover.path_scan import scan_planner

SITE = SiteGrid(100, 100)


def terrain(points, closed=lambda x, y: False, slope=lambda x, y: 0.0, height=lambda x, y: 0.0) -> TerrainReply:
    return TerrainReply(
        elevation_m=tuple(height(x, y) for x, y in points),
        slope_deg=tuple(slope(x, y) for x, y in points),
        traversable=tuple(not closed(x, y) for x, y in points),
    )


CONFIG = RoverConfig()


def scan_from(a: tuple[float, float], b: tuple[float, float]):
    planner = scan_planner(CONFIG, SITE)
    section = planner.next_section(a, [b], 0)
    return section, planner.pattern(section)


def test_a_drive_on_level_terrain_takes_its_length_divided_by_the_speed():
    section, pattern = scan_from((5.0, 5.5), (15.0, 5.5))
    driving = drive_over(section, pattern, terrain(pattern.points_m), CONFIG, 0)
    assert driving.duration_s == pytest.approx(100.0)
    assert driving.load_w * driving.duration_s == pytest.approx(2400.0)


def test_a_slope_slows_the_rover_down():
    section, pattern = scan_from((5.0, 5.5), (15.0, 5.5))
    half_steep = terrain(pattern.points_m, slope=lambda x, y: 20.0 if x > 10 else 0.0)
    driving = drive_over(section, pattern, half_steep, CONFIG, 0)
    assert driving.duration_s == pytest.approx(50.0 + 100.0)
    assert driving.driven_m(seconds(50)) == pytest.approx(5.0)
    assert driving.driven_m(seconds(100)) == pytest.approx(7.5)
    assert driving.place_m(seconds(100))[0] == pytest.approx((12.5, 5.5))


def test_climbing_takes_more_energy_and_descending_returns_none():
    section, pattern = scan_from((5.0, 5.5), (15.0, 5.5))
    ramp = terrain(pattern.points_m, height=lambda x, y: math.floor(x) * 0.1)
    up = drive_over(section, pattern, ramp, CONFIG, 0)
    assert up.load_w * up.duration_s == pytest.approx(2400.0 + 700.0 * 0.9)
    descent = terrain(pattern.points_m, height=lambda x, y: -math.floor(x) * 0.1)
    down = drive_over(section, pattern, descent, CONFIG, 0)
    assert down.load_w * down.duration_s == pytest.approx(2400.0)


@pytest.mark.parametrize(
    ("to", "heading"), [((0, 1), 0.0), ((1, 0), 90.0), ((0, -1), 180.0), ((-1, 0), 270.0), ((-1e-300, 1), 0.0)]
)
def test_heading_is_clockwise_from_north(to, heading):
    assert heading_deg((0.0, 0.0), to) == heading

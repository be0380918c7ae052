"""Path sections and scans: how a path is cut up, which places are scanned, and what is an obstacle."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from schemas.measurement import TerrainReply
from services.mission.scenario import RoverConfig
from services.rover.path_scan import PathSection, ScanPlanner, obstacles, scan_planner

SITE = SiteGrid(100, 100)
coordinates = st.floats(1, 99)
places = st.tuples(coordinates, coordinates)


def planner_for(radius: float = 0.8, look_ahead: float = 10.0, site: SiteGrid = SITE) -> ScanPlanner:
    return scan_planner(RoverConfig(footprint_radius_m=radius, look_ahead_m=look_ahead), site)


def sections(path: list[tuple[float, float]], planner: ScanPlanner) -> list[PathSection]:
    found, place, vertex = [], path[0], 1
    while vertex < len(path):
        section = planner.next_section(place, path, vertex)
        assert section.vertices or section.length_m > 0
        place, vertex = section.points_m[-1], vertex + section.vertices
        found.append(section)
    return found


@given(st.lists(places, min_size=2, max_size=12), st.floats(0.5, 30))
def test_the_sections_of_a_path_make_up_the_path(path, look_ahead):
    cut = sections(path, planner_for(look_ahead=look_ahead))
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(path))
    assert sum(section.length_m for section in cut) == pytest.approx(length, abs=1e-6)
    assert all(section.length_m <= max(look_ahead, SITE.resolution_m) + 1e-9 for section in cut)
    for before, behind in itertools.pairwise(cut):
        assert before.points_m[-1] == behind.points_m[0]
    assert cut[-1].points_m[-1] == pytest.approx(path[-1], abs=1e-8)
    driven = [point for section in cut for point in section.points_m]
    assert all(any(math.dist(vertex, point) < 1e-8 for point in driven) for vertex in path)


@given(
    st.lists(places, min_size=2, max_size=40),
    st.floats(0, 0.9),
    st.floats(0.5, 500),
    st.sampled_from([0.1, 0.5, 1.0, 2.0, 5.0]),
)
def test_a_scan_fits_one_query_for_any_path_vehicle_and_cells(path, radius, look_ahead, resolution):
    site = SiteGrid(round(100 / resolution), round(100 / resolution), resolution)
    planner = planner_for(radius, look_ahead, site)
    section = planner.next_section(path[0], path, 1)
    if section.length_m > 0:
        assert 1 <= len(planner.pattern(section).points_m) <= 512


def test_a_section_over_cells_larger_than_the_look_ahead_is_as_long_as_a_cell():
    coarse = planner_for(look_ahead=10.0, site=SiteGrid(50, 50, 214.0))
    cut = sections([(500.0, 500.0), (3710.0, 500.0)], coarse)
    assert [section.length_m for section in cut] == pytest.approx([214.0] * 15)


def test_a_vehicle_that_is_too_wide_for_one_query_is_refused():
    with pytest.raises(InvalidInput, match=r"at most 9 cells of 0.1 m, got 1 m"):
        planner_for(1.0, site=SiteGrid(100, 100, 0.1))


@given(places, places, st.floats(0.2, 1.0))
def test_a_scan_covers_every_cell_that_the_vehicle_would_cover(a, b, radius):
    planner = planner_for(radius, 50.0)
    section = planner.next_section(a, [a, b], 1)
    if section.length_m < 0.01:
        return
    seen = {(math.floor(x), math.floor(y)) for x, y in planner.pattern(section).points_m}
    end = section.points_m[-1]
    ux, uy = (end[0] - a[0]) / section.length_m, (end[1] - a[1]) / section.length_m
    inner = radius - 1e-6
    for along in np.linspace(0, section.length_m, 60):
        for beside in np.linspace(-inner, inner, 9):
            x, y = a[0] + ux * along - uy * beside, a[1] + uy * along + ux * beside
            if math.dist(a, (x, y)) <= radius:
                continue  # the rover stands there already
            if 0 <= x <= 100 and 0 <= y <= 100 and (x % 1) * (y % 1) > 1e-9:
                near_edge = min(x % 1, 1 - x % 1, y % 1, 1 - y % 1) < 1e-6
                assert near_edge or (math.floor(x), math.floor(y)) in seen


@given(places, places)
def test_the_centre_line_of_a_scan_is_as_long_as_the_section(a, b):
    planner = planner_for(0.8, 20.0)
    section = planner.next_section(a, [a, b], 1)
    if section.length_m == 0:
        return
    pattern = planner.pattern(section)
    assert list(pattern.ends_m) == sorted(pattern.ends_m)
    assert pattern.ends_m[-1] == pytest.approx(section.length_m, abs=1e-9)
    assert pattern.centre_count == len(pattern.ends_m)


def test_places_beyond_the_edge_of_the_site_are_not_scanned():
    planner = planner_for(0.8)
    pattern = planner.pattern(planner.next_section((0.2, 5.0), [(0.2, 15.0)], 0))
    assert all(0 <= x <= 100 for x, _ in pattern.points_m)
    assert any(x == pytest.approx(1.0) for x, _ in pattern.points_m)


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


def test_closed_terrain_ahead_is_an_obstacle():
    _, pattern = scan_from((5.0, 5.5), (15.0, 5.5))
    found = obstacles(
        pattern, terrain(pattern.points_m, lambda x, y: 10 <= x < 11 and 5 <= y < 6), CONFIG, 1.0, (5.0, 5.5)
    )
    assert found
    assert all(10 <= x < 11 for x, _ in found)


def test_closed_terrain_under_one_side_is_an_obstacle():
    _, pattern = scan_from((5.0, 5.5), (15.0, 5.5))
    assert obstacles(
        pattern, terrain(pattern.points_m, lambda x, y: 10 <= x < 11 and 6 <= y < 7), CONFIG, 1.0, (5.0, 5.5)
    )
    assert not obstacles(
        pattern, terrain(pattern.points_m, lambda x, y: 10 <= x < 11 and 7 <= y < 8), CONFIG, 1.0, (5.0, 5.5)
    )


def test_terrain_steeper_than_the_limit_is_an_obstacle_although_it_is_traversable():
    _, pattern = scan_from((5.0, 5.5), (15.0, 5.5))
    assert obstacles(
        pattern, terrain(pattern.points_m, slope=lambda x, y: 20.1 if x > 10 else 0.0), CONFIG, 1.0, (5.0, 5.5)
    )
    assert not obstacles(pattern, terrain(pattern.points_m, slope=lambda x, y: 20.0), CONFIG, 1.0, (5.0, 5.5))


def test_bad_terrain_under_the_rover_does_not_stop_it():
    _, pattern = scan_from((5.5, 5.5), (15.5, 5.5))
    assert not obstacles(pattern, terrain(pattern.points_m, lambda x, y: x < 6), CONFIG, 1.0, (5.5, 5.5))


def test_bad_terrain_beyond_the_first_good_place_is_an_obstacle_even_if_the_rover_stands_on_bad_terrain():
    _, pattern = scan_from((5.5, 5.5), (15.5, 5.5))
    found = obstacles(pattern, terrain(pattern.points_m, lambda x, y: x < 6 or 12 <= x < 13), CONFIG, 1.0, (5.5, 5.5))
    assert found
    assert all(x > 11 for x, _ in found)

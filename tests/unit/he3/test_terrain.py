"""Terrain against ground whose answer is known: planes, bowls, mounds."""

from __future__ import annotations

import numpy as np
import pytest

from he3.errors import InvalidInput, OutsideRegion
from he3.frames import SiteGrid
from he3.terrain import reachable, relief_m, slope_deg, traversable

N = 300
Y, X = np.meshgrid(np.arange(N) + 0.5, np.arange(N) + 0.5, indexing="ij")


def mound(cx: float, cy: float, height: float, radius: float) -> np.ndarray:
    return height * np.exp(-((X - cx) ** 2 + (Y - cy) ** 2) / (2 * radius**2))


def judge(elevation: np.ndarray, limit_deg: float = 15.0) -> np.ndarray:
    return traversable(slope_deg(elevation, 1.0), relief_m(elevation, 1.0), limit_deg)


def test_a_plane_has_its_slope_everywhere_whatever_the_cell_size() -> None:
    for resolution in (0.5, 1.0, 5.0):
        plane = (0.3 * X + 0.4 * Y) * resolution
        np.testing.assert_allclose(slope_deg(plane, resolution), np.degrees(np.arctan(0.5)), rtol=1e-6)


def test_a_plane_has_no_relief_even_at_its_edge() -> None:
    assert np.abs(relief_m(0.3 * X - 0.2 * Y + 2000.0, 1.0)).max() < 1e-9


def test_relief_over_a_parabola_is_its_second_moment() -> None:
    """Of z = x^2 the mean over a window of 2 h + 1 cells lies h (h + 1) / 3 above the middle."""
    relief = relief_m((X - 150.0) ** 2, 1.0, window_m=100.0)
    np.testing.assert_allclose(relief[60:-60, 60:-60], -50 * 51 / 3, rtol=1e-6)


def test_relief_against_a_direct_mean_of_rough_ground() -> None:
    ground = np.random.default_rng(1).standard_normal((40, 50)).cumsum(axis=0)
    relief = relief_m(ground, 5.0, window_m=50.0)
    for row, column in ((5, 5), (20, 30), (34, 44)):
        window = ground[row - 5 : row + 6, column - 5 : column + 6]
        assert relief[row, column] == pytest.approx(ground[row, column] - window.mean())


def test_relief_of_a_region_smaller_than_the_window_is_defined() -> None:
    assert np.isfinite(relief_m(np.random.default_rng(2).standard_normal((12, 30)), 1.0)).all()


def test_flat_ground_and_smooth_ramps_are_open() -> None:
    assert judge(np.full((N, N), -2600.0)).all()
    assert judge(0.2 * X).all()  # 11.3 deg


def test_a_ramp_over_the_limit_is_closed_and_the_limit_is_the_rovers() -> None:
    steep = 0.3 * X  # 16.7 deg
    assert not judge(steep).any()
    assert judge(steep, limit_deg=20.0).all()


def test_hollows_and_small_hummocks_are_closed() -> None:
    ground = mound(80, 80, -3.0, 12) + mound(220, 220, 3.0, 12)
    open_cells = judge(ground)
    assert not open_cells[80, 80]
    assert not open_cells[220, 220]
    assert open_cells[80, 220]
    assert open_cells.mean() > 0.9


def test_a_rise_that_covers_a_twentieth_of_the_region_is_landscape_but_a_hollow_of_that_size_is_not() -> None:
    broad = mound(150, 150, 3.0, 70)
    sigmas = relief_m(broad, 1.0) / relief_m(broad, 1.0).std()
    assert (sigmas > 1.5).mean() > 0.05
    assert judge(broad)[150, 150]
    assert not judge(-broad)[150, 150]


def test_smooth_even_ground_is_open_although_its_relief_has_a_standard_deviation() -> None:
    """A bowl of 500 m that is 1.5 m deep, as a resampled coarse raster has: 6 cm below the mean over 100 m."""
    bowl = 1.5 * (((X - 150.0) ** 2 + (Y - 150.0) ** 2) / 250.0**2)
    relief = relief_m(bowl, 1.0)
    assert -0.1 < relief.min() < -0.03
    assert traversable(slope_deg(bowl, 1.0), relief).all()
    assert not traversable(np.zeros(relief.shape), 10.0 * relief).all()


def test_the_threshold_is_one_and_a_half_standard_deviations_of_relief() -> None:
    relief = np.where((np.indices((100, 100)).sum(axis=0)) % 2 == 0, 0.5, -0.5)  # sets the scale: sigma is 0.5
    relief[20:24, 20:24], relief[20:24, 60:64] = -0.74, -0.77
    relief[70:74, 20:24], relief[70:74, 60:64] = 0.74, 0.77
    assert 0.74 < 1.5 * relief.std() < 0.77
    closed = ~traversable(np.zeros((100, 100)), relief)
    wanted = np.zeros((100, 100), dtype=bool)
    wanted[20:24, 60:64] = wanted[70:74, 60:64] = True
    assert np.array_equal(closed, wanted)


def test_cracks_between_obstacles_are_closed_up_to_two_cells() -> None:
    slope = np.zeros((40, 40))
    slope[10:20, 10:15] = slope[10:20, 17:22] = 30.0  # a gap of two cells between
    slope[25:35, 10:15] = slope[25:35, 18:23] = 30.0  # a gap of three
    open_cells = traversable(slope, np.zeros((40, 40)))
    assert not open_cells[15, 15:17].any()
    assert open_cells[30, 15:18].all()


def test_closing_does_not_open_or_close_the_regions_edge() -> None:
    slope = np.zeros((30, 30))
    slope[:, :2] = 30.0
    open_cells = traversable(slope, np.zeros((30, 30)))
    assert not open_cells[:, :2].any()
    assert open_cells[:, 2:].all()


def test_only_cells_that_share_edges_with_the_way_are_reachable() -> None:
    open_cells = np.zeros((6, 6), dtype=bool)
    open_cells[0:3, 0:3] = True
    open_cells[3, 3] = True  # touches by a corner alone
    grid = SiteGrid(6, 6)
    connected = reachable(open_cells, grid, (0.5, 0.5))
    assert connected.sum() == 9
    assert not connected[3, 3]
    assert not reachable(open_cells, grid, (5.5, 5.5)).any()
    with pytest.raises(OutsideRegion):
        reachable(open_cells, grid, (7.0, 0.5))


@pytest.mark.parametrize("bad", [np.zeros(4), np.zeros((1, 5)), np.full((4, 4), np.nan)])
def test_ground_that_is_no_map_is_refused(bad: np.ndarray) -> None:
    with pytest.raises(InvalidInput, match="elevation"):
        slope_deg(bad, 1.0)
    with pytest.raises(InvalidInput, match="elevation"):
        relief_m(bad, 1.0)


def test_a_window_narrower_than_two_cells_is_refused() -> None:
    with pytest.raises(InvalidInput, match="window"):
        relief_m(np.zeros((5, 5)), 100.0, window_m=100.0)

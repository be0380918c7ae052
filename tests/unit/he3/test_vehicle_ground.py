"""A vehicle's limits close scarps, boulders, rough and rocky ground, and leave even real ground open."""

from __future__ import annotations

import numpy as np
import pytest

from he3.errors import InvalidInput
from he3.frames import FloatArray
from he3.terrain import relief_m, slope_deg, traversable
from he3.vehicle_ground import VehicleLimits, judged, roughness_m, step_m

LIMITS = VehicleLimits()
Y, X = np.mgrid[:40, :50].astype(np.float64)
FLAT = np.zeros(X.shape)


def closed(elevation: FloatArray, resolution_m: float = 1.0, **more: FloatArray | float) -> FloatArray:
    return ~judged(elevation, resolution_m, LIMITS, **more).open_cells  # type: ignore[arg-type]


def test_planes_and_bowls_have_neither_steps_nor_roughness_of_their_own() -> None:
    for ground in (0.2 * X - 0.1 * Y + 1700.0, 0.002 * ((X - 20.0) ** 2 + (Y - 25.0) ** 2)):
        assert step_m(ground).max() < 0.005
        assert roughness_m(ground, 1.0, 2.0).max() < 0.005
        assert not closed(ground).any()


def test_a_scarp_has_its_height_and_is_closed_on_both_sides_alone() -> None:
    scarp = np.where(X >= 25, 0.4, 0.0) + 0.1 * Y
    assert step_m(scarp)[:, [24, 25]] == pytest.approx(np.full((40, 2), 0.4))
    shut = closed(scarp)
    assert shut[:, 24:26].all()
    assert not shut[:, :23].any()
    assert not shut[:, 27:].any()


def test_a_boulder_on_one_cell_has_its_own_height() -> None:
    ground = FLAT.copy()
    ground[20, 30] = 0.3
    assert step_m(ground).max() == pytest.approx(0.3)
    assert closed(ground)[20, 30]
    assert not closed(ground * (LIMITS.step_m / 0.31))[20, 30]


def test_roughness_is_the_deviation_from_the_best_plane() -> None:
    ground = np.random.default_rng(1).normal(0.0, 1.0, (12, 14)) + 3.0 * np.arange(14)
    window = ground[4:7, 6:9]
    plane = np.column_stack((np.ones(9), *(axis.ravel() for axis in np.mgrid[:3, :3])))
    residual = np.linalg.lstsq(plane, window.ravel(), rcond=None)[1][0]
    assert roughness_m(ground, 1.0, 2.0)[5, 7] == pytest.approx(float(np.sqrt(residual / 9)))
    assert roughness_m(ground, 0.5, 2.4)[5, 7] != roughness_m(ground, 1.0, 2.0)[5, 7]


def test_rocky_ground_is_closed_where_its_rocks_are_known() -> None:
    rocks = np.full(FLAT.shape, 0.004)
    rocks[3, 4], rocks[5, 6], rocks[7, 8] = 0.2, np.nan, LIMITS.rock_abundance
    shut = closed(FLAT, rock_abundance=rocks)
    assert np.argwhere(shut).tolist() == [[3, 4]]


def test_even_ground_that_the_relief_rule_closes_is_open() -> None:
    ground = 0.3 * np.sin(X / 8.0) * np.cos(Y / 7.0)
    assert not traversable(slope_deg(ground, 1.0), relief_m(ground, 1.0)).all()
    assert not closed(ground).any()


def test_cells_or_pixels_larger_than_the_vehicle_are_judged_by_slope_alone_and_say_so() -> None:
    rough = np.random.default_rng(2).normal(0.0, 0.3, FLAT.shape)
    assert closed(rough, 1.0).mean() > 0.5
    for found in (judged(rough, 5.0, LIMITS), judged(rough, 1.0, VehicleLimits(90.0), pixel_m=5.0)):
        assert "5 m show neither steps nor roughness" in found.rule
        assert found.open_cells.mean() > 0.9


def test_the_rule_says_what_share_each_limit_closes_of_the_site_within_the_margin() -> None:
    ground = FLAT.copy()
    ground[:, :10] = 5.0 * X[:, :10]
    found = judged(ground, 1.0, LIMITS, margin=5)
    assert found.open_cells.shape == (30, 40)
    share = float((slope_deg(ground, 1.0) > LIMITS.slope_deg)[5:-5, 5:-5].mean())
    assert f"slope of at most 15 deg ({share:.1%} closed), steps of at most 0.25 m" in found.rule


def test_layers_of_another_shape_are_refused() -> None:
    with pytest.raises(InvalidInput, match="expected rock abundance of shape"):
        judged(FLAT, 1.0, LIMITS, rock_abundance=np.zeros((3, 3)))


def test_a_single_row_of_cells_is_refused() -> None:
    row = np.zeros((1, 5))
    with pytest.raises(InvalidInput, match=r"at least 2 x 2 cells, got shape \(1, 5\)"):
        judged(row, 1.0, LIMITS, slope=row)

"""What driving takes: one model for paths, for many legs at once, and for one leg at a time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from he3.driving import DrivenGround, DrivingModel
from he3.driving_cost import cost_unit, terrain_cost
from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.terrain import slope_deg

MODEL = DrivingModel(
    speed_m_s=0.1,
    slope_slowdown=1.0,
    slope_limit_deg=20.0,
    traction_j_per_m=240.0,
    climb_j_per_m=700.0,
    base_load_w=150.0,
)


def hills(seed: int = 0, grid: SiteGrid | None = None, model: DrivingModel = MODEL) -> DrivenGround:
    grid = grid or SiteGrid(60, 80, 5.0)
    noise = np.random.default_rng(seed).normal(size=grid.shape)
    heights = ndimage.gaussian_filter(noise, 3) * 40.0
    return DrivenGround(grid, slope_deg(heights, grid.resolution_m), heights, model)


def places(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0.0, 0.0), (400.0, 300.0), (count, 2))


def test_a_ramp_takes_the_time_and_the_energy_of_its_slope_and_height() -> None:
    grid = SiteGrid(4, 40, 1.0)
    heights = np.tile(np.arange(40) * np.tan(np.radians(10.0)), (4, 1))
    ground = DrivenGround(grid, np.full(grid.shape, 10.0), heights, MODEL)
    up = ground.figures([(5.5, 2.5), (25.5, 2.5)])
    assert up.length_m == pytest.approx(20.0)
    assert up.duration_s == pytest.approx(20.0 / 0.1 * 1.5)
    assert up.climb_m == pytest.approx(20.0 * np.tan(np.radians(10.0)))
    assert up.energy_j == pytest.approx(240.0 * 20.0 + 700.0 * up.climb_m + 150.0 * up.duration_s)
    assert ground.figures([(25.5, 2.5), (5.5, 2.5)]).climb_m == 0.0


@pytest.mark.parametrize("kind", ["time", "energy"])
def test_a_path_costs_in_level_metres_what_the_model_says_that_it_takes(kind) -> None:
    ground, path = hills(), places(40, 1)
    cost, unit = terrain_cost(kind, ground), cost_unit(kind, ground)
    assert cost is not None
    expected = unit.of(ground.figures([(x, y) for x, y in path]))
    assert cost.of_path(path) * unit.per_level_metre == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("kind", ["time", "energy"])
def test_a_leg_costs_the_same_alone_and_among_many_both_ways_and_never_less_than_its_length(kind) -> None:
    cost = terrain_cost(kind, hills(2))
    assert cost is not None
    a, b = places(300, 3), places(300, 4)
    many, alone = cost.of_legs(a, b), cost.leg_cost()
    assert [alone(*p, *q) for p, q in zip(a.tolist(), b.tolist(), strict=True)] == pytest.approx(many.tolist())
    assert cost.of_legs(b, a) == pytest.approx(many)
    assert (many >= np.hypot(*(b - a).T) * (1.0 - 1e-12)).all()


def test_there_and_back_cost_what_differs_by_the_height_between_the_ends() -> None:
    ground = hills(5)
    cost = terrain_cost("energy", ground)
    assert cost is not None
    path = places(2, 6)
    low, high = cost.heights(path)
    assert cost.of_path(path) - cost.of_path(path[::-1]) == pytest.approx(cost.climb * (high - low))


def test_the_metres_that_a_cost_pays_for_cost_just_that() -> None:
    cost = terrain_cost("time", hills(7))
    assert cost is not None
    path = places(5, 8)
    metres = cost.metres_for(path, 0.4 * cost.of_path(path))
    steps = np.hypot(*np.diff(path, axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    whole = int(np.searchsorted(along, metres))
    share = (metres - along[whole - 1]) / steps[whole - 1]
    end = path[whole - 1] + share * (path[whole] - path[whole - 1])
    assert cost.of_path(np.vstack((path[:whole], end))) == pytest.approx(0.4 * cost.of_path(path), rel=1e-6)
    assert cost.metres_for(path, 1e9) == pytest.approx(along[-1])


def test_a_rover_that_draws_nothing_on_level_ground_has_no_cost_in_energy() -> None:
    free = DrivingModel(0.1, 1.0, 20.0, 0.0, 700.0, 0.0)
    with pytest.raises(InvalidInput, match="expected a rover that draws energy on level ground"):
        cost_unit("energy", hills(model=free))

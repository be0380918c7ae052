"""How much ground is closed, why, and how much of the rest is cut off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from he3.frames import SiteGrid
from he3.reference import Region
from services.ground.closed_ground import closed_ground
from services.ground.terrain import GroundTerrain

GRID = SiteGrid(10, 10)


def test_each_cell_is_closed_for_one_reason_and_what_lies_behind_is_cut_off() -> None:
    """A steep column, a rough cell and a keep-out; the two columns beyond the steep one cannot be reached."""
    slope, traversable = np.zeros(GRID.shape), np.ones(GRID.shape, dtype=np.bool_)
    slope[:, 7] = 30.0
    traversable[:, 7] = False
    traversable[0, 0] = False
    field = np.ones(GRID.shape)
    region = Region(
        name="made", title="Made", provenance="made", grid=GRID, he3_ppb=field, orbital_ppb=field.copy(),
        elevation_m=np.zeros(GRID.shape), slope_deg=slope, traversable=traversable,
    )  # fmt: skip
    keep_out = {"a": ((1.2, 1.2), (1.8, 1.2), (1.8, 1.8))}
    terrain = GroundTerrain(GRID, region.traversable, 0.0, keep_out)
    account = closed_ground(region, terrain, (4.5, 4.5), 20.0)
    assert (account.too_steep, account.rough, account.keep_outs, account.margin) == (0.1, 0.01, 0.01, 0.0)
    assert account.cut_off == pytest.approx(0.2)
    assert account.unknown == 0.0
    known = np.ones(GRID.shape, dtype=np.bool_)
    known[0, :3] = False
    part = replace(region, known=known, traversable=traversable & known)
    account = closed_ground(part, GroundTerrain(GRID, part.traversable, 0.0, keep_out), (4.5, 4.5), 20.0)
    assert (account.unknown, account.rough) == (0.03, 0.0)
    known = known.copy()
    known[9] = False
    steep_too = replace(region, known=known, traversable=traversable & known, slope_deg=np.full(GRID.shape, 19.0))
    account = closed_ground(steep_too, GroundTerrain(GRID, steep_too.traversable, 0.0, keep_out), (4.5, 4.5), 18.0)
    assert (account.unknown, account.too_steep) == (0.13, 0.87)
    wide = closed_ground(region, GroundTerrain(GRID, region.traversable, 0.5, keep_out), (4.5, 4.5), 20.0)
    assert wide.margin > 0.2
    assert wide.too_steep == 0.1

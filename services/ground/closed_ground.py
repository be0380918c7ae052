"""How much ground is closed to the rover, why, and how much of the rest it cannot reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from he3.constants import ROVER_SLOPE_NOMINAL_DEG
from he3.terrain import reachable

if TYPE_CHECKING:
    from he3.frames import Place
    from he3.reference import Region
    from services.ground.terrain import GroundTerrain


@dataclass(frozen=True, slots=True)
class ClosedGround:
    """Shares of the site; the first five reasons add up to what is closed."""

    too_steep: float
    """Steeper than the rover, the planners or the region's rule admit."""
    rough: float
    """Not traversable in the region, and not too steep: steps, roughness or rocks, or relief by the paper's rule."""
    unknown: float
    """Without a value of the reference field, and not too steep."""
    keep_outs: float
    """In a keep-out, and open otherwise."""
    margin: float
    """Cells from which the rover's footprint might touch closed ground; none where cells are much larger than it."""
    cut_off: float
    """Open, but not connected to the start."""


def closed_ground(region: Region, terrain: GroundTerrain, start_m: Place, slope_limit_deg: float) -> ClosedGround:
    """The account of a region's ground as the ground station knows it. slope_limit_deg: of rover and planners."""
    impassable = ~region.traversable
    steep = (region.slope_deg > slope_limit_deg) | (impassable & (region.slope_deg > ROVER_SLOPE_NOMINAL_DEG))
    unknown = np.zeros_like(steep) if region.known is None else ~region.known & ~steep
    rough = impassable & ~steep & ~unknown
    kept_out = np.zeros_like(steep)
    for area in terrain.areas.values():
        kept_out |= area & ~steep & ~rough & ~unknown
    open_cells = terrain.traversable
    margin = ~open_cells & ~steep & ~rough & ~unknown & ~kept_out
    reached = reachable(terrain.open_from(start_m), region.grid, start_m) & open_cells
    shares = (float(cells.mean()) for cells in (steep, rough, unknown, kept_out, margin, open_cells & ~reached))
    return ClosedGround(*shares)

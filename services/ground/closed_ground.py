"""How much ground is closed to the rover, why, and how much of the rest it cannot reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from he3.constants import ROVER_SLOPE_NOMINAL_DEG
from he3.terrain import reachable

if TYPE_CHECKING:
    from he3.frames import BoolArray, Place, SiteGrid
    from he3.reference import Region
    from services.ground.terrain import GroundTerrain

_ENOUGH_REACHED = 0.5  # share of the open ground that a mission reaches from its start without a note


@dataclass(frozen=True, slots=True)
class ClosedGround:
    """Shares of the site; the first five reasons add up to what is closed."""

    too_steep: float
    """Steeper than the rover, the planners or the region's rule admit, and not unknown."""
    rough: float
    """Not traversable in the region, and not too steep: steps, roughness or rocks, relief by the paper's rule, or
    closed in the file of the region for reasons that it does not say.
    """
    unknown: float
    """Without a value of the reference field, whatever its slope: the map is not scored there."""
    keep_outs: float
    """In a keep-out, and open otherwise."""
    margin: float
    """Cells from which the rover's footprint might touch closed ground; none where cells are much larger than it."""
    cut_off: float
    """Open, but not connected to the start."""


def closed_ground(region: Region, terrain: GroundTerrain, start_m: Place, slope_limit_deg: float) -> ClosedGround:
    """The account of a region's ground as the ground station knows it. slope_limit_deg: of rover and planners."""
    impassable = ~region.traversable
    unknown = np.zeros_like(impassable) if region.known is None else ~region.known
    steep = (region.slope_deg > slope_limit_deg) | (impassable & (region.slope_deg > ROVER_SLOPE_NOMINAL_DEG))
    steep &= ~unknown
    rough = impassable & ~steep & ~unknown
    kept_out = np.zeros_like(steep)
    for area in terrain.areas.values():
        kept_out |= area & ~steep & ~rough & ~unknown
    open_cells = terrain.traversable
    margin = ~open_cells & ~steep & ~rough & ~unknown & ~kept_out
    reached = within_reach(terrain, start_m)
    shares = (float(cells.mean()) for cells in (steep, rough, unknown, kept_out, margin, open_cells & ~reached))
    return ClosedGround(*shares)


def within_reach(terrain: GroundTerrain, start_m: Place) -> BoolArray:
    """The open cells (rows, columns) that can be reached from the start [m]."""
    reached: BoolArray = reachable(terrain.open_from(start_m), terrain.grid, start_m) & terrain.traversable
    return reached


def enclosure(terrain: GroundTerrain, start_m: Place) -> str:
    """One line on a start [m] on ground that is closed in the region, or from which little of the open ground can be
    reached; empty if the start is open, and most of the rest can be reached.
    """
    grid, open_cells = terrain.grid, terrain.traversable
    if not terrain.open_in_region(start_m):
        x, y = _nearest(open_cells, grid, start_m)
        return (
            f"the start ({start_m[0]:g}, {start_m[1]:g}) m is on closed ground, which the rover may be unable to "
            f"leave; the nearest open ground is at ({x:g}, {y:g}) m"
        )
    reached = within_reach(terrain, start_m)
    total, count = int(np.count_nonzero(open_cells)), int(np.count_nonzero(reached))
    if count >= _ENOUGH_REACHED * total:
        return ""
    said = (
        f"from the start ({start_m[0]:g}, {start_m[1]:g}) m only {count / total:.1%} of the open ground can be reached"
    )
    labels, parts = ndimage.label(open_cells)
    sizes = np.bincount(labels.ravel(), minlength=parts + 1)[1:]
    if sizes.max() <= count:
        return f"{said}, the largest of {parts} parts that closed ground keeps apart"
    x, y = _nearest(labels == 1 + int(np.argmax(sizes)), grid, start_m)
    return f"{said}; from ({x:g}, {y:g}) m it is {sizes.max() / total:.1%}"


def _nearest(cells: BoolArray, grid: SiteGrid, place_m: Place) -> Place:
    """The centre [m] of that one of the cells (rows, columns), some of which are set, that is nearest to the place."""
    centres = (np.argwhere(cells)[:, ::-1] + 0.5) * grid.resolution_m
    x, y = centres[int(np.argmin(np.hypot(*(centres - place_m).T)))]
    return float(x), float(y)

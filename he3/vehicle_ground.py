"""Where a vehicle may drive: slope, step height and roughness at its own scale, and rock abundance.

On real ground the paper's relief rule closes what is even: 1.5 standard deviations of relief are a few centimetres
there. This rule has limits of the vehicle instead, in its own units (compare Wermelinger et al. 2016):

- *slope* of the cell, by central differences;
- *step*: how much the height changes from a cell to the next beyond what the ground's trend explains. With d the
  differences along a line, it is the smaller of |d_i| and |d_i - (d_{i-1} + d_{i+1}) / 2|, so a plane and a bowl have
  none, a scarp has its height, and a boulder on one cell has its own;
- *roughness*: standard deviation of the heights from the plane that fits them best, in a square as wide as the vehicle;
- *rock abundance*: share of the ground that rocks cover, where there is a raster of it.

Steps and roughness are judged where cells are no larger than the vehicle: larger ones average over what it meets.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from he3 import constants
from he3.errors import InvalidInput
from he3.terrain import slope_deg

if TYPE_CHECKING:
    from he3.frames import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class VehicleLimits:
    """What the vehicle may drive on, inclusive."""

    slope_deg: float = constants.ROVER_SLOPE_NOMINAL_DEG
    step_m: float = constants.ROVER_STEP_M
    roughness_m: float = constants.ROVER_ROUGHNESS_M
    rock_abundance: float = constants.ROVER_ROCK_ABUNDANCE
    width_m: float = constants.ROVER_WIDTH_M


@dataclass(frozen=True, slots=True, eq=False)
class JudgedGround:
    """Where the vehicle may drive, (rows, columns), and a line on the rule with the share that each limit closes."""

    open_cells: BoolArray
    rule: str


def judged(
    elevation_m: FloatArray,
    resolution_m: float,
    limits: VehicleLimits,
    *,
    slope: FloatArray | None = None,
    rock_abundance: FloatArray | None = None,
    pixel_m: float = 0.0,
    margin: int = 0,
) -> JudgedGround:
    """The ground of an elevation (rows, columns) [m] in cells of resolution_m.

    slope: (rows, columns) [deg], if it is known better than from these heights. rock_abundance: (rows, columns), 0 to
    1, NaN where it is not known, which closes nothing. pixel_m: size of the pixels that the heights were interpolated
    from, if larger than the cells. margin: cells on each side that are known, and no part of the site. Raises
    InvalidInput for shapes that differ, and for less than 2 x 2 cells.
    """
    if min(elevation_m.shape) < 2:
        raise InvalidInput(f"expected an elevation of at least 2 x 2 cells, got shape {elevation_m.shape}")
    for name, layer in (("slope", slope), ("rock abundance", rock_abundance)):
        if layer is not None and layer.shape != elevation_m.shape:
            raise InvalidInput(f"expected {name} of shape {elevation_m.shape}, got {layer.shape}")
    steepness = slope_deg(elevation_m, resolution_m) if slope is None else slope
    closed = {f"slope of at most {limits.slope_deg:g} deg": steepness > limits.slope_deg}
    seen_m = max(resolution_m, pixel_m)
    if seen_m <= limits.width_m:
        closed[f"steps of at most {limits.step_m:g} m"] = step_m(elevation_m) > limits.step_m
        rough = roughness_m(elevation_m, resolution_m, limits.width_m)
        closed[f"roughness of at most {limits.roughness_m:g} m"] = rough > limits.roughness_m
    if rock_abundance is not None:
        with np.errstate(invalid="ignore"):
            closed[f"rock abundance of at most {limits.rock_abundance:g}"] = rock_abundance > limits.rock_abundance
    site = slice(margin, -margin or None)
    closed = {name: cells[site, site] for name, cells in closed.items()}
    rule = ", ".join(f"{name} ({cells.mean():.1%} closed)" for name, cells in closed.items())
    if seen_m > limits.width_m:
        rule += f"; {seen_m:.3g} m show neither steps nor roughness at the vehicle's scale"
    open_cells: BoolArray = ~np.logical_or.reduce(list(closed.values()))
    return JudgedGround(open_cells, rule)


def step_m(elevation_m: FloatArray) -> FloatArray:
    """Highest step [m] between each cell (rows, columns) and its eight neighbours, beyond the ground's trend."""
    highest: FloatArray = np.zeros(elevation_m.shape)
    padded = _continued(elevation_m, 2)
    rows, columns = elevation_m.shape

    def shifted(by: int, north: int, east: int) -> FloatArray:
        """The heights ``by`` cells on along the direction (north, east) of each cell."""
        first_row, first_column = 2 + by * north, 2 + by * east
        moved: FloatArray = padded[first_row : first_row + rows, first_column : first_column + columns]
        return moved

    for north, east in ((0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1)):
        behind, here, next_one, beyond = (shifted(by, north, east) for by in (-1, 0, 1, 2))
        difference = next_one - here
        unexplained = difference - 0.5 * ((here - behind) + (beyond - next_one))
        np.maximum(highest, np.minimum(np.abs(difference), np.abs(unexplained)), out=highest)
    return highest


def roughness_m(elevation_m: FloatArray, resolution_m: float, width_m: float) -> FloatArray:
    """Standard deviation [m] of the heights from their best plane, in a square of that width around each cell.

    The square is an odd number of cells, at least 3.
    """
    half = max(1, round((width_m / resolution_m - 1.0) / 2.0))
    size = 2 * half + 1
    heights = _continued(elevation_m - elevation_m.mean(), half)
    offsets = np.arange(-half, half + 1, dtype=np.float64)
    square = float((offsets**2).mean())

    def mean(weights_north: FloatArray, weights_east: FloatArray, of: FloatArray) -> FloatArray:
        across = ndimage.correlate1d(of, weights_east / size, axis=1, mode="nearest")
        both: FloatArray = ndimage.correlate1d(across, weights_north / size, axis=0, mode="nearest")
        return both[half:-half, half:-half]

    even = np.ones(size)
    level = mean(even, even, heights)
    east, north = mean(even, offsets, heights), mean(offsets, even, heights)
    variance = mean(even, even, heights * heights) - level**2 - (east**2 + north**2) / square
    deviation: FloatArray = np.sqrt(np.maximum(variance, 0.0))
    return deviation


def _continued(elevation_m: FloatArray, cells: int) -> FloatArray:
    """The heights continued point-symmetrically beyond each edge, so that a plane stays one."""
    padded, left = elevation_m, cells
    while left > 0:  # a reflection reaches no further than the array is wide
        pad = min(left, min(padded.shape) - 1)
        padded = np.pad(padded, pad, mode="reflect", reflect_type="odd")
        left -= pad
    return padded

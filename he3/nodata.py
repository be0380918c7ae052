"""Refusal of rasters with missing values, before anything is computed from them.

Rasters mark a missing value by NaN, or by a number that is no possible measurement: -9999, -32768, -3.4e38, 65535 and
others. A computation would take it for a value: one cell of -9999 m makes the standard deviation of relief so large
that hollows become open ground. Each refusal is one line with the number of cells and the place of the first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from he3.errors import InvalidInput

if TYPE_CHECKING:
    from he3.frames import BoolArray, FloatArray

# Numbers in use for missing values that may lie within a physical range: runs of nines, and limits of 16 bits. Those
# beyond any range (-32768, -3.4e38, 1e20) need no list.
SENTINELS: Final = (-9999.0, -999.0, 999.0, 9999.0, 32767.0, 65535.0, 99999.0, 999999.0)
_OF_NO_RANGE: Final = (-32768.0, -32767.0, -99999.0, -999999.0, -99.0, -1e20, 1e20)
"""Further ones, for values whose unit, and so whose range, is not known."""
MAX_STEP_DEG: Final = 85.0  # deg, from a cell to the next; no ground stands steeper over MIN_STEP_M, ASSUMED
MIN_STEP_M: Final = 300.0  # m, lower steps may be boulders, scarps, or walls in a synthetic region, ASSUMED

FAR_OFF: Final = 10.0  # 1, ranges of all other cells, from which on a few cells of a raster are broken ones, ASSUMED


def expect_measured(name: str, values: FloatArray, low: float, high: float, unit: str = "") -> None:
    """Raises InvalidInput if a value (rows, columns) is not finite, outside low..high, or marks a missing value.

    name: what the line begins with. A number of ``SENTINELS`` within the range is refused where it lies farther from
    all other values than they lie from one another.
    """
    finite = np.isfinite(values)
    if not finite.all():
        raise InvalidInput(f"{name}: expected finite values, got NaN or infinity in {cells_where(~finite)}")
    off = (values < low) | (values > high)
    if off.any():
        first = float(values[off][0])
        raise InvalidInput(
            f"{name}: expected {low:g} to {high:g}{unit and ' ' + unit}, got {first:g} in {cells_where(off)}"
        )
    for sentinel in SENTINELS:
        missing = values == sentinel
        if missing.any() and not missing.all():
            others = values[~missing]
            lowest, highest = float(others.min()), float(others.max())
            if max(lowest - sentinel, sentinel - highest) > highest - lowest:
                raise InvalidInput(
                    f"{name}: expected values as the others, {lowest:g} to {highest:g}{unit and ' ' + unit}, got "
                    f"{sentinel:g}, which marks missing values, in {cells_where(missing)}"
                )


@dataclass(frozen=True, slots=True, eq=False)
class Undeclared:
    """A number that marks missing values, and where (rows, columns)."""

    number: float
    where: BoolArray


def undeclared(values: NDArray[Any], known: BoolArray) -> Undeclared | None:
    """A number among the known ``values`` (rows, columns) that marks missing ones, in any unit; None if there is none.

    It is one of the customary numbers, or an end of the range of the array's integers, and lies farther from all other
    values than these lie from one another.
    """
    ends: tuple[float, ...] = ()
    if values.dtype.kind in "iu":
        limits = np.iinfo(values.dtype)
        ends = (float(limits.max),) if values.dtype.kind == "u" else (float(limits.min), float(limits.max))
    for number in dict.fromkeys((*SENTINELS, *_OF_NO_RANGE, *ends)):
        where = known & (values == number)
        others = values[known & ~where] if where.any() else values[:0]
        if not others.size:
            continue
        lowest, highest = float(others.min()), float(others.max())
        # 0 and 255 alone may be a mask.
        varies = highest > lowest or number not in ends
        if varies and max(lowest - number, number - highest) > highest - lowest:
            return Undeclared(number, where)
    return None


def far_off(values: NDArray[Any]) -> BoolArray:
    """The few cells (rows, columns) whose values lie far beyond all others, as those of a broken pixel do.

    Beyond: by more than ``FAR_OFF`` times the range of all cells but the thousandth part at either end, at least one.
    None where these are all equal.
    """
    ordered = np.sort(values, axis=None).astype(np.float64)
    ends = max(1, ordered.size // 1000)
    if ordered.size <= 2 * ends:
        return np.zeros(values.shape, dtype=np.bool_)
    low, high = ordered[ends], ordered[-ends - 1]
    reach = FAR_OFF * (high - low) if high > low else math.inf
    beyond: BoolArray = (values < low - reach) | (values > high + reach)
    return beyond


def filled_with_nearest(values: FloatArray) -> tuple[FloatArray, BoolArray | None]:
    """The values (rows, columns) with the nearest other for each NaN, and where there was none; None for no NaN.

    Raises InvalidInput if all are NaN.
    """
    known = ~np.isnan(values)
    if known.all():
        return values, None
    if not known.any():
        raise InvalidInput("expected a value in some cell, got NaN in all")
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return values[tuple(nearest)], known


def expect_no_walls(name: str, elevation_m: FloatArray, resolution_m: float) -> None:
    """Raises InvalidInput if an elevation (rows, columns) [m] has steps between cells higher than any real terrain.

    What is left of missing values after a raster was resampled is such a step.
    """
    limit = max(MIN_STEP_M, math.tan(math.radians(MAX_STEP_DEG)) * resolution_m)
    walls = np.zeros(elevation_m.shape, dtype=np.bool_)
    walls[1:] |= np.abs(np.diff(elevation_m, axis=0)) > limit
    walls[:, 1:] |= np.abs(np.diff(elevation_m, axis=1)) > limit
    if walls.any():
        raise InvalidInput(
            f"{name}: expected steps of at most {limit:g} m between cells of {resolution_m:g} m, got higher ones, as "
            f"beside missing values, at {cells_where(walls)}"
        )


def cells_where(where: BoolArray) -> str:
    """How many cells of a mask (rows, columns) are set, and which is the first, for an error message."""
    row, column = np.argwhere(where)[0]
    count = int(where.sum())
    if count == 1:
        return f"1 cell, at row {row}, column {column}"
    return f"{count} cells, the first at row {row}, column {column}"

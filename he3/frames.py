"""The site frame: x east, y north, metres, origin at the region's south-west corner.

Arrays over the site are ``[row, column] = [y, x]`` with row 0 in the south, and hold values at cell centres:
cell (0, 0) of a 1 m grid is centred at (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from he3.errors import InvalidInput, OutsideRegion

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
Place = tuple[float, float]
"""(x, y): metres east and north of the region's south-west corner."""
ROUNDING_CELLS = 1e-7
"""A place outside the site by no more than that [cells] counts as on its edge: it is outside by rounding."""


@dataclass(frozen=True, slots=True)
class SiteGrid:
    """A regular grid of square cells over the site."""

    rows: int
    columns: int
    resolution_m: float = 1.0

    def __post_init__(self) -> None:
        if self.rows < 1 or self.columns < 1 or not self.resolution_m > 0:
            raise InvalidInput(
                f"a site grid needs at least one row and column and a positive cell size; "
                f"got {self.rows} x {self.columns} cells of {self.resolution_m} m"
            )

    @property
    def shape(self) -> tuple[int, int]:
        return self.rows, self.columns

    @property
    def width_m(self) -> float:
        """Extent eastward [m]."""
        return self.columns * self.resolution_m

    @property
    def height_m(self) -> float:
        """Extent northward [m]."""
        return self.rows * self.resolution_m

    @property
    def extent_m(self) -> float:
        """The greater of width and height [m]."""
        return max(self.width_m, self.height_m)

    @property
    def x_m(self) -> FloatArray:
        """Eastward coordinate of the cell centres, (columns,) [m]."""
        return _centres(self.columns, self.resolution_m)

    @property
    def y_m(self) -> FloatArray:
        """Northward coordinate of the cell centres, (rows,) [m]."""
        return _centres(self.rows, self.resolution_m)

    def points(self) -> FloatArray:
        """All cell centres as (rows * columns, 2) of (x, y) [m], in the order of ``array.ravel()``."""
        x, y = np.meshgrid(self.x_m, self.y_m)
        return np.column_stack((x.ravel(), y.ravel()))

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Whether each of the places (N, 2) [m] lies in the region, edge included, (N,)."""
        (x, y), slack = as_points(points_m).T, ROUNDING_CELLS * self.resolution_m
        inside: NDArray[np.bool_] = (
            (x >= -slack) & (x <= self.width_m + slack) & (y >= -slack) & (y <= self.height_m + slack)
        )
        return inside

    def has(self, place_m: Place) -> bool:
        """Whether the place (x, y) [m] lies in the region, edge included."""
        (x_m, y_m), slack = place_m, ROUNDING_CELLS * self.resolution_m
        return -slack <= x_m <= self.width_m + slack and -slack <= y_m <= self.height_m + slack

    def cells_of(self, points_m: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns, each (N,), of the cells that contain the places (N, 2) [m].

        Raises OutsideRegion for the first place outside the region.
        """
        xy = as_points(points_m)
        inside = self.contains(xy)
        if not inside.all():
            x, y = xy[int(np.argmin(inside))]
            raise OutsideRegion(
                f"expected a place within 0..{self.width_m:g} m east and 0..{self.height_m:g} m north, "
                f"got ({x:g}, {y:g})"
            )
        columns = np.minimum((xy[:, 0] / self.resolution_m).astype(np.intp), self.columns - 1)
        rows = np.minimum((xy[:, 1] / self.resolution_m).astype(np.intp), self.rows - 1)
        return rows, columns


@lru_cache(maxsize=16)
def _centres(count: int, resolution_m: float) -> FloatArray:
    """Coordinates (count,) of the centres of that many cells [m]: read only, as all who ask for them share them."""
    centres: FloatArray = (np.arange(count, dtype=np.float64) + 0.5) * resolution_m
    centres.flags.writeable = False
    return centres


def as_points(points_m: FloatArray) -> FloatArray:
    """The places as a float64 array (N, 2); raises InvalidInput for another shape or a value that is not finite."""
    xy = np.asarray(points_m, dtype=np.float64)
    if xy.ndim != 2 or xy.shape[1] != 2:
        raise InvalidInput(f"expected places of shape (N, 2), got {xy.shape}")
    if not np.isfinite(xy).all():
        raise InvalidInput("expected finite coordinates [m], got NaN or infinity")
    return xy


def path_length(points_m: FloatArray) -> float:
    """Length [m] of the polyline through the places (N, 2) [m]; 0 for fewer than two."""
    steps = np.diff(as_points(points_m), axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

"""A coarser grid over the same site, and values on it interpolated on the cells of the site's own grid."""

from __future__ import annotations

import numpy as np

from he3.frames import Float32Array, FloatArray, SiteGrid

MOST_CELLS = 4096


def coarser(grid: SiteGrid, most_cells: int = MOST_CELLS) -> SiteGrid:
    """The grid of at most that many cells over the same site; the grid itself if it has no more."""
    step = 1
    while -(-grid.rows // step) * -(-grid.columns // step) > most_cells:
        step += 1
    if step == 1:
        return grid
    return SiteGrid(-(-grid.rows // step), -(-grid.columns // step), step * grid.resolution_m)


def on_cells(values: FloatArray | Float32Array, grid: SiteGrid, coarse: SiteGrid) -> Float32Array:
    """Values (rows, columns) of the coarse grid at the cells of the grid: bilinear, constant beyond the outermost."""
    across = values.astype(np.float32)
    if coarse == grid:
        return across
    step = coarse.resolution_m / grid.resolution_m
    for axis, cells in enumerate(grid.shape):
        count = across.shape[axis]
        at = np.clip((np.arange(cells) + 0.5) / step - 0.5, 0.0, count - 1.0)
        below = np.minimum(at.astype(np.intp), max(count - 2, 0))
        share = (at - below).astype(np.float32)[(slice(None), None) if axis == 0 else (None, slice(None))]
        above = np.minimum(below + 1, count - 1)
        low, high = across.take(below, axis=axis), across.take(above, axis=axis)
        across = low + share * (high - low)
    return across

"""Distances and places along a polyline."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from he3.frames import FloatArray


def arc_lengths(path_m: FloatArray) -> FloatArray:
    """Distance (K,) [m] along the polyline (K, 2) [m] from its first vertex to each vertex."""
    steps = np.diff(path_m, axis=0)
    return np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))


def places_along(path_m: FloatArray, count: int) -> FloatArray:
    """Places (count, 2) [m] at equal distances along the polyline (K, 2) [m], the last at its end."""
    along = arc_lengths(path_m)
    at = along[-1] * np.arange(1, count + 1) / count
    places = np.column_stack((np.interp(at, along, path_m[:, 0]), np.interp(at, along, path_m[:, 1])))
    places[-1] = path_m[-1]
    return places


def path_prefix(path_m: FloatArray, length_m: float) -> FloatArray:
    """The first ``length_m`` metres of the polyline (K, 2) [m], or all of it if it is not longer."""
    along = arc_lengths(path_m)
    if along[-1] <= length_m:
        return path_m
    whole = int(np.searchsorted(along, length_m, side="right"))
    share = (length_m - along[whole - 1]) / (along[whole] - along[whole - 1])
    end = path_m[whole - 1] + share * (path_m[whole] - path_m[whole - 1])
    return np.vstack((path_m[:whole], end))

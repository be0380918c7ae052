"""Central intervals of a mixture of normal distributions, cell by cell.

A mixture of kernels is not normal: where the kernels disagree on the standard deviation, its tails are heavier and its
middle is narrower. So mean +- one standard deviation holds more than 68 % of it, and how much more differs from place
to place. The ends of its central intervals are quantiles of the mixture's own distribution,

    sum w_i Phi((end - m_i) / s_i) = (1 -+ probability) / 2

at each cell of the coarser grid on which the kernels have their posteriors. What the samples tell of the field's own
tails (``he3.tails``) moves the probabilities at which the quantiles are taken. In standard deviations from the mean
they change slowly from cell to cell, as the mixture's correction of the map does (``he3.mixture_posterior``), and are
interpolated bilinearly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from he3.coarse_grid import on_cells

if TYPE_CHECKING:
    from collections.abc import Sequence

    from he3.frames import Float32Array, FloatArray, SiteGrid

NORMAL_ENDS = (-2.0, -1.0, 1.0, 2.0)
"""Ends of a normal distribution's intervals of 95.4 and 68.3 %, in standard deviations from its mean, in order."""
_STEPS = 30  # most steps of the search; five are usual
_CLOSE = 1e-3  # 1, standard deviations: error of an end
_LEAST_APART = 1e-12  # 1, standard deviations: distance of two ends that are taken for equal


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Ends of the central intervals of 95.4 and 68.3 %, in standard deviations from the mean, on a coarse grid.

    ends: (4, rows, columns) in the order of ``NORMAL_ENDS``, read-only.
    """

    grid: SiteGrid
    ends: Float32Array

    @classmethod
    def of(
        cls,
        grid: SiteGrid,
        weights: FloatArray,
        means: NDArray[np.floating],
        stds: NDArray[np.floating],
        levels: FloatArray,
    ) -> Intervals:
        """Those of a mixture with these weights (K,), means and standard deviations (K, rows, columns) of its parts.

        levels: (4,) for ``mixture_ends``, ascending.
        """
        ends = mixture_ends(weights, means.reshape(len(weights), -1), stds.reshape(len(weights), -1), levels)
        ends = np.maximum.accumulate(ends, axis=0)  # those of nearly one value are equal but for the search's error
        found = ends.reshape(-1, *grid.shape).astype(np.float32)
        found.setflags(write=False)
        return cls(grid, found)

    @property
    def nbytes(self) -> int:
        """Size of the arrays [bytes]."""
        return self.ends.nbytes

    def on(self, grid: SiteGrid) -> Float32Array:
        """The ends (4, rows, columns) on the cells of a finer grid over the same site."""
        return np.stack([on_cells(end, grid, self.grid) for end in self.ends])

    def at(self, x_m: float, y_m: float) -> tuple[float, float, float, float]:
        """The ends at a place of the site [m], interpolated as those of cells are."""
        shares = []
        for place_m, cells in ((y_m, self.grid.rows), (x_m, self.grid.columns)):
            at = min(max(place_m / self.grid.resolution_m - 0.5, 0.0), cells - 1.0)
            below = min(int(at), max(cells - 2, 0))
            shares.append((below, min(below + 1, cells - 1), at - below))
        (south, north, up), (west, east, right) = shares
        ends = self.ends
        low = (1.0 - right) * ends[:, south, west] + right * ends[:, south, east]
        high = (1.0 - right) * ends[:, north, west] + right * ends[:, north, east]
        found: list[float] = ((1.0 - up) * low + up * high).tolist()
        return found[0], found[1], found[2], found[3]


def mixture_ends(
    weights: FloatArray, means: NDArray[np.floating], stds: NDArray[np.floating], levels: FloatArray
) -> FloatArray:
    """Quantiles (L, m) of a mixture at m places, in its standard deviations from its mean.

    weights: (K,), their sum is 1. means and stds: (K, m) of the parts, stds positive. levels: (L,), a quantile is at
    the probability that a standard normal variable is below its level.
    """
    mean = weights @ means
    apart = means - mean
    std = np.sqrt(weights @ (stds.astype(np.float64) ** 2 + apart * apart))
    offsets, widths = (apart / std)[:, None, :], (stds / std)[:, None, :]
    wanted = levels[:, None]
    # A quantile of the mixture lies between the least and the greatest of those of its parts.
    of_parts = offsets + widths * wanted
    low, high = of_parts.min(axis=0), of_parts.max(axis=0)
    ends: FloatArray = np.clip(np.broadcast_to(wanted, low.shape), low, high)
    level = ndtr(wanted)
    for _ in range(_STEPS):
        scaled = (ends - offsets) / widths
        excess = np.tensordot(weights, ndtr(scaled), axes=1) - level
        low, high = np.where(excess < 0.0, ends, low), np.where(excess < 0.0, high, ends)
        density = np.tensordot(weights, np.exp(-0.5 * scaled * scaled) / widths, axes=1) / np.sqrt(2.0 * np.pi)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            newton = ends - excess / density
        step = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
        moved = float(np.abs(step - ends).max())
        ends = step
        if moved < _CLOSE:
            break
    return ends


def normal_levels(values: NDArray[np.floating], ends: Sequence[NDArray[np.floating]]) -> NDArray[np.floating]:
    """Where values lie in a standard normal distribution that lie at ``values`` in the one with these ends.

    values: in standard deviations from the mean. ends: the four of ``Intervals``, each of the values' shape, in order,
    of which some may be equal. Linear between the ends, and beyond them as between the outer two: a value at an end has
    the end's probability.
    """
    first, second, third, last = ends
    below, within, above = (
        np.maximum(end - before, _LEAST_APART) for before, end in ((first, second), (second, third), (third, last))
    )
    lower = NORMAL_ENDS[1] + (values - second) / below
    middle = NORMAL_ENDS[1] + (NORMAL_ENDS[2] - NORMAL_ENDS[1]) * (values - second) / within
    upper = NORMAL_ENDS[2] + (values - third) / above
    levels: NDArray[np.floating] = np.where(values < second, lower, np.where(values > third, upper, middle))
    return levels

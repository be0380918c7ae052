"""Whether a map whose rows are in float32 is exact enough, measured on a few cells whose posterior is in float64.

Rounding in a row of V = L^-1 K is magnified by the rows before it, the more so the smaller the noise and the more
crowded the samples; no bound on it that is worth having is cheap. So the map is compared with the exact posterior on a
lattice of cells, which costs as much as that many more cells would.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

from he3.posterior.sums import PosteriorSums

if TYPE_CHECKING:
    from he3.frames import FloatArray, IntArray
    from he3.gp import GaussianProcess
    from he3.hyperparameters import Hyperparameters
    from he3.posterior.tiles import TiledGrid

PROBES_PER_AXIS = 8
# The field's scale is its prior mean or its prior standard deviation, whichever is larger. The largest error lies
# between the probes: both tolerances are half of what a map may be off by, 1e-5 and 1e-4.
MEAN_TOLERANCE = 5e-6  # 1, of the field's scale
VARIANCE_TOLERANCE = 5e-5  # 1, of the prior variance
# 1, smallest posterior variance of a float32 map, as a share of the prior's. Its variances are off by 1e-6 of the
# prior's [measured], which at this size changes the standard deviation by 0.3 %.
LEAST_VARIANCE = 2e-4


class Probes:
    """The exact posterior on at most 8 x 8 cells, and the comparison with a map's sums there."""

    def __init__(self, tiled: TiledGrid, hyperparameters: Hyperparameters) -> None:
        """No samples yet. hyperparameters: with the trend, if there is one."""
        grid = tiled.grid
        rows, columns = (_spread(count) for count in grid.shape)
        numbers = tiled.on_grid(np.arange(tiled.cells))
        self._cells: IntArray = numbers[np.ix_(rows, columns)].ravel()
        x, y = np.meshgrid(grid.x_m[columns], grid.y_m[rows])
        self._points_m = np.column_stack((x.ravel(), y.ravel()))
        self._prior_variance = hyperparameters.kernel.prior_variance
        self._sums = PosteriorSums.prior(hyperparameters, self._points_m, len(self._cells))
        self._rows: FloatArray = np.empty((0, len(self._cells)))
        self._count = 0
        level = float(np.abs(hyperparameters.prior_mean_ppb(self._points_m)).max()) / hyperparameters.scale_ppb
        self._field_scale = max(level, float(np.sqrt(self._prior_variance)))

    def extend(self, process: GaussianProcess, trend_whitened: FloatArray | None) -> None:
        """Take in the samples that the process (without the trend) has and the probes have not.

        trend_whitened: the trend's columns (n, p), whitened at all samples; None without a trend.
        """
        first = self._count
        if first == len(process):
            return
        new = process.hyperparameters.kernel.covariance(process.places_m[first:], self._points_m)
        new -= process.factor[first:, :first] @ self._rows[:first]
        if len(new) == 1:
            new /= process.factor[-1, -1]
        else:
            new = solve_triangular(process.factor[first:, first:], new, lower=True, check_finite=False)
        if self._sums.trend is not None:
            assert trend_whitened is not None
            self._sums.trend = replace(self._sums.trend, whitened=trend_whitened)
        self._sums.add_rows(first, new, process.whitened[first:], slice(None))
        self._keep(new)

    def _keep(self, new: FloatArray) -> None:
        """Store new rows (k, probes); the array grows by doubling."""
        last = self._count + len(new)
        if last > len(self._rows):
            grown = np.empty((2 * last, len(self._cells)))
            grown[: self._count] = self._rows[: self._count]
            self._rows = grown
        self._rows[self._count : last] = new
        self._count = last

    def agree_with(self, sums: PosteriorSums, whitened: FloatArray, changed: slice) -> bool:
        """Whether a map's sums are exact enough at the probes, and no changed cell's variance is too small for float32.

        whitened: all samples' whitened residuals (n,). changed: the cells whose variance has fallen most.
        """
        if not float(sums.variance[changed].min()) >= LEAST_VARIANCE * self._prior_variance:
            return False
        mean, variance = sums.posterior(whitened, 0.0, self._cells)
        exact_mean, exact_variance = self._sums.posterior(whitened, 0.0)
        mean_error = float(np.abs(mean - exact_mean).max())
        variance_error = float(np.abs(variance - exact_variance).max())
        return (
            mean_error <= MEAN_TOLERANCE * self._field_scale
            and variance_error <= VARIANCE_TOLERANCE * self._prior_variance
        )


def _spread(count: int) -> IntArray:
    """At most ``PROBES_PER_AXIS`` of the numbers below ``count``, evenly spread."""
    probes = min(count, PROBES_PER_AXIS)
    return ((np.arange(probes) + 0.5) * count / probes).astype(np.intp)

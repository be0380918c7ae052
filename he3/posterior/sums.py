"""Mean and variance on a set of cells, accumulated row by row of V = L^-1 K(samples, cells).

All is in standardised units. With a trend, its columns H are kept apart, because their prior variance is so large that
float32 would lose digits of the rest. With R = H - V' (L^-1 H) on the cells, updated like the mean, and the
coefficients' posterior covariance S, the trend adds R b to the mean and R S R' to the variance (Rasmussen & Williams
2006, eqs. 2.41 and 2.42).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from he3.frames import FloatArray, IntArray
from he3.local_amplitude import LocallyScaled, prior_variance_at
from he3.trend import TrendOnCells

if TYPE_CHECKING:
    from he3.hyperparameters import Hyperparameters
    from he3.posterior.screening import RowBlock

Cells = slice | IntArray


@dataclass(slots=True, eq=False)
class PosteriorSums:
    """Mean (cells,) and variance (cells,) without the trend, in float64, and the trend's columns after conditioning."""

    mean: FloatArray
    variance: FloatArray
    trend: TrendOnCells | None

    @classmethod
    def prior(cls, hyperparameters: Hyperparameters, points_m: FloatArray | None, cells: int) -> PosteriorSums:
        """The sums before any sample. points_m: the cells' centres (cells, 2) [m]; see ``needs_points``."""
        trend = None
        if hyperparameters.trend is not None:
            assert points_m is not None
            basis = hyperparameters.trend_basis(points_m)
            assert basis is not None
            trend = TrendOnCells(basis.T.copy(), np.empty((0, basis.shape[1])))
        kernel = hyperparameters.kernel
        if isinstance(kernel, LocallyScaled):
            assert points_m is not None
            return cls(np.zeros(cells), prior_variance_at(kernel, points_m), trend)
        return cls(np.zeros(cells), np.full(cells, kernel.prior_variance, dtype=np.float64), trend)

    @staticmethod
    def needs_points(hyperparameters: Hyperparameters) -> bool:
        """Whether the sums before any sample differ from place to place."""
        return hyperparameters.trend is not None or isinstance(hyperparameters.kernel, LocallyScaled)

    def add_row(self, number: int, row: RowBlock, whitened: float, cells: slice) -> None:
        """Add one row (k,) on some of the cells. whitened: the sample's whitened residual."""
        if whitened != 0.0:
            self.mean[cells] += row * row.dtype.type(whitened)
        self.variance[cells] -= row * row
        if self.trend is not None:
            self.trend.subtract(number, row[None, :], cells)

    def add_rows(self, first: int, rows: RowBlock, whitened: NDArray[np.floating], cells: slice) -> None:
        """Add rows (r, k) from number ``first`` on, on some of the cells. whitened: (r,) in the rows' precision."""
        self.mean[cells] += whitened @ rows
        self.variance[cells] -= np.einsum("ij,ij->j", rows, rows)
        if self.trend is not None:
            self.trend.subtract(first, rows, cells)

    def posterior(
        self, whitened: FloatArray, least_variance: float, cells: Cells = slice(None)
    ) -> tuple[FloatArray, FloatArray]:
        """Posterior mean and variance on the cells, each (k,), trend included.

        whitened: all samples' whitened residuals (n,). least_variance: lower bound on the variance without the trend;
        smaller values are raised to it.
        """
        mean, variance = self.mean[cells], np.maximum(self.variance[cells], least_variance)
        if self.trend is not None:
            by_trend, of_trend = self.trend.contribution(whitened, cells)
            mean, variance = mean + by_trend, variance + of_trend
        return mean, variance

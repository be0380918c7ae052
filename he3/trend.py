"""A prior mean with unknown coefficients: a constant, or a coarse orbital map with gain and offset.

With an orbital map the field is modelled as m(x) + g(x), with g the zero-mean Gaussian process of the kernel and

    m(x) = M + offset + gain (o(x) - M),      gain ~ N(1, gain_std^2),  offset ~ N(0, offset_std^2)

where o is the orbital map and M its mean over the site, so that gain and offset are nearly independent. Both being
Gaussian, they are marginalised exactly by adding their covariance to the kernel's (Rasmussen & Williams 2006, sect.
2.7): their uncertainty is part of the posterior variance from the first sample on. A constant alone, whose mean value
is the hyperparameters' ``mean_ppb``, is the same with one coefficient.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from he3.errors import InvalidInput
from he3.frames import FloatArray, IntArray, SiteGrid, as_points

MAX_TREND_STD = 30.0  # 1, prior standard deviation of the trend anywhere, in units of the field's scale


class Trend(Protocol):
    """A prior mean that is linear in unknown coefficients."""

    def at(self, points_m: FloatArray) -> FloatArray:
        """Its expected value (N,) [ppb] at places (N, 2) [m], a constant excepted."""

    def basis(self, points_m: FloatArray, scale_ppb: float) -> FloatArray:
        """Columns (N, p) at places (N, 2) [m] whose outer product is its covariance, in units of scale_ppb."""


@dataclass(frozen=True, slots=True)
class UnknownConstant:
    """A constant of expectation zero, with the standard deviation of its prior [ppb].

    Raises InvalidInput for a standard deviation that is not positive.
    """

    std_ppb: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.std_ppb) and self.std_ppb > 0):
            raise InvalidInput(f"expected a positive standard deviation of the constant, got {self.std_ppb!r} ppb")

    def at(self, points_m: FloatArray) -> FloatArray:
        return np.zeros(len(points_m))

    def basis(self, points_m: FloatArray, scale_ppb: float) -> FloatArray:
        """One column (N, 1) at places (N, 2) [m]; the prior is at most ``MAX_TREND_STD`` wide, as the map's is."""
        return np.full((len(points_m), 1), min(self.std_ppb / scale_ppb, MAX_TREND_STD))


@dataclass(frozen=True, slots=True, eq=False)
class OrbitalTrend:
    """The orbital map over the site [ppb], as ``[row, column]`` at cell centres, and its prior uncertainty.

    The defaults are weak: a map that is a third too steep and several ppb too high lies within them. Raises
    InvalidInput for a map of another shape than the grid, or one with a value that is not finite.
    """

    grid: SiteGrid
    orbital_ppb: NDArray[np.floating]
    gain_std: float = 0.5  # 1, weak: half of all contrast that the map shows may be wrong, ASSUMED
    offset_std_ppb: float = 2.0  # ppb, weak: about the samples' mean misfit, which a fit subtracts first, ASSUMED
    _mean_ppb: float = field(init=False)
    _contrast_ppb: float = field(init=False)

    def __post_init__(self) -> None:
        values = np.array(self.orbital_ppb, dtype=np.float64)
        if values.shape != self.grid.shape:
            raise InvalidInput(f"expected an orbital map of shape {self.grid.shape}, got {values.shape}")
        if not np.isfinite(values).all():
            raise InvalidInput("expected an orbital map of finite values [ppb], got NaN or infinity")
        values.setflags(write=False)
        object.__setattr__(self, "orbital_ppb", values)
        object.__setattr__(self, "_mean_ppb", float(values.mean()))
        object.__setattr__(self, "_contrast_ppb", float(np.abs(values - self._mean_ppb).max()))

    def at(self, points_m: FloatArray) -> FloatArray:
        """The map (N,) [ppb] at places (N, 2) [m]: bilinear between cell centres, constant beyond the outermost."""
        xy = as_points(points_m)
        rows, columns = self.grid.shape
        row = np.clip(xy[:, 1] / self.grid.resolution_m - 0.5, 0.0, rows - 1.0)
        column = np.clip(xy[:, 0] / self.grid.resolution_m - 0.5, 0.0, columns - 1.0)
        row_0 = row.astype(np.intp)
        column_0 = column.astype(np.intp)
        row_1 = np.minimum(row_0 + 1, rows - 1)
        column_1 = np.minimum(column_0 + 1, columns - 1)
        north = row - row_0
        east = column - column_0
        values = self.orbital_ppb
        south_edge = values[row_0, column_0] * (1.0 - east) + values[row_0, column_1] * east
        north_edge = values[row_1, column_0] * (1.0 - east) + values[row_1, column_1] * east
        interpolated: FloatArray = south_edge * (1.0 - north) + north_edge * north
        return interpolated

    def basis(self, points_m: FloatArray, scale_ppb: float) -> FloatArray:
        """Columns (N, 2) at places (N, 2) [m] whose outer product is the covariance of gain and offset.

        In units of scale_ppb. A prior standard deviation above ``MAX_TREND_STD`` is reduced to that. The prior is then
        still nearly flat, and the covariance keeps enough digits for the rest of the field.
        """
        contrast = self.at(points_m) - self._mean_ppb
        gain_std = min(self.gain_std, MAX_TREND_STD * scale_ppb / self._contrast_ppb) if self._contrast_ppb else 0.0
        offset_std_ppb = min(self.offset_std_ppb, MAX_TREND_STD * scale_ppb)
        columns: FloatArray = np.column_stack((contrast * gain_std, np.full(len(contrast), offset_std_ppb)))
        columns /= scale_ppb
        return columns


@dataclass(frozen=True, slots=True, eq=False)
class TrendOnCells:
    """The trend's columns after conditioning: residual on the cells (p, cells), whitened at the samples (n, p)."""

    residual: FloatArray
    whitened: FloatArray

    def extended(self, factor_rows: FloatArray, basis: FloatArray) -> TrendOnCells:
        """A copy with the columns (k, p) at k more samples, whose rows of the Cholesky factor are (k, n + k)."""
        known = len(self.whitened)
        rest = basis - factor_rows[:, :known] @ self.whitened
        return replace(
            self, whitened=np.vstack((self.whitened, solve_triangular(factor_rows[:, known:], rest, lower=True)))
        )

    def subtract(self, start: int, rows_of_v: NDArray[np.floating], cells: slice) -> None:
        """Subtract on the cells, in place, what k samples from ``start`` on explain; rows_of_v is (k, cells)."""
        self.residual[:, cells] -= self.whitened[start : start + len(rows_of_v)].T.astype(rows_of_v.dtype) @ rows_of_v

    def contribution(
        self, whitened_values: FloatArray, cells: slice | IntArray = slice(None)
    ) -> tuple[FloatArray, FloatArray]:
        """The trend's parts of mean and variance on the cells, each (k,). whitened_values: (n,)."""
        residual = self.residual[:, cells]
        covariance = np.linalg.inv(self.whitened.T @ self.whitened + np.eye(len(residual)))
        coefficients = covariance @ (self.whitened.T @ whitened_values)
        spread = np.linalg.cholesky(covariance).T @ residual
        return coefficients @ residual, np.einsum("ij,ij->j", spread, spread)

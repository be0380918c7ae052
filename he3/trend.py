"""A prior mean with unknown coefficients: a constant, or layers from orbit, each with a weight of its own.

With k layers the field is modelled as m(x) + g(x), with g the zero-mean Gaussian process of the kernel and

    m(x) = level + offset + sum_j w_j z_j(x),      w_j ~ N(e_j, s_j^2),  offset ~ N(0, s_0^2)

where z_j is layer j less its mean over the site, divided by its standard deviation; so weights and offset are nearly
independent. All being Gaussian, they are marginalised exactly by adding their covariance X S X' to the kernel's
(Rasmussen & Williams 2006, sect. 2.7): their uncertainty is part of the posterior variance from the first sample on. A
layer that has nothing to do with the field ends with a weight about zero.

A coarse orbital map of the field itself is the case of one layer whose weight is expected to be the map's own spread
(`orbital_trend`). A constant alone, whose mean value is the hyperparameters' ``mean_ppb``, has no layer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.linalg import solve_triangular

from he3.errors import InvalidInput
from he3.frames import BoolArray, FloatArray, IntArray, SiteGrid, as_points
from he3.level import NARROW_M, level_columns

GAIN_STD = 0.5  # 1, weak: half of all contrast that a map from orbit shows may be wrong, ASSUMED
# 1, the same where hyperparameters are uncertain, too: measured soils hold 0.7 to 3 times the TiO2 that the relation
# makes of FeO (Lunar Sample Compendium, Apollo 15 and 17), and a map may be misplaced. Chosen out of 0.5 and 0.8 on
# variations 1 to 3 of `t1` and `t2` [measured]
UNSURE_GAIN_STD = 0.8
OFFSET_STD_PPB = 2.0  # ppb, weak: about the samples' mean misfit, which a fit subtracts first, ASSUMED
# 1, standard deviation of the weight of a layer of which nothing is known, in units of the field's scale, ASSUMED
WEIGHT_SHARE = 0.3
CUT_OFF = 0.44  # 1, standard deviation of the smoothing that splits a layer, in mean spacings of the samples [measured]
LEAST_WIDE = 0.02  # 1, least share of a layer's variance in its wide part [assumed]
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


@dataclass(frozen=True, slots=True)
class UnknownLevel:
    """A level of expectation zero on a site of that width [m], with the standard deviation of its prior [ppb].

    Raises InvalidInput unless both are positive.
    """

    std_ppb: float
    extent_m: float

    def __post_init__(self) -> None:
        if not (
            math.isfinite(self.extent_m) and self.extent_m > 0 and math.isfinite(self.std_ppb) and self.std_ppb > 0
        ):
            raise InvalidInput(
                f"expected a positive width and standard deviation, got {self.extent_m!r} m and {self.std_ppb!r} ppb"
            )

    def at(self, points_m: FloatArray) -> FloatArray:
        return np.zeros(len(points_m))

    def basis(self, points_m: FloatArray, scale_ppb: float) -> FloatArray:
        """Columns (N, p) at places (N, 2) [m]; the prior is at most ``MAX_TREND_STD`` wide, as the map's is."""
        return level_columns(points_m, self.extent_m) * min(self.std_ppb / scale_ppb, MAX_TREND_STD)


def unknown_level(std_ppb: float, extent_m: float) -> UnknownConstant | UnknownLevel:
    """The level of a site of that width [m], with that standard deviation [ppb]."""
    return UnknownConstant(std_ppb) if extent_m < NARROW_M else UnknownLevel(std_ppb, extent_m)


@dataclass(frozen=True, slots=True, eq=False)
class CovariateTrend:
    """Layers over the site as (k, rows, columns) at cell centres, in any unit, and the priors of their weights.

    A weight is the change of the field [ppb] for one standard deviation of its layer. Its prior's standard deviation is
    given in ppb; NaN stands for ``WEIGHT_SHARE`` of the field's own scale. A layer that does not vary counts as none.
    Raises InvalidInput for layers of another shape than the grid, with a value that is not finite, or without one prior
    each.
    """

    grid: SiteGrid
    layers: NDArray[np.floating]
    expected_ppb: FloatArray
    """(k,) expected weights [ppb]."""
    weight_std_ppb: FloatArray
    """(k,) standard deviations of the weights' priors [ppb]; NaN for a share of the field's scale."""
    level_ppb: float = 0.0
    """The field's expected mean, but for an offset [ppb]."""
    offset_std_ppb: float = OFFSET_STD_PPB
    level_varies: bool = False
    """Whether the offset is another one far away on the site (``he3.level``)."""
    after: tuple[int, ...] = ()
    """(k,) for each layer the number of the one without which it is left out, its own if there is none; empty: none."""
    _standard: FloatArray = field(init=False)
    """(k, rows, columns): the layers with mean 0 and standard deviation 1 over the site."""
    _reach: FloatArray = field(init=False)
    """(k,) the farthest that each standardised layer is from zero."""

    def __post_init__(self) -> None:
        grid, given = self.grid, np.array(self.layers, dtype=np.float64)
        if given.ndim != 3 or given.shape[1:] != grid.shape:
            raise InvalidInput(f"expected layers of shape (k, {grid.rows}, {grid.columns}), got {given.shape}")
        if not np.isfinite(given).all():
            raise InvalidInput("expected layers of finite values, got NaN or infinity")
        expected, stds = (np.array(prior, dtype=np.float64) for prior in (self.expected_ppb, self.weight_std_ppb))
        if not expected.shape == stds.shape == given.shape[:1]:
            raise InvalidInput(f"expected a prior for each of {len(given)} layers, got {expected.shape}, {stds.shape}")
        standard = given - given.mean(axis=(1, 2), keepdims=True)
        # In units of the largest value, whose square neither overflows nor vanishes.
        magnitude = np.abs(standard).max(axis=(1, 2), keepdims=True)
        standard /= np.where(magnitude > 0, magnitude, 1.0)
        spread = standard.std(axis=(1, 2), keepdims=True)
        standard /= np.where(spread > 0, spread, 1.0)
        reach = np.abs(standard).max(axis=(1, 2))
        for name, array in (
            ("layers", given), ("expected_ppb", expected), ("weight_std_ppb", stds), ("_standard", standard),
            ("_reach", reach),
        ):  # fmt: skip
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def spread_ppb(self) -> float:
        """Standard deviation over the site [ppb] of the field that the layers lead to expect."""
        return float(np.tensordot(self.expected_ppb, self._standard, 1).std()) if len(self.expected_ppb) else 0.0

    def at(self, points_m: FloatArray) -> FloatArray:
        """The expected field (N,) [ppb] at places (N, 2) [m]."""
        expected: FloatArray = self.level_ppb + self._standardised(points_m) @ self.expected_ppb
        return expected

    def basis(self, points_m: FloatArray, scale_ppb: float) -> FloatArray:
        """Columns (N, k + q) at places (N, 2) [m] whose outer product is the covariance of weights and offset.

        q is 1, or more where the level varies. In units of scale_ppb. A prior standard deviation above
        ``MAX_TREND_STD`` anywhere is reduced to that. The prior is then still nearly flat, and the covariance keeps
        enough digits for the rest of the field.
        """
        stds = np.where(np.isnan(self.weight_std_ppb), WEIGHT_SHARE, self.weight_std_ppb / scale_ppb)
        stds = np.minimum(stds, MAX_TREND_STD / np.maximum(self._reach, 1e-300))
        offset_std = min(self.offset_std_ppb / scale_ppb, MAX_TREND_STD)
        extent_m = self.grid.extent_m if self.level_varies else 0.0
        offset = level_columns(points_m, extent_m) * offset_std
        columns: FloatArray = np.column_stack((self._standardised(points_m) * stds, offset))
        return columns

    @property
    def optional(self) -> BoolArray:
        """(k,) the layers of whose weights nothing is known, and which may be left out."""
        found: BoolArray = np.isnan(self.weight_std_ppb)
        return found

    def _standardised(self, points_m: FloatArray) -> FloatArray:
        """The layers (N, k) at places (N, 2) [m]: bilinear between cell centres, constant beyond the outermost."""
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
        values = self._standard
        south_edge = values[:, row_0, column_0] * (1.0 - east) + values[:, row_0, column_1] * east
        north_edge = values[:, row_1, column_0] * (1.0 - east) + values[:, row_1, column_1] * east
        interpolated: FloatArray = south_edge * (1.0 - north) + north_edge * north
        return interpolated.T


def covariate_trend(
    grid: SiteGrid, layers: NDArray[np.floating], level_ppb: float, offset_std_ppb: float, *, split: bool = False
) -> CovariateTrend:
    """The trend of layers (k, rows, columns) of which nothing is known but that they may say something of the field.

    level_ppb and offset_std_ppb: the field's mean before any sample [ppb], and its uncertainty. split: the layers are
    those of ``split_by_scale``.
    """
    none = np.zeros(len(layers))
    after = _after(len(layers)) if split else ()
    return CovariateTrend(grid, layers, none, np.full(len(layers), math.nan), level_ppb, offset_std_ppb, True, after)


def _after(parts: int) -> tuple[int, ...]:
    """For each part of split layers the number of the layer's wide one."""
    return tuple(number - number % 2 for number in range(parts))


def split_by_scale(layers: NDArray[np.floating], grid: SiteGrid, samples: int) -> FloatArray:
    """Each layer (k, rows, columns) as two (2 k, ...): what is wider than the samples' spacing, and the rest.

    Samples far apart show whether a layer's large features are those of the field. They show little of its detail,
    which may be its instrument's noise. With one weight for both, the detail is taken for true. A wide part that is
    next to nothing of its layer, as that of noise, is left out as 0: made as large as others, it would look like a
    feature. samples: of the whole mission.
    """
    spacing_m = math.sqrt(grid.width_m * grid.height_m / max(samples, 1))
    wide = [ndimage.gaussian_filter(layer, CUT_OFF * spacing_m / grid.resolution_m, mode="nearest") for layer in layers]
    wide = [
        low if low.var() > LEAST_WIDE * layer.var() else np.zeros(grid.shape)
        for layer, low in zip(layers, wide, strict=True)
    ]
    parts = [part for layer, low in zip(layers, wide, strict=True) for part in (low, layer - low)]
    return np.array(parts, dtype=np.float64).reshape(-1, *grid.shape)


def orbital_trend(
    grid: SiteGrid,
    orbital_ppb: NDArray[np.floating],
    gain_std: float = GAIN_STD,
    offset_std_ppb: float = OFFSET_STD_PPB,
    covariates: NDArray[np.floating] | None = None,
) -> CovariateTrend:
    """The trend of a coarse map (rows, columns) [ppb] of the field itself: gain ~ N(1, gain_std^2), and an offset.

    covariates: (k, rows, columns) further layers, as ``split_by_scale`` gives them, of which nothing is known but that
    they may say something. The defaults are weak: a map that is a third too steep and several ppb too high lies within
    them. Raises InvalidInput for a map of another shape than the grid, or one with a value that is not finite.
    """
    orbital = np.array(orbital_ppb, dtype=np.float64)
    if orbital.shape != grid.shape:
        raise InvalidInput(f"expected an orbital map of shape {grid.shape}, got {orbital.shape}")
    if not np.isfinite(orbital).all():
        raise InvalidInput("expected an orbital map of finite values [ppb], got NaN or infinity")
    spread = float(orbital.std())
    others = np.empty((0, *grid.shape)) if covariates is None else np.asarray(covariates, dtype=np.float64)
    unknown = np.full(len(others), math.nan)
    return CovariateTrend(
        grid, np.concatenate((orbital[None], others)), np.array([spread, *np.zeros(len(others))]),
        np.array([gain_std * spread, *unknown]), float(orbital.mean()), offset_std_ppb,
        after=(0, *(1 + number for number in _after(len(others)))),
    )  # fmt: skip


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

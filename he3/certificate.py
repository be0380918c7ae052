"""Whether the map is good enough: the certificate of a goal for its standard deviation over an area.

The area is a set of targets: places, or the means of the field over blocks, each represented by q points of a regular
pattern (block kriging: Journel & Huijbregts 1978). With c the posterior covariance, the variance of a block's mean is

    var = 1/q^2 sum_ij c(x_i, x_j) = 1/q^2 sum_ij k(x_i, x_j) - |L^-1 k(X, block)|^2,
    k(X, block) = 1/q sum_j k(X, x_j)

What is not known of the hyperparameters is counted twice. The *stated* standard deviation is that of the mixture, by
the law of total variance. And the *weight* is the probability of those kernels of the mixture under which the
standard deviation is at most the goal at every target. The certificate holds when the greatest stated standard
deviation is at most the goal, and the weight at least the probability.

It promises that of the area at least a share of ``probability`` lies within z std of the map, z being the normal
quantile of that probability (1.96 for 0.95).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ndtri

from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.mixture import ProcessMixture, mixture_moments

if TYPE_CHECKING:
    from he3.frames import BoolArray, IntArray
    from he3.gp import GaussianProcess
    from he3.kernels import Kernel

ROUNDING = 1e-9  # 1, share by which a standard deviation may exceed the goal
MOST_POINTS = 4096
"""Points by which an area is represented."""
MOST_A_SIDE = 4
"""Points on a side of a block."""
MOST_BLOCKS = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Places, or blocks, whose standard deviation is to be low."""

    points_m: FloatArray
    """(T, q, 2) [m]: the points of each target; one for a place."""

    def __len__(self) -> int:
        return len(self.points_m)

    @property
    def centres_m(self) -> FloatArray:
        """(T, 2) [m]."""
        centres: FloatArray = self.points_m.mean(axis=1)
        return centres

    def only(self, chosen: BoolArray) -> Targets:
        """Those targets that are chosen (T,)."""
        return Targets(self.points_m[chosen])

    def means(self, values: FloatArray) -> FloatArray:
        """Means (n, T) over each target's points, of values (n, T q) at all of them."""
        count, q = self.points_m.shape[:2]
        if q == 1:
            return values
        mean: FloatArray = values.reshape(len(values), count, q).mean(axis=2)
        return mean

    def prior_variance(self, kernel: Kernel) -> FloatArray:
        """Prior variance (T,) of each target under a stationary kernel."""
        if self.points_m.shape[1] == 1:
            return np.full(len(self), kernel.prior_variance)
        apart = self.points_m[:, :, None] - self.points_m[:, None]
        covariances = kernel.of_squared_distance(kernel.squared_length(apart[..., 0], apart[..., 1]))
        variance: FloatArray = covariances.mean(axis=(1, 2))
        return variance

    def moments(self, process: GaussianProcess) -> tuple[FloatArray, FloatArray]:
        """Posterior mean (T,) and standard deviation (T,) [ppb] of the field at each target, or over each block."""
        own, flat = process.hyperparameters, self.points_m.reshape(-1, 2)
        covariance = own.covariance(process.places_m, flat)
        prior, variance = own.prior_mean_ppb(flat), self.prior_variance(own.kernel)
        basis = own.trend_basis(flat)
        if basis is not None:
            over = self.means(basis.T)
            variance = variance + (over * over).sum(axis=0)
        mean = self.means(prior[None])[0]
        if len(process):
            whitened = solve_triangular(process.factor, self.means(covariance), lower=True, check_finite=False)
            mean = mean + own.scale_ppb * (process.whitened @ whitened)
            variance = variance - (whitened * whitened).sum(axis=0)
        least = process.least_variance() if self.points_m.shape[1] == 1 else 0.0
        return mean, own.scale_ppb * np.sqrt(np.maximum(variance, least))


@dataclass(frozen=True, slots=True)
class Certificate:
    """Whether a goal holds, with its figures."""

    std_ppb: float
    """The goal [ppb]."""
    probability: float
    worst_ppb: float
    """Greatest stated standard deviation over the area [ppb]."""
    worst_at_m: tuple[float, float]
    share: float
    """Share of the area whose stated standard deviation is at most the goal."""
    weight: float | None
    """Probability of the hyperparameters under which the goal holds over the whole area; None: not computed."""

    @property
    def holds(self) -> bool:
        """Whether the goal holds."""
        if self.weight is None or self.worst_ppb > self.std_ppb * (1.0 + ROUNDING):
            return False
        return self.weight >= self.probability - ROUNDING

    @property
    def within_ppb(self) -> float:
        """Distance from the map [ppb] within which a share of ``probability`` of the area is promised to lie."""
        return float(ndtri(0.5 + 0.5 * self.probability)) * self.std_ppb


def certify(mixture: ProcessMixture, targets: Targets, std_ppb: float, probability: float) -> Certificate:
    """The certificate of that goal [ppb] over the targets."""
    means, stds = (np.array(each) for each in zip(*map(targets.moments, mixture.processes), strict=True))
    _, stated = mixture_moments(mixture.weights, means, stds)
    most = std_ppb * (1.0 + ROUNDING)
    worst = int(np.argmax(stated))
    x, y = targets.centres_m[worst]
    return Certificate(
        std_ppb=std_ppb,
        probability=probability,
        worst_ppb=float(stated[worst]),
        worst_at_m=(float(x), float(y)),
        share=float(np.mean(stated <= most)),
        weight=min(1.0, float(mixture.weights @ (stds.max(axis=1) <= most))),
    )


def places_of(grid: SiteGrid, area: BoolArray, most: int = MOST_POINTS) -> Targets:
    """At most about that number of the area's cells (rows, columns), evenly spread, as targets.

    Raises InvalidInput for an area without a cell.
    """
    if not area.any():
        raise InvalidInput("expected an area with a cell at least, got none")
    step = max(1, math.isqrt(int(area.sum()) // most))
    while True:
        thinned = np.zeros_like(area)
        lattice = np.ix_(_evenly(grid.rows, step), _evenly(grid.columns, step))
        thinned[lattice] = area[lattice]
        if thinned.sum() <= most:
            break
        step += 1
    if not thinned.any():  # a narrow area between the rows
        thinned = area
    places = (np.argwhere(thinned)[:, ::-1].astype(np.float64) + 0.5) * grid.resolution_m
    return Targets(places[:: -(-len(places) // most), None, :])


def _evenly(count: int, step: int) -> IntArray:
    """About every step-th of that many, the first and the last included, where the least is known."""
    return np.unique(np.linspace(0, count - 1, 1 + -(-(count - 1) // step)).round().astype(np.intp))


def blocks_of(grid: SiteGrid, side_m: float) -> Targets:
    """The blocks of that side [m] into which the site is divided; those at the far edges may be narrower.

    Raises InvalidInput for blocks that are smaller than a cell, larger than the site, or too many.
    """
    if not grid.resolution_m <= side_m <= max(grid.width_m, grid.height_m):
        raise InvalidInput(
            f"expected blocks from a cell of {grid.resolution_m:g} m to the site's "
            f"{max(grid.width_m, grid.height_m):g} m, got {side_m:g} m"
        )
    edges = [np.append(np.arange(0.0, size - 1e-6 * side_m, side_m), size) for size in (grid.width_m, grid.height_m)]
    count = (len(edges[0]) - 1) * (len(edges[1]) - 1)
    if count > MOST_BLOCKS:
        least = math.sqrt(grid.width_m * grid.height_m / MOST_BLOCKS)
        raise InvalidInput(f"expected at most {MOST_BLOCKS} blocks, of {least:.3g} m or more, got {count}")
    a_side = max(1, min(MOST_A_SIDE, math.isqrt(2 * MOST_POINTS // count), round(side_m / grid.resolution_m)))
    inside = (np.arange(a_side) + 0.5) / a_side
    x, y = ((axis[:-1, None] + np.diff(axis)[:, None] * inside) for axis in edges)
    across = np.broadcast_to(x[None, :, None, :], (len(y), len(x), a_side, a_side))
    along = np.broadcast_to(y[:, None, :, None], (len(y), len(x), a_side, a_side))
    return Targets(np.stack((across, along), axis=-1).reshape(-1, a_side * a_side, 2))

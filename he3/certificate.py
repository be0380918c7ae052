"""Whether the map is good enough: the certificate of a goal for its standard deviation over an area.

The area is a set of targets: places, or the means of the field over blocks, each represented by q points of a regular
pattern (block kriging: Journel & Huijbregts 1978). With c the posterior covariance, the variance of a block's mean is

    var = 1/q^2 sum_ij c(x_i, x_j) = 1/q^2 sum_ij k(x_i, x_j) - |L^-1 k(X, block)|^2,
    k(X, block) = 1/q sum_j k(X, x_j)

What is not known of the hyperparameters is counted twice. The *stated* standard deviation is that of the mixture, by
the law of total variance. And the *weight* is the probability of those kernels of the mixture under which the
standard deviation is at most the goal at every target.

Promised is that of the area at least a share of ``probability`` lies within z std of the map, z being the normal
quantile of that probability (1.96 for 0.95). Where each target lies so with that probability, the share of them that
does does is as often below it as above: targets near to each other miss together. So the third figure is the *likely
distance*: that within which such a share of the targets lies with that probability. It is read from draws of the field
at all targets at once, each from one of the mixture's kernels, by their weights, and widened by `UNLIKE`.

All three rest on the field being alike everywhere, which samples in one part of the area cannot show. So the fourth
figure asks where the rover has been, whatever it has found there: of a field as it is thought to be before landing, the
samples are to tell most of the variance at every target.

The certificate holds when the greatest stated standard deviation is at most the goal, the weight at least the
probability, the likely distance at most what is promised, and the variance left of such a field small enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperprior import LENGTH_SCALES
from he3.kernels import SquaredExponential
from he3.local_amplitude import covariances_within, prior_variance_at
from he3.mixture import ProcessMixture, mixture_moments

if TYPE_CHECKING:
    from he3.frames import BoolArray, IntArray
    from he3.kernels import Kernel
    from he3.warping import Warp

ROUNDING = 1e-9  # 1, share by which a standard deviation may exceed the goal
MOST_POINTS = 4096
"""Points by which an area is represented."""
MOST_A_SIDE = 4
"""Points on a side of a block."""
MOST_BLOCKS = 1024
MOST_UNSEEN_PLACE, MOST_UNSEEN_BLOCK = 0.5, 0.2
"""Share of the variance of a field as it is thought to be before landing that may be left at a place, as in a corner of
the site, or of a block's mean. For blocks some 24 samples do, evenly spread over the site; for places some 34."""
MOST_DRAWN, MOST_DRAWN_POINTS = 400, 1600
"""Targets at which the field is drawn, and points of these."""
DRAWS = 1000
"""Of each kernel."""
UNLIKE = 1.3
"""Factor on the distance that draws have: real fields vary more in some parts than in others, and draws do not.
[measured: docs/scenarios.md]"""
_NOISE_BEFORE_LANDING = 0.1  # 1, of that field's standard deviation
_SEED = 23  # of the draws; always the same, so that a certificate follows from the samples
_ROUNDING_OF_DRAWS = 1e-7  # 1, of the field's variance, so that the covariance of close targets has a factor


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Places, or blocks, whose standard deviation is to be low."""

    points_m: FloatArray
    """(T, q, 2) [m]: the points of each target; one for a place."""
    levels_ppb: FloatArray | None = None
    """(T,) the field's mean at each [ppb], for designs where its standard deviation depends on it; None: unknown."""

    def __len__(self) -> int:
        return len(self.points_m)

    @property
    def centres_m(self) -> FloatArray:
        """(T, 2) [m]."""
        centres: FloatArray = self.points_m.mean(axis=1)
        return centres

    @property
    def most_unseen(self) -> float:
        """Share of the variance of a field as it is thought to be before landing that may be left at a target."""
        return MOST_UNSEEN_PLACE if self.points_m.shape[1] == 1 else MOST_UNSEEN_BLOCK

    def only(self, chosen: BoolArray) -> Targets:
        """Those targets that are chosen (T,)."""
        return Targets(self.points_m[chosen], None if self.levels_ppb is None else self.levels_ppb[chosen])

    def thinned(self, most: int) -> Targets:
        """At most that many of the targets, evenly spread over their order, and over columns if they stand in rows."""
        step = self._step(-(-len(self) // most))
        return Targets(self.points_m[::step], None if self.levels_ppb is None else self.levels_ppb[::step])

    def _step(self, least: int) -> int:
        """A step through the targets, little more than the least, that meets most columns in which they stand.

        One that shares a divisor with the number of columns meets few of them, or the first alone.
        """
        x = self.centres_m[:, 0]
        columns = len(np.unique(x))
        for step in range(least, 2 * least):
            chosen = x[::step]
            if 2 * len(np.unique(chosen)) >= min(columns, len(chosen)):
                return step
        return least

    def on_map(self, grid: SiteGrid, mean_ppb: NDArray[np.floating]) -> Targets:
        """The same at the levels of a map (rows, columns) [ppb]."""
        rows, columns = grid.cells_of(self.points_m.reshape(-1, 2))
        return Targets(self.points_m, self.means(mean_ppb[rows, columns].astype(np.float64)[None])[0])

    def means(self, values: FloatArray) -> FloatArray:
        """Means (n, T) over each target's points, of values (n, T q) at all of them."""
        count, q = self.points_m.shape[:2]
        if q == 1:
            return values
        mean: FloatArray = values.reshape(len(values), count, q).mean(axis=2)
        return mean

    def prior_variance(self, kernel: Kernel) -> FloatArray:
        """Prior variance (T,) of each target, without a trend's."""
        if self.points_m.shape[1] == 1:
            return prior_variance_at(kernel, self.points_m[:, 0])
        variance: FloatArray = covariances_within(kernel, self.points_m).mean(axis=(1, 2))
        return variance

    def moments(self, process: GaussianProcess) -> tuple[FloatArray, FloatArray]:
        """Posterior mean (T,) and standard deviation (T,) [ppb] of the field at each target, or over each block."""
        if process.hyperparameters.warp is not None:
            return self._warped_moments(process, process.hyperparameters.warp)
        own, flat = process.hyperparameters, self.points_m.reshape(-1, 2)
        covariance = own.covariance(process.places_m, flat)
        prior, variance = own.prior_mean_ppb(flat), self.prior_variance(own.kernel)
        basis = own.trend_basis(flat)
        if basis is not None:
            over = self.means(basis.T)
            variance = variance + (over * over).sum(axis=0)
        mean = self.means(prior[None])[0]
        if len(process):
            whitened = process.solve(self.means(covariance))
            mean = mean + own.scale_ppb * (process.whitened @ whitened)
            variance = variance - (whitened * whitened).sum(axis=0)
        least = process.least_variance() if self.points_m.shape[1] == 1 else 0.0
        return mean, own.scale_ppb * np.sqrt(np.maximum(variance, least))

    def _warped_moments(self, process: GaussianProcess, warp: Warp) -> tuple[FloatArray, FloatArray]:
        """The same of a process with a warp: over a block, from the joint moments of its points."""
        mean, std = process.predict_latent(self.points_m.reshape(-1, 2))
        shape = self.points_m.shape[:2]
        mean, variance = mean.reshape(shape), (std * std).reshape(shape)
        if shape[1] == 1:
            of_field, within = warp.moments(mean[:, 0], variance[:, 0])
            return of_field, np.sqrt(within)
        among = process.posterior_covariances(self.points_m)
        np.einsum("tii->ti", among)[:] = variance
        covariances = warp.covariance(
            mean[:, :, None], variance[:, :, None], mean[:, None, :], variance[:, None, :], among
        )
        over: FloatArray = covariances.mean(axis=(1, 2))
        return warp.mean(mean, variance).mean(axis=1), np.sqrt(np.maximum(over, 0.0))

    def drawn(self, process: GaussianProcess, warp: Warp, draws: FloatArray) -> FloatArray:
        """Draws (n, T) [ppb] of the field at all targets at once, or of its means over blocks, through that warp.

        draws: (n, T q) standard normal ones.
        """
        flat = self.points_m.reshape(-1, 2)
        covariance = process.latent_covariance(flat)
        covariance.flat[:: len(flat) + 1] += _ROUNDING_OF_DRAWS * process.hyperparameters.field_std_ppb**2
        latent = process.predict_latent(flat)[0] + draws @ np.linalg.cholesky(covariance).T
        return self.means(warp.field(latent))

    def covariance(self, process: GaussianProcess) -> FloatArray:
        """Posterior covariance (T, T) [ppb^2] of the field among the targets, or of its means over blocks."""
        count, q = self.points_m.shape[:2]
        covariance = process.posterior_covariance(self.points_m.reshape(-1, 2))
        if q > 1:
            covariance = covariance.reshape(count, q, count, q).mean(axis=(1, 3))
        return covariance


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
    likely_ppb: float
    """Distance from the map [ppb] within which a share of ``probability`` of the area lies with that probability."""
    unseen: float
    """Greatest share that is left of the variance of a field as it is thought to be before landing."""
    most_unseen: float
    """The share that may be left."""

    @property
    def holds(self) -> bool:
        """Whether the goal holds."""
        if self.weight is None or self.worst_ppb > self.std_ppb * (1.0 + ROUNDING):
            return False
        seen = self.unseen <= self.most_unseen * (1.0 + ROUNDING)
        return seen and self.weight >= self.probability - ROUNDING and self.likely_ppb <= self.within_ppb

    @property
    def aim_ppb(self) -> float:
        """Greatest standard deviation [ppb], at most the goal, at which the likely distance is what is promised.

        As far as the two fall in proportion.
        """
        normal = self.within_ppb / self.std_ppb * self.worst_ppb
        return self.std_ppb * min(1.0, normal / self.likely_ppb)

    @property
    def within_ppb(self) -> float:
        """Distance from the map [ppb] within which a share of ``probability`` of the area is promised to lie."""
        return float(ndtri(0.5 + 0.5 * self.probability)) * self.std_ppb


def certify(
    mixture: ProcessMixture, targets: Targets, std_ppb: float, probability: float, extent_m: float
) -> Certificate:
    """The certificate of that goal [ppb] over the targets. extent_m: width of the site."""
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
        weight=_weight(mixture, stds, most),
        likely_ppb=likely_distance(mixture, targets, probability),
        unseen=unseen_share(mixture.processes[0].places_m, targets, extent_m),
        most_unseen=targets.most_unseen,
    )


def certified_weight(mixture: ProcessMixture, targets: Targets, std_ppb: float) -> float:
    """Probability of the kernels under each of which the standard deviation is at most that [ppb] at every target."""
    stds = np.array([targets.moments(process)[1] for process in mixture.processes])
    return _weight(mixture, stds, std_ppb * (1.0 + ROUNDING))


def _weight(mixture: ProcessMixture, stds: FloatArray, most: float) -> float:
    return min(1.0, float(mixture.weights @ (stds.max(axis=1) <= most)))


def thought_before_landing(targets: Targets, std_ppb: float, extent_m: float) -> Hyperparameters:
    """A field as it is thought to be before landing on a site of that width.

    It is scaled so that samples which tell enough of its variance leave that standard deviation [ppb] at a target.
    """
    kernel = SquaredExponential(1.0, LENGTH_SCALES["length_scale_m"][0] * extent_m)
    scale_ppb = std_ppb / math.sqrt(targets.most_unseen * float(targets.prior_variance(kernel).min()))
    return Hyperparameters(kernel, _NOISE_BEFORE_LANDING * scale_ppb, 0.0, scale_ppb)


def unseen_share(places_m: FloatArray, targets: Targets, extent_m: float) -> float:
    """Greatest share over the targets that samples at places (n, 2) [m] leave of such a field's variance."""
    field = GaussianProcess(thought_before_landing(targets, 1.0, extent_m)).condition_on_places(places_m)
    return targets.most_unseen * float(targets.moments(field)[1].max()) ** 2


def likely_distance(mixture: ProcessMixture, targets: Targets, probability: float) -> float:
    """Distance [ppb] from the mixture's mean within which a share of that probability of the targets lies, with it.

    At most `MOST_DRAWN` of the targets are looked at, evenly spread over them.
    """
    drawn = targets.thinned(min(MOST_DRAWN, MOST_DRAWN_POINTS // targets.points_m.shape[1]))
    means = np.array([drawn.moments(process)[0] for process in mixture.processes])
    middle = mixture.weights @ means
    rng = np.random.default_rng(_SEED)
    rank = min(len(drawn), math.ceil(probability * len(drawn) - ROUNDING)) - 1
    distances = []
    for process, mean in zip(mixture.processes, means, strict=True):
        if (warp := process.hyperparameters.warp) is not None:
            points = rng.standard_normal((DRAWS, drawn.points_m.shape[0] * drawn.points_m.shape[1]))
            missed = np.abs(drawn.drawn(process, warp, points) - middle)
            distances.append(np.partition(missed, rank, axis=1)[:, rank])
            continue
        covariance = drawn.covariance(process)
        covariance.flat[:: len(drawn) + 1] += _ROUNDING_OF_DRAWS * process.hyperparameters.field_std_ppb**2
        missed = np.abs(mean - middle + rng.standard_normal((DRAWS, len(drawn))) @ np.linalg.cholesky(covariance).T)
        distances.append(np.partition(missed, rank, axis=1)[:, rank])
    flat = np.concatenate(distances)
    order = np.argsort(flat, kind="stable")
    summed = np.cumsum(np.repeat(mixture.weights / DRAWS, DRAWS)[order])
    return UNLIKE * float(flat[order[min(len(flat) - 1, int(np.searchsorted(summed, probability)))]])


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
    return Targets(places[:, None, :]).thinned(most)


def _evenly(count: int, step: int) -> IntArray:
    """About every step-th of that many, the first and the last included, where the least is known."""
    return np.unique(np.linspace(0, count - 1, 1 + -(-(count - 1) // step)).round().astype(np.intp))


def blocks_of(grid: SiteGrid, side_m: float) -> Targets:
    """The blocks of that side [m] into which the site is divided; those at the far edges may be narrower.

    Raises InvalidInput for blocks that are smaller than a cell, larger than the site, or too many.
    """
    if not grid.resolution_m <= side_m <= grid.extent_m:
        raise InvalidInput(
            f"expected blocks from a cell of {grid.resolution_m:g} m to the site's "
            f"{grid.extent_m:g} m, got {side_m:g} m"
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

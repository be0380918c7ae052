"""The helium-3 in an area: mean and standard deviation of its average under the joint posterior of all its cells.

The errors of neighbouring cells are correlated, so the spread of an average is not that of independent cells. With w
the weights of the cells (each 1/N), K the prior covariance, X the samples and L the Cholesky factor of their covariance
plus noise,

    mean = w' m,      variance = w' K w - |L^-1 K(X, cells) w|^2             (Rasmussen & Williams 2006, eq. 2.26)

and, because the constant mean of the field is itself estimated from the samples (unless a trend contains it), its
uncertainty under a vague prior, propagated to the average (eq. 2.42 with H = 1):

    + (1 - 1' K_X^-1 K(X, cells) w)^2 / (1' K_X^-1 1)

Where the hyperparameters have alternatives (``he3.mixture``), the variance is the mean of their variances and the
variance of their means, by the law of total variance. Under an alternative with a warp T (``he3.warping``), the
covariance differs from place to place, and the variance is summed over pairs of blocks, with u the latent field there:

    mean = sum w_i E T(u_i),      variance = sum w_i w_j Cov(T(u_i), T(u_j))      (closed forms)

The first term needs no sum over pairs of cells: a stationary covariance depends on the offset alone, and the number of
pairs at each offset is the autocorrelation of the area's mask (by FFT). The second term is integrated over blocks of
cells, each represented by the centre of its cells; its error is estimated from blocks twice as wide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2

from he3.errors import InvalidInput
from he3.local_amplitude import LocallyScaled, even_kernel
from he3.mixture import ProcessMixture, mixture_moments

if TYPE_CHECKING:
    from he3.frames import BoolArray, FloatArray, SiteGrid
    from he3.gp import GaussianProcess

MAX_NODES = 6000  # 1, blocks over which the correlation with the samples is integrated: 0.1 s with 150 samples
MAX_DRAWN_NODES = 700  # 1, blocks of a joint draw, whose eigendecomposition takes 0.1 s
MAX_WARPED_NODES = 1200  # 1, blocks whose covariances through a warp are summed: 0.1 s for each alternative


@dataclass(frozen=True, slots=True)
class AreaMean:
    """Mean of the field over an area [ppb] and its standard deviation, with the error of the integration."""

    mean_ppb: float
    std_ppb: float
    cells: int
    spacing_m: float
    """Side of the blocks of cells [m]."""
    std_error_ppb: float
    """Change of the standard deviation [ppb] when the blocks are twice as wide."""


def area_mean(process: GaussianProcess, grid: SiteGrid, mean_ppb: NDArray[np.floating], area: BoolArray) -> AreaMean:
    """The mean of the field over the cells of ``area`` (rows, columns).

    mean_ppb: the posterior mean (rows, columns) [ppb]. Raises InvalidInput for shapes that do not fit or an area
    without a cell.
    """
    if area.shape != grid.shape or mean_ppb.shape != grid.shape:
        raise InvalidInput(f"expected maps of shape {grid.shape}, got {area.shape} and {mean_ppb.shape}")
    cells = int(area.sum())
    if cells == 0:
        raise InvalidInput("expected an area that contains the centre of at least one cell, got one that contains none")
    block = max(1, math.ceil(math.sqrt(cells / MAX_NODES)))
    mixture = ProcessMixture.of(process)
    lags = _pairs_at_lags(grid, area)
    prior = [_prior_of_average(each, grid, area, *lags) for each in mixture.processes]
    std = _std_of_mean(mixture, prior, grid, area, block, 1)
    exact = block == 1 and (
        cells <= MAX_WARPED_NODES or all(one.hyperparameters.warp is None for one in mixture.processes)
    )
    coarser = std if exact else _std_of_mean(mixture, prior, grid, area, block, 2)
    scale = process.hyperparameters.scale_ppb
    return AreaMean(
        mean_ppb=float(mean_ppb[area].mean(dtype=np.float64)),
        std_ppb=scale * (std + abs(std - coarser)),
        cells=cells,
        spacing_m=block * grid.resolution_m,
        std_error_ppb=scale * abs(std - coarser),
    )


def share_above(
    process: GaussianProcess, grid: SiteGrid, area: BoolArray, cutoff_ppb: float, rng: np.random.Generator, draws: int
) -> FloatArray:
    """Share of the area above the cut-off (draws,), in fields drawn from the joint posterior."""
    fields, weights = drawn_fields(process, grid, area, rng, draws)
    shares: FloatArray = (fields > cutoff_ppb) @ weights
    return shares


def grade_tonnage(
    fields_ppb: FloatArray, weights: FloatArray, cutoffs_ppb: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Share of an area above each cut-off, and the mean abundance there [ppb], both (draws, m), of each drawn field.

    fields_ppb: (draws, k) at blocks with these shares of the area (k,), as ``drawn_fields`` gives both. The mean is NaN
    in a field with no ground above the cut-off.
    """
    order = np.argsort(fields_ppb, axis=1)
    ranked = np.take_along_axis(fields_ppb, order, axis=1)
    shares = weights[order]
    # Sums over the ground above, from the richest block down; of no block, zero.
    area, amount = (_summed_from_the_end(each) for each in (shares, shares * ranked))
    area = np.minimum(area, 1.0)
    first = np.array([np.searchsorted(row, cutoffs_ppb, side="right") for row in ranked])
    above, total = np.take_along_axis(area, first, axis=1), np.take_along_axis(amount, first, axis=1)
    with np.errstate(invalid="ignore"):
        return above, np.where(first < ranked.shape[1], total / above, np.nan)


def _summed_from_the_end(values: FloatArray) -> FloatArray:
    """The sums (draws, k + 1) of the values (draws, k) from each one on; the last is zero."""
    sums = np.cumsum(values[:, ::-1], axis=1)[:, ::-1]
    return np.concatenate((sums, np.zeros((len(values), 1))), axis=1)


def drawn_fields(
    process: GaussianProcess, grid: SiteGrid, area: BoolArray, rng: np.random.Generator, draws: int
) -> tuple[FloatArray, FloatArray]:
    """Fields (draws, k) [ppb] drawn from the joint posterior at k blocks of cells, and the blocks' area shares (k,).

    The estimated constant mean is drawn too, as ``area_mean`` counts it. Patches smaller than a block are not resolved.
    Under a mixture, the draws are normal with its mean and covariance; where one of its processes has a warp, each draw
    is of one process, by their weights.
    """
    block = max(1, math.ceil(math.sqrt(int(area.sum()) / MAX_DRAWN_NODES)))
    places, weights = _nodes(grid, area, block)
    mixture = ProcessMixture.of(process)
    if any(one.hyperparameters.warp is not None for one in mixture.processes):
        return _drawn_of_each(mixture, places, rng, draws), weights
    mean, _ = mixture.predict(places)
    covariance = mixture.posterior_covariance(places)
    if len(process):
        crossing = process.hyperparameters.covariance(process.places_m, places)
        unknown = process.hyperparameters.scale_ppb * of_constant(process, process.solve(crossing))
        covariance += np.outer(unknown, unknown)
    return mean + _normal_draws(covariance, rng, draws), weights


def _drawn_of_each(mixture: ProcessMixture, places: FloatArray, rng: np.random.Generator, draws: int) -> FloatArray:
    """Draws (draws, k) [ppb] of the field at places (k, 2) [m], each of one of the processes, by their weights."""
    fields = []
    for process, count in zip(mixture.processes, rng.multinomial(draws, mixture.weights), strict=True):
        drawn = process.predict_latent(places)[0] + _normal_draws(process.latent_covariance(places), rng, int(count))
        warp = process.hyperparameters.warp
        fields.append(drawn if warp is None else warp.field(drawn))
    return np.vstack(fields)


def _normal_draws(covariance: FloatArray, rng: np.random.Generator, draws: int) -> FloatArray:
    """Draws (draws, k) of a normal distribution about 0 with that covariance (k, k)."""
    # Rounding may leave eigenvalues slightly below zero; clipping them changes no share visibly.
    values, vectors = np.linalg.eigh(covariance)
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn: FloatArray = rng.standard_normal((draws, len(covariance))) @ half.T
    return drawn


def _nodes(grid: SiteGrid, area: BoolArray, block: int) -> tuple[FloatArray, FloatArray]:
    """Blocks of cells as places (k, 2) [m], each the centroid of its cells in the area, and their area shares (k,)."""
    rows, columns = np.nonzero(area)
    across = -(-grid.columns // block)
    blocks = (rows // block) * across + columns // block
    _, index, counts = np.unique(blocks, return_inverse=True, return_counts=True)
    x = np.bincount(index, weights=(columns + 0.5) * grid.resolution_m) / counts
    y = np.bincount(index, weights=(rows + 0.5) * grid.resolution_m) / counts
    return np.column_stack((x, y)), counts / counts.sum()


def _pairs_at_lags(
    grid: SiteGrid, area: BoolArray, weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How many pairs of the area's cells lie at each lag (N, M), and the lags north (N, 1) and east (1, M) [m].

    weights: of the cells of the area, (rows, columns); a pair then counts as the product of its two. None: all are 1.
    """
    rows, columns = np.flatnonzero(area.any(axis=1)), np.flatnonzero(area.any(axis=0))
    counted = area.astype(np.float64) if weights is None else np.where(area, weights, 0.0)
    mask = counted[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    shape = tuple(next_fast_len(2 * size, real=True) for size in mask.shape)
    spectrum = rfft2(mask, shape)
    pairs = np.maximum(irfft2(spectrum * spectrum.conj(), shape), 0.0)
    lags = [(np.arange(size) - size * (2 * np.arange(size) > size)) * grid.resolution_m for size in shape]
    return pairs, lags[0][:, None], lags[1][None, :]


@dataclass(frozen=True, slots=True, eq=False)
class _Prior:
    """Of the average before any sample, by every cell of the area, in standardised units."""

    variance: float
    basis: FloatArray | None
    """Average (p,) of the trend's columns; None without a trend."""


def _prior_of_average(
    process: GaussianProcess,
    grid: SiteGrid,
    area: BoolArray,
    pairs: FloatArray,
    north_m: FloatArray,
    east_m: FloatArray,
) -> _Prior:
    """w' K w over all pairs of cells. pairs and lags [m]: those of ``_pairs_at_lags``."""
    hyperparameters = process.hyperparameters
    kernel = even_kernel(hyperparameters.kernel)
    covariance = kernel.of_squared_distance(kernel.squared_length(east_m, north_m))
    if isinstance(hyperparameters.kernel, LocallyScaled):
        amplitude = hyperparameters.kernel.amplitude.at(grid.points()).reshape(grid.shape)
        pairs, _, _ = _pairs_at_lags(grid, area, amplitude)
    total: float = float((pairs * covariance).sum()) / float(area.sum()) ** 2
    basis = hyperparameters.trend_basis(grid.points()[area.ravel()])
    if basis is None:
        return _Prior(total, None)
    average: FloatArray = basis.mean(axis=0)
    return _Prior(total + float((average**2).sum()), average)


def _std_of_mean(
    mixture: ProcessMixture, prior: list[_Prior], grid: SiteGrid, area: BoolArray, block: int, times: int
) -> float:
    """Standard deviation of the average in standardised units. prior: of each process, before any sample.

    It is integrated over blocks of ``block`` cells a side, or as many as a warp allows, times ``times``.
    """
    nodes = [_nodes(grid, area, times * block * wider) for wider in ((1,) if times * block == 1 else (1, 2))]
    widest = max(block, math.ceil(math.sqrt(int(area.sum()) / MAX_WARPED_NODES)))
    means, variances = [], []
    for process, before in zip(mixture.processes, prior, strict=True):
        if process.hyperparameters.warp is not None:
            moved, variance = _through_warp(process, *_nodes(grid, area, times * widest))
        else:
            moved, explained = _learned(process, nodes, before.basis)
            variance = max(before.variance - explained, _least_variance(process, before.variance))
        means.append(moved)
        variances.append(variance)
    return float(mixture_moments(mixture.weights, np.array(means), np.sqrt(variances))[1])


def _through_warp(process: GaussianProcess, places: FloatArray, weights: FloatArray) -> tuple[float, float]:
    """How far the average lies from the mean that is thought of before any sample, and its variance.

    Of a process with a warp, over blocks at places (k, 2) [m] with these shares of the area (k,), in standardised
    units.
    """
    own = process.hyperparameters
    mean = float(weights @ process.predict(places)[0])
    variance = float(weights @ process.posterior_covariance(places) @ weights)
    return (mean - own.mean_ppb) / own.scale_ppb, max(0.0, variance) / own.scale_ppb**2


def _least_variance(process: GaussianProcess, prior: float) -> float:
    """Variance that is left of a number with that prior variance when every sample measures it, in standardised units.

    Where the terms of a smooth process cancel within the error of the integration, no smaller variance is returned.
    """
    own = process.hyperparameters
    left: float = prior / (1.0 + len(process) * prior * own.scale_ppb**2 / own.noise_variance_ppb2)
    return left


def _learned(
    process: GaussianProcess, nodes: list[tuple[FloatArray, FloatArray]], basis: FloatArray | None
) -> tuple[float, float]:
    """How far the samples move the average from its expectation, and the variance that they explain of it.

    The latter is less what the unknown constant adds; both are in standardised units. nodes: places and weights of the
    blocks of cells; a second entry has those of blocks twice as wide, by which the first are corrected. basis: average
    (p,) of the trend's columns over all cells, since the layers of a trend may differ from cell to cell.
    """
    if len(process) == 0:
        return 0.0, 0.0
    own = process.hyperparameters
    crossing, *coarser = (own.kernel.covariance(process.places_m, places) @ weights for places, weights in nodes)
    for wider in coarser:
        crossing = (4.0 * crossing - wider) / 3.0
    of_samples = own.trend_basis(process.places_m)
    if of_samples is not None:
        assert basis is not None
        crossing = crossing + of_samples @ basis
    whitened = process.solve(crossing)
    explained = float(whitened @ whitened) - float(of_constant(process, whitened)) ** 2
    return float(whitened @ process.whitened), explained


def of_constant(process: GaussianProcess, whitened: FloatArray) -> FloatArray:
    """Change () or (k,) of a quantity when the estimated constant changes by one standard deviation.

    whitened: the quantity's whitened covariances with the samples, (n,) or (n, k), n >= 1. In standardised units; 0 if
    the trend contains the constant.
    """
    if process.hyperparameters.trend is not None:
        return np.zeros(whitened.shape[1:])
    ones = process.solve(np.ones(len(process)))
    moved: FloatArray = (1.0 - ones @ whitened) / math.sqrt(ones @ ones)
    return moved

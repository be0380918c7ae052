"""Central intervals of a mixture some of whose parts have a warp (``he3.warping``), cell by cell.

As ``he3.intervals``, but with the distribution of a part that has the warp T: its quantiles solve

    sum w_i Phi((T_i^-1(end) - m_i) / s_i) = (1 -+ probability) / 2

with m_i and s_i of the latent field, and T_i the identity for a part without a warp. They need not lie evenly about the
mean.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from he3.intervals import Intervals
from he3.mixture import mixture_moments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from he3.frames import FloatArray, SiteGrid
    from he3.warping import Warp

_STEPS = 40  # halvings of what lies between the least and the greatest quantile of the parts
_CLOSE = 1e-3  # 1, standard deviations: error of an end


def warped_intervals(
    grid: SiteGrid,
    weights: FloatArray,
    latent_means: NDArray[np.floating],
    latent_stds: NDArray[np.floating],
    warps: Sequence[Warp | None],
    levels: FloatArray,
) -> Intervals:
    """Those of a mixture with these weights (K,) and warps (K,); see ``warped_ends``.

    latent_means, latent_stds: (K, rows, columns) [ppb] on the grid. levels: (4,).
    """
    means, stds = (moments.reshape(len(weights), -1).astype(np.float64) for moments in (latent_means, latent_stds))
    found = warped_ends(weights, means, stds, warps, levels).reshape(-1, *grid.shape).astype(np.float32)
    found.setflags(write=False)
    return Intervals(grid, found)


def warped_ends(
    weights: FloatArray,
    latent_means: FloatArray,
    latent_stds: FloatArray,
    warps: Sequence[Warp | None],
    levels: FloatArray,
) -> FloatArray:
    """Quantiles (L, m) of a mixture at m places, in its standard deviations from its mean.

    weights: (K,), their sum is 1. latent_means and latent_stds: (K, m) [ppb] of the parts, stds positive. warps: (K,).
    levels: (L,), a quantile is at the probability that a standard normal variable is below its level.
    """
    parts = list(zip(latent_means, latent_stds, warps, strict=True))
    means, stds = latent_means.copy(), latent_stds.copy()
    for number, (mean, std, warp) in enumerate(parts):
        if warp is not None:
            means[number], variance = warp.moments(mean, std * std)
            stds[number] = np.sqrt(variance)
    middle, spread = mixture_moments(weights, means, stds)
    wanted = levels[:, None]
    # A quantile of the mixture lies between the least and the greatest of those of its parts.
    of_parts = [mean + std * wanted if warp is None else warp.field(mean + std * wanted) for mean, std, warp in parts]
    low, high = np.min(of_parts, axis=0), np.max(of_parts, axis=0)
    level = ndtr(wanted)
    for _ in range(_STEPS):
        tried = 0.5 * (low + high)
        below = sum(
            weight * ndtr(((tried if warp is None else warp.latent(tried)) - mean) / std)
            for weight, (mean, std, warp) in zip(weights, parts, strict=True)
        )
        low, high = np.where(below < level, tried, low), np.where(below < level, high, tried)
        if float(((high - low) / spread).max()) < _CLOSE:
            break
    ends: FloatArray = (0.5 * (low + high) - middle) / spread
    return ends

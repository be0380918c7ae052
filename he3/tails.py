"""How far the ends of intervals lie on the field at hand, learned from each sample given the others.

A mixture of Gaussian processes is a model of the field; real geology has more of both, ground that hardly differs from
its neighbours' and steps between units. Then the middle of a map's intervals is too wide and their tails are too short,
whatever the kernel. The samples show it: with F the distribution of sample i given all others, in closed form
(``he3.kernel_families.left_out``),

    u_i = Phi^-1(F(y_i))

are standard normal where the model describes the field. What they are instead is taken as sigma T, with T of Student's
distribution with nu degrees of freedom. Both are uncertain, on a grid: all nu equally probable before any sample, and
log sigma normal about 0. The ends of the intervals are then the quantiles of the model at

    Phi(t),      t the quantile of sigma T, averaged over the posterior of nu and sigma

in place of 1 and 2 standard deviations. Many samples of a Gaussian field bring t back to these.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import gammaln, ndtr, ndtri, stdtr

from he3.kernel_families import left_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from he3.frames import FloatArray
    from he3.gp import GaussianProcess

DEGREES = np.array([1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0, 1e6])
"""Of freedom, from heavy tails to normal ones. At 2 and below no variance is finite; only quantiles are asked for."""
SCALE_FACTOR = 0.2  # 1, standard deviation of log sigma before any sample [assumed]
SCALES = np.exp(SCALE_FACTOR * np.linspace(-3.0, 3.0, 13))
FARTHEST = 1e-9  # 1, probability beyond which a sample counts as that far out
_STEPS = 40  # halvings of the search for a quantile


def residuals(weights: FloatArray, processes: Sequence[GaussianProcess], count: int) -> FloatArray:
    """The normal scores u (count,) of the first samples, each given the others, under a mixture of weights (K,).

    The weights are those given all samples: the few kernels of a mixture stand for moments at places, so they cannot
    be weighed without one of the samples.
    """
    if count == 0:
        return np.zeros(0)  # LAPACK refuses a factor without a row, and says so on the terminal
    found = [left_out(one.factor[:count, :count], one.whitened[:count]) for one in processes]
    return normal_scores(weights, np.array(found))


def normal_scores(weights: FloatArray, found: FloatArray) -> FloatArray:
    """The normal scores (n,) under a mixture of weights (K,). found: (K, 2, n), ``left_out`` of each process."""
    away, variances = found.swapaxes(0, 1)
    below = weights @ ndtr(away / np.sqrt(variances))
    scores: FloatArray = ndtri(np.clip(below, FARTHEST, 1.0 - FARTHEST))
    return scores


def interval_levels(scores: FloatArray, normal: Sequence[float]) -> FloatArray:
    """Where the positive ends ``normal`` (k,) [standard deviations] of a normal distribution's intervals are to lie.

    scores: (n,), ``residuals``; none are no evidence.
    """
    degrees, scales = (each.ravel() for each in np.meshgrid(DEGREES, SCALES, indexing="ij"))
    scaled = scores[:, None] / scales
    log_density = (
        gammaln(0.5 * (degrees + 1.0)) - gammaln(0.5 * degrees) - 0.5 * np.log(np.pi * degrees) - np.log(scales)
        - 0.5 * (degrees + 1.0) * np.log1p(scaled * scaled / degrees)
    )  # fmt: skip
    log_weights = log_density.sum(axis=0) - 0.5 * (np.log(scales) / SCALE_FACTOR) ** 2
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    wanted = ndtr(np.array(normal))
    low, high = np.zeros(len(wanted)), np.full(len(wanted), 100.0)
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        short = stdtr(degrees, middle[:, None] / scales) @ weights < wanted
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    ends: FloatArray = 0.5 * (low + high)
    return ends

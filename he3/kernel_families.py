"""How much each family of kernels counts where the kernel is "auto": by how well it predicts samples from the others.

No family is picked. The evidence is a poor judge of families none of which is the field's own: on an even lattice it
speaks for smooth kernels, whose maps are too certain (``he3.hyperparameters``). What a map is for is prediction, and
that is judged by each sample given all others, the family's own parameters learned without it, too. Under parameters
theta with the posterior weight w, and with K the covariance of all samples, noise included, in closed form
(Sundararajan & Keerthi 2001)

    y_i | theta, y_-i  ~  N(y_i - [K^-1 y]_i / [K^-1]_ii,  1 / [K^-1]_ii)

and the weight of theta without the sample is in proportion to w / p(y_i | theta, y_-i) (Gelfand, Dey & Chang 1992). A
map has a mean and a standard deviation, so what counts is the normal density with the mean and variance of the mixture
over theta. A family's weight is its prior weight times the product of these densities to the power of ``POWER``
(pseudo-BMA: Yao, Vehtari, Simpson & Gelman 2018). With a power of 1 one family would soon have all of the weight,
though neighbouring samples are no independent witnesses; with 0 none would be learned.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import lapack

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from he3.frames import FloatArray

PRIOR_WEIGHTS = {"smooth+rough": 1.0, "matern12": 0.6, "matern32": 0.3, "matern52": 0.04, "se": 0.003}
"""1, of each family. The smoother a kernel, the less it leaves unknown between samples, and of what varies there the
samples say next to nothing unless some of them are close together [chosen on 24 pieces of other fields than the exam's:
docs/uncertainty.md]."""
POWER = 0.1
"""1, of the samples' densities. With 0.2, now and then a smooth kernel had most of the weight on a rough field, and the
map was too certain [chosen with the weights]."""


def left_out(factor: NDArray[np.floating], whitened: FloatArray) -> FloatArray:
    """What each of n samples is found to be given the others: by how much it lies above the mean, and variances (2, n).

    factor: lower Cholesky factor L (n, n) of their covariance, noise included. whitened: L^-1 z (n,), z their values
    less the mean.
    """
    inverse, _ = lapack.dtrtri(factor, lower=1)
    variances = 1.0 / (inverse * inverse).sum(axis=0)  # one over the diagonal of K^-1
    return np.stack((whitened @ inverse * variances, variances))


def log_predictive(log_weights: FloatArray, found: FloatArray, judged: FloatArray | None = None) -> float:
    """The sum over all samples of the log density of each given the others, under all of N kernels.

    log_weights: (N,) of the kernels given all samples. found: (N, 2, n), ``left_out`` of each. judged: the same in the
    unit in which the density counts, where that is another one because the field is warped.
    """
    away, variances = found[:, 0], found[:, 1]
    log_densities = -0.5 * (np.log(2.0 * math.pi * variances) + away * away / variances)
    log_without = log_weights[:, None] - log_densities
    weights = np.exp(log_without - log_without.max(axis=0, initial=-np.inf))
    weights /= weights.sum(axis=0)
    if judged is not None:
        away, variances = judged[:, 0], judged[:, 1]
    mean = (weights * away).sum(axis=0)
    variance = (weights * (variances + (away - mean) ** 2)).sum(axis=0)
    return float(-0.5 * (np.log(2.0 * math.pi * variance) + mean * mean / variance).sum())


def log_family_weights(names: Sequence[str], predictive: Sequence[float]) -> FloatArray:
    """Logarithms (F,) of the families' weights, whose sum is 1. predictive: (F,), ``log_predictive`` of each."""
    together = np.log([PRIOR_WEIGHTS[name] for name in names]) + POWER * np.array(predictive)
    return np.asarray(together - np.logaddexp.reduce(together), dtype=np.float64)

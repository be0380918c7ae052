"""How much room each of a trend's layers gets: as much as the samples speak for, and next to none without that.

A layer of which nothing is known may have nothing to do with the field, and then a weight of its own costs accuracy as
long as samples are few. Or the field may follow it closely, and then the weight is far beyond what a narrow prior
allows. So the prior standard deviation of each weight is taken as one of a few multiples m of the trend's own, 0 among
them, and what is used is the mean of m over its posterior. With the kernel given, and A the covariance of the samples,
the column b of a layer times m changes the logarithm of the evidence by

    1/2 m^2 (b' A^-1 z)^2 / (1 + m^2 b' A^-1 b) - 1/2 log(1 + m^2 b' A^-1 b)

(matrix determinant lemma, and the formula of Sherman & Morrison). Layers are taken one after the other, the most
probable first, and those taken belong to A. The detail of a layer, which may be its instrument's noise, is judged after
its wide features, and with less odds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

if TYPE_CHECKING:
    from he3.frames import BoolArray, FloatArray

MULTIPLES = (1.0 / 3.0, 1.0, 3.0, 10.0)
"""Of the standard deviation that a trend gives the weights' priors."""
LOG_ODDS = -1.5  # 1, that a layer says something of the field, before any sample [measured]
LOG_ODDS_OF_DETAIL = -7.0  # 1, the same for its detail [measured]
LEAST_PROBABILITY = 0.05  # 1, below which a layer is left out
LEAST_OF_WIDE = 0.5  # 1, multiple of a layer's wide features below which its detail is left out


def chosen_shares(
    covariance: FloatArray, z: FloatArray, basis: FloatArray, shares: FloatArray, judged: BoolArray, log_odds: float
) -> tuple[float, ...]:
    """The multiple (k,) of each layer's prior standard deviation, 0 for one that is left out.

    covariance: of the samples (n, n) but for the trend, noise included. z: (n,) standardised values. basis: (n, p)
    columns of the trend, of which the first k are the layers'. shares: (k,) multiples of the layers that are not judged
    (k,). log_odds: that a judged one says something of the field, before any sample.
    """
    layers = len(judged)
    shares = np.where(judged, 0.0, shares)
    always = basis * np.append(shares, np.ones(basis.shape[1] - layers))
    factor = np.linalg.cholesky(covariance + always @ always.T)
    columns = solve_triangular(factor, np.column_stack((z, basis[:, :layers])), lower=True, check_finite=False)
    products = columns[:, 1:].T @ columns
    with_z, among = products[:, 0], products[:, 1:]
    multiples = np.array(MULTIPLES)[:, None]
    waiting = judged.copy()
    while waiting.any():
        variances = multiples**2 * np.maximum(among.diagonal(), 0.0)
        log_weights = 0.5 * (multiples * with_z) ** 2 / (1.0 + variances) - 0.5 * np.log1p(variances)
        log_weights += log_odds - np.log(len(multiples))
        total = np.logaddexp.reduce(log_weights, axis=0)
        probability = np.exp(total - np.logaddexp(total, 0.0))
        first = int(np.argmax(np.where(waiting, probability, -1.0)))
        if probability[first] < LEAST_PROBABILITY:
            break
        waiting[first] = False
        mean = float(np.exp(log_weights[:, first] - total[first]) @ multiples[:, 0])
        shares[first] = mean * probability[first]
        square = shares[first] ** 2
        taken = square / (1.0 + square * max(float(among[first, first]), 0.0))
        with_z = with_z - taken * with_z[first] * among[:, first]
        among = among - taken * np.outer(among[:, first], among[first])
    return tuple(float(share) for share in shares)


def in_shares(basis: FloatArray, shares: tuple[float, ...]) -> FloatArray:
    """Columns (n, p) of a trend, the first k times their shares (k,), those with a share of 0 left out."""
    if not shares:
        return basis
    multiples = np.append(shares, np.ones(basis.shape[1] - len(shares)))
    scaled: FloatArray = basis[:, multiples > 0.0] * multiples[multiples > 0.0]
    return scaled

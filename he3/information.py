"""The information that a set of samples carries about the field, in nats, and the error of an estimate of it.

For the field's covariance S over k places and independent measurement noise of variance s^2, the mutual information
between the k measurements and the field is

    I = 1/2 log det(I + S / s^2)

(the entropy of the measurements less that of their noise: Krause, Singh & Guestrin, J. Mach. Learn. Res. 9, 2008,
sect. 2). The paper's differential entropy 1/2 log |2 pi e S| differs from it by a constant per sample in the limit of
small noise, but is negative for small S, where its power I^alpha is undefined.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from he3.errors import InvalidInput, NumericalFailure

if TYPE_CHECKING:
    from he3.frames import FloatArray


def information_gain(covariance: FloatArray, noise_variance: float) -> float:
    """Mutual information [nats] between noisy measurements at k places and the field.

    covariance: (k, k), of the field at those places, given all samples so far [ppb^2]. noise_variance: of a
    measurement, in the same unit. Raises InvalidInput for another shape or a noise that is not positive.
    """
    covariance = np.asarray(covariance, dtype=np.float64)
    if covariance.ndim != 2:
        raise InvalidInput(f"expected one covariance (k, k), got {covariance.shape}")
    return float(information_gains(covariance[None], noise_variance)[0])


def information_gains(covariances: FloatArray, noise_variance: float, shares: FloatArray | None = None) -> FloatArray:
    """Mutual information (...,) [nats] for each of a stack (..., k, k) of covariances: one batched factorisation.

    shares: (..., k), how much of each measurement's information counts, 0 to 1; all of it if None. The information of a
    measurement is what it adds to that of the measurements before it, so the sum is that of the chain rule.
    Raises InvalidInput as ``information_gain``, and NumericalFailure if a matrix is not a covariance.
    """
    stack = np.asarray(covariances, dtype=np.float64)
    if stack.ndim < 2 or stack.shape[-1] != stack.shape[-2]:
        raise InvalidInput(f"expected covariances (..., k, k), got {stack.shape}")
    if not noise_variance > 0:
        raise InvalidInput(f"expected a positive noise variance, got {noise_variance!r}")
    if shares is not None and shares.shape != stack.shape[:-1]:
        raise InvalidInput(f"expected shares {stack.shape[:-1]} of the measurements' information, got {shares.shape}")
    if stack.shape[-1] == 0:
        return np.zeros(stack.shape[:-2])
    ratio = stack / noise_variance
    diagonal = np.arange(stack.shape[-1])
    ratio[..., diagonal, diagonal] += 1.0
    try:
        factor = np.linalg.cholesky(ratio)
    except np.linalg.LinAlgError:
        raise NumericalFailure(
            f"expected covariances of a field over k places, got one of {stack.shape} that is not positive definite"
        ) from None
    each = np.log(factor[..., diagonal, diagonal])
    gains: FloatArray = (each if shares is None else each * shares).sum(axis=-1)
    return gains


def rmse(truth: NDArray[np.floating], estimate: NDArray[np.floating]) -> float:
    """Root mean square difference over all elements, in their unit. Raises InvalidInput for unequal shapes."""
    if truth.shape != estimate.shape:
        raise InvalidInput(f"expected arrays of one shape, got {truth.shape} and {estimate.shape}")
    difference = np.asarray(truth, dtype=np.float64) - np.asarray(estimate, dtype=np.float64)
    return float(np.sqrt(np.mean(difference * difference)))

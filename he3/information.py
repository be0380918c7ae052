"""What a set of samples would tell about the field, in nats, and how well a belief's error bars hold.

For the field's covariance S over k places and independent measurement noise of variance s^2, the mutual information
between the k measurements and the field is

    I = 1/2 log det(I + S / s^2)

(the entropy of the measurements less that of their noise: Krause, Singh & Guestrin, J. Mach. Learn. Res. 9, 2008,
sect. 2). The paper's differential entropy 1/2 log |2 pi e S| differs from it by a constant per sample in the limit of
small noise, but falls below zero for small S, and then its power I^alpha means nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from he3.errors import InvalidInput, NumericalFailure
from he3.frames import FloatArray


def information_gain(covariance: FloatArray, noise_variance: float) -> float:
    """Mutual information [nats] between noisy measurements at k places and the field.

    covariance: (k, k) covariance of the field at those places, given all that is known [ppb^2];
    noise_variance in the same units. Raises InvalidInput for another shape or a noise that is not positive.
    """
    covariance = np.asarray(covariance, dtype=np.float64)
    if covariance.ndim != 2:
        raise InvalidInput(f"expected one covariance (k, k), got {covariance.shape}")
    return float(information_gains(covariance[None], noise_variance)[0])


def information_gains(covariances: FloatArray, noise_variance: float) -> FloatArray:
    """Mutual information (...,) [nats] for each of a stack (..., k, k) of covariances: one batched factorisation.

    Raises NumericalFailure if one of them is not a covariance.
    """
    stack = np.asarray(covariances, dtype=np.float64)
    if stack.ndim < 2 or stack.shape[-1] != stack.shape[-2]:
        raise InvalidInput(f"expected covariances (..., k, k), got {stack.shape}")
    if not noise_variance > 0:
        raise InvalidInput(f"expected a positive noise variance, got {noise_variance!r}")
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
    gains: FloatArray = np.log(factor[..., diagonal, diagonal]).sum(axis=-1)
    return gains


def single_place_gain(variance: FloatArray, noise_variance: float) -> FloatArray:
    """Mutual information [nats] of one measurement at each place with the given variance: 1/2 log(1 + v / s^2)."""
    gains: FloatArray = 0.5 * np.log1p(np.asarray(variance) / noise_variance)
    return gains


def differential_entropy(covariance: FloatArray) -> float:
    """The paper's path entropy 1/2 log |2 pi e S| [nats] of a (k, k) covariance; may be negative.

    Raises NumericalFailure for a singular covariance, whose entropy is minus infinity.
    """
    covariance = np.asarray(covariance, dtype=np.float64)
    sign, log_determinant = np.linalg.slogdet(covariance)
    if not (sign > 0 and np.isfinite(log_determinant)):
        raise NumericalFailure(f"the entropy of a singular covariance over {covariance.shape[0]} places is not finite")
    return float(0.5 * (covariance.shape[0] * np.log(2.0 * np.pi * np.e) + log_determinant))


class Calibration(NamedTuple):
    """How often the truth lies within one and within two posterior standard deviations: 0.683 and 0.954 if honest."""

    within_1_sigma: float
    within_2_sigma: float


def calibration(
    truth: NDArray[np.floating], mean: NDArray[np.floating], standard_deviation: NDArray[np.floating]
) -> Calibration:
    """The fractions of places where the truth lies within one and two standard deviations of the mean; equal shapes."""
    truth, mean, sigma = _equal_shapes(truth, mean, standard_deviation)
    miss = np.abs(truth - mean)
    return Calibration(float(np.mean(miss <= sigma)), float(np.mean(miss <= 2.0 * sigma)))


def coverage(
    truth: NDArray[np.floating],
    mean: NDArray[np.floating],
    standard_deviation: NDArray[np.floating],
    probability: float,
) -> float:
    """The fraction of places where the truth lies in the central interval of that probability; equal shapes."""
    truth, mean, sigma = _equal_shapes(truth, mean, standard_deviation)
    if not 0.0 < probability < 1.0:
        raise InvalidInput(f"expected a probability between 0 and 1, got {probability!r}")
    return float(np.mean(np.abs(truth - mean) <= ndtri(0.5 + 0.5 * probability) * sigma))


def rmse(truth: NDArray[np.floating], estimate: NDArray[np.floating]) -> float:
    """Root mean square difference over all places; equal shapes, same unit as they."""
    truth, estimate = _equal_shapes(truth, estimate)
    difference = truth - estimate
    return float(np.sqrt(np.mean(difference * difference)))


def _equal_shapes(*arrays: NDArray[np.floating]) -> tuple[FloatArray, ...]:
    shapes = {np.shape(array) for array in arrays}
    if len(shapes) != 1:
        raise InvalidInput(f"expected arrays of one shape, got {', '.join(map(str, sorted(shapes)))}")
    return tuple(np.asarray(array, dtype=np.float64) for array in arrays)

"""The log marginal likelihood of standardised observations and its gradient, from one Cholesky factorisation.

    log p(z) = -1/2 z' A^-1 z - 1/2 log det A - n/2 log 2 pi,      A = K + T + s^2 I
    d log p / d t = 1/2 tr((a a' - A^-1) dA/dt),                   a = A^-1 z

(Rasmussen & Williams 2006, eqs. 5.8 and 5.9), with T the fixed covariance of a trend, if there is one. The gradient is
with respect to the logarithms of the kernel's parameters, in their order, and then of the noise variance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.linalg import lapack

from he3.errors import NumericalFailure

if TYPE_CHECKING:
    from he3.frames import FloatArray

_factor: Callable[..., tuple[Any, int]] = lapack.dpotrf
_solve: Callable[..., tuple[Any, int]] = lapack.dpotrs
_invert: Callable[..., tuple[Any, int]] = lapack.dpotri


class Covariance(Protocol):
    """A covariance with derivatives, such as a kernel."""

    def with_log_gradients(self, r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """Covariance (n, n) at the squared distances [m^2], and its derivatives by the parameters."""


def log_marginal_likelihood(
    kernel: Covariance,
    noise_variance: float,
    r2: FloatArray,
    z: FloatArray,
    trend_covariance: FloatArray | None = None,
) -> tuple[float, FloatArray]:
    """Log marginal likelihood of observations z (n,), and its gradient (parameters + 1,).

    r2: squared distances (n, n) [m^2] between their places, which are computed once per fit. noise_variance and
    trend_covariance (n, n) are in the squared unit of the observations. Raises NumericalFailure if the covariance
    cannot be factorised.
    """
    n = len(z)
    covariance, derivatives = kernel.with_log_gradients(r2)
    total = covariance.copy() if trend_covariance is None else covariance + trend_covariance
    total.flat[:: n + 1] += noise_variance
    # C order read as Fortran order is the transpose: the same symmetric matrix, factorised in place.
    factor, info = _factor(total.T, lower=1, clean=1, overwrite_a=1)
    if info != 0:
        raise NumericalFailure(
            f"the covariance of {n} samples is not positive definite (leading minor {info}) for {kernel} "
            f"with noise variance {noise_variance:g}"
        )
    weights, _ = _solve(factor, z, lower=1)
    log_determinant_half = float(np.log(factor.diagonal()).sum())
    value = -0.5 * float(z @ weights) - log_determinant_half - 0.5 * n * float(np.log(2.0 * np.pi))
    inverse, _ = _invert(factor, lower=1, overwrite_c=1)
    # The inverse is in the lower triangle in Fortran order, so in the upper one in C order; the other holds zeros.
    triangle = np.ascontiguousarray(inverse.T)
    diagonal = triangle.diagonal()
    gradient = np.empty(len(derivatives) + 1)
    for index, derivative in enumerate(derivatives):
        trace = 2.0 * float(np.vdot(triangle, derivative)) - float(diagonal @ derivative.diagonal())
        gradient[index] = 0.5 * (float(weights @ (derivative @ weights)) - trace)
    gradient[-1] = 0.5 * noise_variance * (float(weights @ weights) - float(diagonal.sum()))
    return value, gradient

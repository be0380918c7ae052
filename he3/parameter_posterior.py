"""The posterior of one kernel's parameters, its normal approximation, and a weighted design that represents it.

The log posterior is that of ``he3.hyperposterior``, in u: the logarithms of the parameters, in standard deviations of
their priors from the medians.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from he3.hyperparameters import best_optimum
from he3.hyperprior import REACH

if TYPE_CHECKING:
    from collections.abc import Sequence

    from he3.frames import FloatArray
    from he3.hyperparameters import LikelihoodProblem
    from he3.kernels import Kernel

LEAST_PRECISION = 0.5  # 1, of the normal approximation along any axis, in units of the prior's
POINTS = ((40, 128), (200, 64), (400, 40))  # points of the design for up to so many samples
POINTS_OF_MANY = 24
WIDENING = 1.3  # 1, of the normal approximation; its tails are then never thinner than the posterior's
_PRIOR_SHARE = 0.5  # 1, of the design, for up to 40 samples; less for more
_STEP = 0.05  # 1, of the second differences, in standard deviations of the prior


@dataclass(frozen=True, slots=True, eq=False)
class ParameterPosterior:
    """The log posterior, up to a constant, of u: log parameters in standard deviations from the prior's medians."""

    likelihood: LikelihoodProblem
    medians: FloatArray
    factors: FloatArray

    def __len__(self) -> int:
        return len(self.medians)

    def kernel(self, u: FloatArray) -> Kernel:
        """The kernel whose parameters are at u (p,)."""
        return self.likelihood.kernel_at(self.medians + self.factors * u)

    def noise(self, u: FloatArray) -> float:
        """The noise variance at u (p,), in standardised units."""
        return self.likelihood.noise_at(self.medians + self.factors * u)

    def cost(self, u: FloatArray) -> tuple[float, FloatArray]:
        """Minus the log posterior, and its gradient (p,)."""
        if not len(self.likelihood.z):
            return 0.5 * float(u @ u), u
        value, gradient = self.likelihood.cost(self.medians + self.factors * u)
        return value + 0.5 * float(u @ u), gradient * self.factors + u

    def mode(self, starts: Sequence[FloatArray], least: FloatArray | None = None) -> FloatArray:
        """The best of the optima (p,) that the starts lead to. Raises NumericalFailure if none is finite.

        least: lower bounds of u (p,); None for those of the search alone.
        """
        bounds = np.column_stack((-REACH / self.factors if least is None else least, REACH / self.factors))
        return best_optimum(self.cost, starts, bounds, f"a posterior for {self.likelihood.default.name!r}")

    def normal_at(self, mode: FloatArray) -> FloatArray:
        """A matrix (p, p) whose outer product is the covariance of the normal approximation at the mode."""
        p = len(self)
        precision = np.empty((p, p))
        for k in range(p):
            step = np.zeros(p)
            step[k] = _STEP
            precision[k] = (self.cost(mode + step)[1] - self.cost(mode - step)[1]) / (2.0 * _STEP)
        along, axes = np.linalg.eigh(0.5 * (precision + precision.T))
        spread: FloatArray = axes / np.sqrt(np.maximum(along, LEAST_PRECISION))
        return spread

    def weighted_design(self, mode: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (N, p) after the normal approximation and the prior, and the logarithms of prior over density (N,)."""
        n, p = len(self.likelihood.z), len(self)
        count = next((count for most, count in POINTS if n <= most), POINTS_OF_MANY)
        of_prior = round(_PRIOR_SHARE * count * min(1.0, POINTS[0][0] / max(n, 1)))
        widened = WIDENING * spread
        points = np.vstack((mode + normal_design(count - of_prior, p) @ widened.T, normal_design(of_prior, p)))
        log_prior = -0.5 * (points * points).sum(axis=1)
        whitened = np.linalg.solve(widened, (points - mode).T)
        log_normal = -0.5 * (whitened * whitened).sum(axis=0) - float(np.linalg.slogdet(widened)[1])
        with np.errstate(divide="ignore"):
            shares = np.log(np.array([count - of_prior, of_prior]) / count)
        density = np.logaddexp(shares[0] + log_normal, shares[1] + log_prior)
        return points, log_prior - density


def log_integral(posterior: ParameterPosterior, mode: FloatArray, spread: FloatArray) -> float:
    """Laplace's approximation of the logarithm of the posterior's integral."""
    return float(np.linalg.slogdet(spread)[1]) - posterior.cost(mode)[0]


def normal_design(count: int, p: int) -> FloatArray:
    """Points (count, p) that follow a standard normal distribution evenly, the first in its middle.

    A lattice of Kronecker's, with the golden ratio's generalisation to p dimensions (Roberts 2018).
    """
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (p + 1))
    steps = ratio ** -np.arange(1.0, p + 1)
    uniform = (0.5 + np.arange(count)[:, None] * steps) % 1.0
    design: FloatArray = ndtri(np.clip(uniform, 1e-6, 1.0 - 1e-6))
    return design

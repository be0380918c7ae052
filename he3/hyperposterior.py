"""The most probable hyperparameters under priors: maximum a posteriori, with the constant mean marginalised.

With log-normal priors (``he3.hyperprior``) the posterior of the logarithms theta of the kernel's parameters is

    p(theta | y)  ~  p(y | theta) N(theta; medians, factors^2)

where the constant mean, or a trend's coefficients, are marginalised in p(y | theta). Its mode is found by L-BFGS-B. The
evidence of a kernel is Laplace's approximation of the integral. A likelihood alone has no lower bound on the variance
but that of the samples: five nearly equal ones make a whole site look known. With a prior in ppb, they do not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from he3.errors import InvalidInput
from he3.frames import FloatArray, as_points
from he3.hyperparameters import (
    CAUTIOUS_FIRST,
    VERY_STRONG_EVIDENCE,
    Hyperparameters,
    LikelihoodProblem,
    best_optimum,
)
from he3.hyperprior import REACH, Hyperprior
from he3.kernels import AUTO, Kernel, kernel_from, squared_distances, with_log_parameters
from he3.trend import UnknownConstant

if TYPE_CHECKING:
    from collections.abc import Sequence

    from he3.trend import OrbitalTrend

LEAST_PRECISION = 0.5  # 1, of the normal approximation along any axis, in units of the prior's
_STEP = 0.05  # 1, of the second differences, in standard deviations of the prior
_FOLLOWED_UP_TO = 150  # samples up to which the best points of the prior are starts, too
_CANDIDATES = 16


def infer_hyperparameters(
    xy_m: FloatArray,
    values_ppb: FloatArray,
    kernel_name: str,
    prior: Hyperprior,
    *,
    noise_std_ppb: float,
    trend: OrbitalTrend | None = None,
    previous: Hyperparameters | None = None,
) -> Hyperparameters:
    """The most probable hyperparameters given observations (n,) [ppb] at places (n, 2) [m]; medians for n = 0.

    kernel_name: one of ``KERNELS``, or "auto", the most cautious kernel that the evidence allows. previous: a start of
    the search. It draws nothing at random. Raises InvalidInput for shapes that do not fit,
    values that are not finite, or an unknown kernel.
    """
    xy = as_points(np.asarray(xy_m, dtype=np.float64).reshape(-1, 2))
    values = np.asarray(values_ppb, dtype=np.float64)
    if values.shape != (len(xy),) or not np.isfinite(values).all():
        raise InvalidInput(f"expected {len(xy)} finite values, one per place, got shape {values.shape}")
    names = CAUTIOUS_FIRST if kernel_name == AUTO else (kernel_from(kernel_name).name,)
    found = [_inferred(xy, values, name, prior, noise_std_ppb, trend, previous) for name in names]
    least = max(evidence for evidence, _ in found) - VERY_STRONG_EVIDENCE
    return next(inferred for evidence, inferred in found if evidence >= least)


@dataclass(frozen=True, slots=True, eq=False)
class _Posterior:
    """The log posterior, up to a constant, of u: log parameters in standard deviations from the prior's medians."""

    likelihood: LikelihoodProblem
    medians: FloatArray
    factors: FloatArray

    def __len__(self) -> int:
        return len(self.medians)

    def kernel(self, u: FloatArray) -> Kernel:
        """The kernel whose parameters are at u (p,)."""
        return with_log_parameters(self.likelihood.default, self.medians + self.factors * u)

    def cost(self, u: FloatArray) -> tuple[float, FloatArray]:
        """Minus the log posterior, and its gradient (p,)."""
        if not len(self.likelihood.z):
            return 0.5 * float(u @ u), u
        value, gradient = self.likelihood.cost(self.medians + self.factors * u)
        return value + 0.5 * float(u @ u), gradient * self.factors + u

    def mode(self, starts: Sequence[FloatArray]) -> FloatArray:
        """The best of the optima (p,) that the starts lead to. Raises NumericalFailure if none is finite."""
        bounds = np.column_stack((-REACH / self.factors, REACH / self.factors))
        return best_optimum(self.cost, starts, bounds, f"a posterior for {self.likelihood.default.name!r}")

    def log_volume(self, mode: FloatArray) -> float:
        """Half the log determinant of the covariance of the normal approximation at the mode."""
        p = len(self)
        precision = np.empty((p, p))
        for k in range(p):
            step = np.zeros(p)
            step[k] = _STEP
            precision[k] = (self.cost(mode + step)[1] - self.cost(mode - step)[1]) / (2.0 * _STEP)
        along = np.linalg.eigvalsh(0.5 * (precision + precision.T))
        return -0.5 * float(np.log(np.maximum(along, LEAST_PRECISION)).sum())


def _inferred(
    xy: FloatArray,
    values: FloatArray,
    kernel_name: str,
    prior: Hyperprior,
    noise_std_ppb: float,
    trend: OrbitalTrend | None,
    previous: Hyperparameters | None,
) -> tuple[float, Hyperparameters]:
    """The log evidence of a kernel, and the mode of its parameters."""
    scale = prior.field_std_ppb
    residual = values if trend is None else values - trend.at(xy)
    sample_mean = float(residual.mean()) if len(residual) else 0.0
    if trend is None:
        mean = prior.mean_ppb
        away = abs(sample_mean - mean) if len(residual) else 0.0
        unknown: UnknownConstant | OrbitalTrend = UnknownConstant(max(prior.mean_std_ppb, away))
    else:
        mean, unknown = sample_mean, trend  # the trend's own offset lies about the samples' misfit
    basis = unknown.basis(xy, scale)
    medians, factors = prior.log_normal(kernel_name)
    problem = LikelihoodProblem(
        default=kernel_from(kernel_name),
        r2=squared_distances(xy, xy),
        z=(residual - mean) / scale,
        trend_covariance=basis @ basis.T,
        noise=(noise_std_ppb / scale) ** 2,
        bounds=np.column_stack((medians - REACH, medians + REACH)),
    )
    posterior = _Posterior(problem, medians, factors)
    mode = posterior.mode(_starts(posterior, kernel_name, previous, scale))
    cost = posterior.cost(mode)[0]
    # In the unit of the samples, not in standardised ones.
    likelihood = 0.5 * float(mode @ mode) - cost - len(values) * math.log(scale) if len(values) else math.nan
    fitted = Hyperparameters(posterior.kernel(mode), noise_std_ppb, mean, scale, likelihood, unknown)
    return posterior.log_volume(mode) - cost, fitted


def _starts(
    posterior: _Posterior, kernel_name: str, previous: Hyperparameters | None, scale: float
) -> list[FloatArray]:
    """Starts (p,) of the search: the previous optimum or the prior's median, and others while it is cheap."""
    starts = [np.zeros(len(posterior))]
    if previous is not None and previous.kernel.name == kernel_name:
        in_scale = {
            key: value * (previous.scale_ppb / scale) ** 2 if key.endswith("variance") else value
            for key, value in previous.kernel.parameters().items()
        }
        starts = [(np.log(list(in_scale.values())) - posterior.medians) / posterior.factors]
    if len(posterior.likelihood.z) <= _FOLLOWED_UP_TO:
        others = _normal_design(_CANDIDATES, len(posterior))
        starts.append(min(others, key=lambda u: posterior.cost(u)[0]))
    return starts


def _normal_design(count: int, p: int) -> FloatArray:
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
